"""A square carpet of lung cilia, whose beat is given, pumps over a wall and carries tracers.

The picture: each cilium has the beat that was measured (Fulford & Blake 1986). Its effective stroke
is along x. Each is a little ahead of its neighbour in x, so that a wave runs against the effective
stroke, as in airways. Neighbours in the plane of the beat need this, or they run into each other.
The wall is half a blob below their bases.

    mrs run prescribed_cilia --set rows=4 --set observables.flux.kind=pumped_flux
"""

from __future__ import annotations

from functools import partial
from typing import Any, ClassVar

import numpy as np
from pydantic import Field

import mrs
from mrs.scenarios.cilia_array import flux_through_plane

_TIMES = 12  # of a period, over which means are taken


class PrescribedCilia(mrs.Scenario):
    """Options of the carpet; the units are the length of a cilium and its period, viscosity 1."""

    quick: ClassVar[dict[str, Any]] = {
        "rows": 2,
        "columns": 2,
        "thickness": 0.08,
        "spacing": 0.9,
        "tracers": 2,
        "t_end": 0.2,
        "interval": 0.1,
    }

    rows: int = Field(10, ge=1, description="cilia along y")
    columns: int = Field(10, ge=1, description="cilia along x")
    distance: float = Field(0.8, gt=0, description="between neighbours")
    thickness: float = Field(0.05, gt=0, description="radius of a cilium")
    spacing: float = Field(0.6, gt=0, description="of points along a cilium, in blob sizes")
    metachronal_wavelength: float = Field(6.4, gt=0, description="of the phases, along x")
    tracers: int = Field(8, ge=0, description="along x and along y, a quarter above the tips")
    t_end: float = Field(3.0, gt=0, description="simulated time")
    interval: float = Field(0.05, gt=0, description="simulated time between frames")

    def build(self, **common: Any) -> mrs.Simulation:
        """Return the carpet."""
        beat = mrs.Beat.read(
            "lung_cilium",
            length=1.0,
            period=1.0,
            thickness=self.thickness,
            spacing=self.spacing,
        )
        bases = mrs.geometry.grid((self.columns, self.rows), self.distance)
        ahead = bases[:, 0] / self.metachronal_wavelength
        bodies: list[mrs.Body] = [
            mrs.Prescribed(beat, positions=bases, delay=-ahead, radius=self.thickness, name="cilia")
        ]
        if self.tracers:
            apart = self.distance * max(self.rows, self.columns) / self.tracers
            above = mrs.geometry.grid((self.tracers, self.tracers), apart) + np.array([0, 0, 1.25])
            bodies.append(mrs.Tracers(above))
        epsilon = float(beat.surface.epsilon)
        fluid = mrs.Fluid(epsilon=epsilon, boundary=mrs.Wall((0.0, 0.0, -0.5 * epsilon)))
        return mrs.Simulation(fluid, bodies, **common)

    def check(self, sim: mrs.Simulation) -> mrs.Check:
        """Return the mean flux through a plane before the carpet, beside that of the loads.

        Over a period. The first is by velocities in the plane, the second by forces at the points.
        """
        x = sim.bodies[0].positions[:, 0].max() + 1.5
        wall: Any = sim.fluid.boundary
        fluxes = []
        for time in np.arange(_TIMES) / _TIMES:
            now = sim.scene.evaluate(time, sim.state)
            velocity = partial(sim.scene.velocity, now=now)
            pumped = mrs.observables.pumped_flux(now.points, now.loads, 1.0, wall=wall)
            fluxes.append([flux_through_plane(velocity, wall, x, 1.0), pumped])
        through, expected = np.mean(fluxes, axis=0).tolist()
        return mrs.Check("mean flux along the wall", through, expected, 0.01)
