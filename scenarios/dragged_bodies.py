"""Three bodies that fall, or one that is dragged through a row of others.

The picture: of three spheres at the corners of a vertical triangle two come together, and leave the
third behind, since a pair falls faster. In other triangles they overtake each other in a chaotic
order (Hocking 1964, J. Fluid Mech. 20, 129; Janosi et al. 1997, Phys. Rev. E 56, 2858). A
horizontal triangle stays as it is. In a horizontal line the one in the middle falls faster. A body
that is dragged along a row pulls it along.

    mrs run dragged_bodies --set arrangement=through
"""

from __future__ import annotations

from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import Field

import mrs

_DOWN = np.array([0.0, 0.0, -1.0])
_HALF, _HEIGHT = 0.5, np.sqrt(0.75)  # of a triangle with sides of length 1
# In distances between neighbours.
_PLACES = {
    "vertical": np.array([[0.0, 0.0, _HALF], [0.0, 0.0, -_HALF], [_HEIGHT, 0.0, 0.0]]),
    "triangle": np.array([[-_HALF, 0.0, 0.0], [_HALF, 0.0, 0.0], [0.0, _HEIGHT, 0.0]]),
    "line": np.array([[-1.0, 0.0, 0.0], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]),
    "through": np.array([[-1.0, 0.0, 0.0], *([0.0, 0.0, -n] for n in range(5))]),
}


class DraggedBodies(mrs.Scenario):
    """Options of the bodies; a sphere of radius 1 falls at speed 1, and is dragged at that."""

    quick: ClassVar[dict[str, Any]] = {"points": 50, "t_end": 2.0}

    arrangement: Literal["vertical", "triangle", "line", "through"] = Field(
        "vertical", description="corners of a triangle, or a line; or one dragged along a row"
    )
    surface: str | None = Field(
        None, description="file with triangles, such as .stl; by default spheres of radius 1"
    )
    points: int = Field(150, ge=10, description="on each sphere")
    distance: float = Field(4.0, gt=0, description="between neighbours at the start")
    t_end: float = Field(40.0, gt=0, description="simulated time")
    interval: float = Field(0.5, gt=0, description="simulated time between frames")

    def build(self, **common: Any) -> mrs.Simulation:
        """Return the bodies."""
        shape, places = self.shape(), self.distance * _PLACES[self.arrangement]
        if self.arrangement == "through":
            drive = mrs.Drive(velocity=_DOWN)
            dragged = mrs.Rigid(shape, positions=places[:1], motion=drive, name="dragged")
            bodies = [dragged, mrs.Rigid(shape, positions=places[1:], name="row")]
        else:
            weight = 6.0 * np.pi * _DOWN
            bodies = [mrs.Rigid(shape, positions=places, force=weight, name="falling")]
        return mrs.Simulation(mrs.Fluid(), bodies, **common)

    def shape(self) -> mrs.Surface:
        """Return the surface of each body."""
        if self.surface is None:
            return mrs.surfaces.sphere(1.0, self.points)
        return mrs.surfaces.read(self.surface)

    def check(self, sim: mrs.Simulation) -> mrs.Check:
        """Return the largest speed at the start that a body has from the others.

        Its speed by its own force is that of one alone. Expected is the flow of the others' forces
        by Rotne & Prager (1969, J. Chem. Phys. 50, 4831) for spheres with the same drag, which
        leaves out terms of the order of (radius / distance)^4.
        """
        layout = sim.scene.layout
        centres = np.concatenate([body.positions for body in sim.bodies])
        start = sim.scene.evaluate(0.0, layout.initial)
        size = len(start.points) // len(centres)
        force = start.loads[:, :3].reshape(-1, size, 3).sum(axis=1)
        velocity = start.motion[:, :3].reshape(-1, size, 3).mean(axis=1)
        drag = mrs.resistance(mrs.Rigid(self.shape()), sim.fluid)[:3, :3]
        swept = velocity - np.linalg.solve(drag, force.T).T
        expected = flow_of_spheres(centres, force, np.trace(drag) / (18.0 * np.pi))
        row = int(np.argmax(np.linalg.norm(expected, axis=1)))
        value, formula = (float(np.linalg.norm(speed[row])) for speed in (swept, expected))
        return mrs.Check("speed from the others at the start", value, formula, 0.05)


def flow_of_spheres(centres: np.ndarray, force: np.ndarray, radius: float) -> np.ndarray:
    """Return the velocity that each of equal spheres has from the others, (n, 3); viscosity 1.

    Parameters
    ----------
    centres, force : (n, 3) ndarray
    radius : float
    """
    apart = centres[:, None] - centres
    distance = np.linalg.norm(apart, axis=2, keepdims=True)
    np.einsum("iij->ij", distance)[:] = np.inf
    along = (apart * force).sum(axis=2, keepdims=True) * apart / distance**2
    far, near = force + along, force / 3.0 - along
    flow = far / distance + 2.0 * radius**2 * near / distance**3
    return flow.sum(axis=1) / (8.0 * np.pi)
