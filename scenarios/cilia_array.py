"""A square carpet of helical cilia that beat in a metachronal wave over a wall, and pump along it.

The picture: rods on a grid, each clamped at its base, are the helices of K 8.2,
(x0 + 0.3 cos 2z, y0 + 0.3 sin 2z, z). A wave of preferred curvature runs up each of them, and each
is a little later than its neighbour in x, so that waves of bending sweep over the carpet and drag
the fluid along. The wall is half a blob below their bases: much nearer to it the mobility of nodes
is not positive definite.

    mrs run cilia_array --set rows=5 --set observables.flux.kind=pumped_flux
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
from pydantic import Field

import mrs
from mrs.scenarios.helical_swimmer import flow


class CiliaArray(mrs.Scenario):
    """Options of the carpet; lengths and forces as in K 8.2, viscosity 1."""

    quick: ClassVar[dict[str, Any]] = {
        "rows": 3,
        "columns": 3,
        "nodes": 31,
        "epsilon": 0.26,
        "t_end": 1.0,
        "interval": 0.05,
    }

    rows: int = Field(6, ge=1, description="rods along y")
    columns: int = Field(6, ge=1, description="rods along x")
    spacing: float = Field(2.0, gt=0, description="between neighbours")
    nodes: int = Field(76, ge=3, description="of each rod")
    height: float = Field(6.0, gt=0, description="of a rod, along z")
    radius: float = Field(0.3, gt=0, description="of the helix")
    pitch: float = Field(float(np.pi), gt=0, description="of the helix")
    epsilon: float | None = Field(
        None, gt=0, description="blob size; by default three spacings of the nodes"
    )
    bending: float = Field(100.0, gt=0, description="moduli a1 = a2 = a3")
    shearing: float = Field(2000.0, gt=0, description="moduli b1 = b2 = b3")
    amplitude: float = Field(0.6, ge=0, description="of the wave of curvature, radians per length")
    wavelength: float = Field(6.0, gt=0, description="of the wave along a rod")
    period: float = Field(1.0, gt=0, description="of the beat")
    metachronal_wavelength: float = Field(8.0, gt=0, description="along x, of the phases")
    wall: bool = Field(True, description="whether there is a wall under the carpet")
    t_end: float = Field(3.0, gt=0, description="simulated time")
    interval: float = Field(0.05, gt=0, description="simulated time between frames")

    def build(self, **common: Any) -> mrs.Simulation:
        """Return the carpet."""
        rod = mrs.geometry.helix(self.radius, self.pitch, self.height, self.nodes)
        origins = mrs.geometry.grid((self.columns, self.rows), self.spacing)
        cilia = mrs.Rods(
            mrs.geometry.array(rod, origins),
            bending=self.bending,
            twisting=self.bending,
            shearing=self.shearing,
            stretching=self.shearing,
            beat=mrs.TravellingWave((self.amplitude, 0.0, 0.0), self.wavelength, self.period),
            delay=self.period * origins[:, 0] / self.metachronal_wavelength,
            base="clamped",
            name="cilia",
        )
        epsilon = self.epsilon or 3.0 * float(cilia.spacing.max())
        fluid = mrs.Fluid(epsilon=epsilon)
        if self.wall:
            fluid = replace(fluid, boundary=mrs.Wall((0.0, 0.0, -0.5 * epsilon)))
        return mrs.Simulation(fluid, [cilia], **common)

    def check(self, sim: mrs.Simulation) -> mrs.Check:
        """Return the flux along the wall; without a wall, the speed of two tips from each other."""
        return self._flux(sim) if self.wall else self._speed_of_tips(sim)

    def _flux(self, sim: mrs.Simulation) -> mrs.Check:
        """Return the flux through a whole plane before the carpet, beside that of the loads."""
        x = sim.now.points[:, 0].max() + 0.5 * self.height
        through = flux_through_plane(sim.velocity, sim.fluid.boundary, x, self.height)
        expected = mrs.observables.PumpedFlux()(sim)
        return mrs.Check("flux along the wall", through, expected, 0.01)

    def _speed_of_tips(self, sim: mrs.Simulation) -> mrs.Check:
        """Return how fast two tips of one column move apart, beside the sum of K eq. (7.2).

        The first cilium and that in the middle of its column beat in phase. They differ by the flow
        of the others alone: nodes that feel only their own drag move alike in both.
        """
        (cilia,) = sim.bodies
        assert isinstance(cilia, mrs.Rods)
        now = sim.now
        tips = cilia.first[[0, self.rows // 2]] + self.nodes - 1
        apart = np.diff(now.motion[tips, :3], axis=0)
        expected = np.diff(flow(now.points[tips], now.points, now.loads, sim.fluid), axis=0)
        return mrs.Check(
            "speed of two tips from each other",
            float(np.linalg.norm(apart)),
            float(np.linalg.norm(expected)),
            0.01,
        )


def flux_through_plane(
    velocity: Callable[[np.ndarray], np.ndarray], wall: Any, x: float, height: float
) -> float:
    """Return the flux along x through a whole plane over a wall, by the velocities there.

    In polar coordinates with r = height t / (1 - t): far away the velocity falls off as r^-3.
    """
    nodes, weights = np.polynomial.legendre.leggauss(24)
    t, angle = 0.5 + 0.5 * nodes[:, None], 0.5 * np.pi * (1.0 + nodes)
    r = height * t / (1.0 - t)
    area = np.outer(0.5 * weights, 0.5 * np.pi * weights) * r * height / (1.0 - t) ** 2
    yz = np.stack([r * np.cos(angle), r * np.sin(angle)], axis=-1).reshape(-1, 2)
    through = velocity(wall.point + np.insert(yz, 0, x, axis=1))
    return float(area.ravel() @ through[:, 0])
