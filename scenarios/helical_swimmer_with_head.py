"""A bacterium: a motor in its head turns a helical flagellum, which pushes it through the fluid.

The picture: the flagellum is a helix that begins on the axis of the head (Higdon 1979, J. Fluid
Mech. 94, 331). It turns against the head as a motor makes it. The head turns the other way round,
since nothing outside turns the two. A stiff flagellum keeps its shape; an elastic one is a rod
that the motor holds and turns at its first node.

    mrs run helical_swimmer_with_head --set flagellum=elastic
"""

from __future__ import annotations

from typing import Any, ClassVar, Literal

import numpy as np
import scipy
from pydantic import Field

import mrs
from mrs.scenarios.helical_swimmer import flow, swimming_speed


class HelicalSwimmerWithHead(mrs.Scenario):
    """Options of the bacterium; micrometres, piconewtons, seconds."""

    quick: ClassVar[dict[str, Any]] = {
        "head_points": 100,
        "turns": 2.0,
        "thickness": 0.1,
        "t_end": 0.005,
    }

    flagellum: Literal["rigid", "elastic"] = Field("rigid", description="how it is built")
    head_radius: float = Field(0.5, gt=0, description="of the head, an ellipsoid about its axis")
    head_length: float = Field(2.0, gt=0, description="of the head along its axis")
    head_points: int = Field(200, ge=10, description="on the surface of the head")
    radius: float = Field(0.3, gt=0, description="of the helix, which begins on its axis")
    pitch: float = Field(2.2, gt=0, description="of the helix, which is right-handed")
    turns: float = Field(3.0, gt=0, description="of the helix")
    thickness: float = Field(0.05, gt=0, description="radius of the flagellum")
    rate: float = Field(100.0, description="turns of the flagellum against the head, per time")
    bending: float = Field(5.0, gt=0, description="moduli a1 = a2 = a3 of an elastic flagellum")
    shearing: float = Field(100.0, gt=0, description="its moduli b1 = b2 = b3")
    viscosity: float = Field(1e-3, gt=0, description="of the fluid")
    t_end: float = Field(0.02, gt=0, description="simulated time")
    interval: float = Field(0.0005, gt=0, description="simulated time between frames")

    @property
    def epsilon(self) -> float:
        """Blob size of the flagellum, which gives a rod of its thickness its drag."""
        return float(np.sqrt(np.e)) * self.thickness

    def build(self, **common: Any) -> mrs.Simulation:
        """Return the bacterium, which looks along z."""
        semi_axes = (self.head_radius, self.head_radius, 0.5 * self.head_length)
        head = mrs.surfaces.ellipsoid(semi_axes, self.head_points)
        line, turning = self.centerline(), 2.0 * np.pi * self.rate
        fluid = mrs.Fluid(self.viscosity, self.epsilon)
        if self.flagellum == "rigid":
            whole = mrs.Turning(head, mrs.surfaces.along(line, self.thickness), rate=turning)
            return mrs.Simulation(fluid, [mrs.Rigid(whole, name="bacterium")], **common)
        rod = mrs.Rods(
            line,
            bending=self.bending,
            twisting=self.bending,
            shearing=self.shearing,
            stretching=self.shearing,
            base=mrs.Mount("head", turning=(0.0, 0.0, turning)),
            radius=self.thickness,
            name="flagellum",
        )
        return mrs.Simulation(fluid, [mrs.Rigid(head, name="head"), rod], **common)

    def centerline(self) -> mrs.Centerline:
        """Return the helix from the rear of the head on, with three nodes in two blobs."""
        length, k = self.turns * self.pitch, 2.0 * np.pi / self.pitch
        stretch = np.hypot(1.0, k * self.radius)
        z = np.linspace(0.0, length, max(8, round(1.5 * length * stretch / self.epsilon)))
        rest = np.exp(-((k * z) ** 2))
        r, slope = self.radius * (1.0 - rest), self.radius * 2.0 * k**2 * z * rest
        radial = np.column_stack([np.cos(k * z), np.sin(k * z), 0.0 * z])
        across = np.column_stack([-np.sin(k * z), np.cos(k * z), 0.0 * z])
        upwards = [0.0, 0.0, 1.0]
        nodes = r[:, None] * radial + np.outer(z, upwards)
        tangents = slope[:, None] * radial + (k * r)[:, None] * across + upwards
        sideways = np.tile([1.0, 0.0, 0.0], (len(z), 1))
        line = mrs.Centerline(nodes, mrs.geometry.from_directors(sideways, tangents))
        turn = scipy.spatial.transform.Rotation.from_rotvec([np.pi, 0.0, 0.0])
        return line.moved((0.0, 0.0, -0.5 * self.head_length), turn)

    def check(self, sim: mrs.Simulation) -> mrs.Check:
        """Return the speed of the middle of all points, beside the sum of K eq. (7.2) written out.

        It is due to hydrodynamic interaction alone. The forces on the fluid sum to zero, so that
        points that feel only their own drag do not swim. The node that the motor holds puts no
        force on the fluid, and does not count.
        """
        now = sim.now
        pushing = now.loads[:, :3].any(axis=1)
        loads = np.zeros((len(now.points), 6))
        loads[:, : now.loads.shape[1]] = now.loads
        velocity = flow(now.points[pushing], now.points, loads, sim.fluid, sim.scene.epsilons)
        return swimming_speed(now.motion[pushing, :3], velocity)
