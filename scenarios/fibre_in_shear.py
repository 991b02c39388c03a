"""A flexible fibre tumbles in shear flow, among tracers that show the flow.

The picture: U = (rate z, 0, 0) carries the fibre round. Stiff, it turns over as a rigid rod does;
soft against the shear, it buckles while the flow compresses it.

    mrs run fibre_in_shear --set bending=0.05
"""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from pydantic import Field

import mrs


class FibreInShear(mrs.Scenario):
    """Options of the fibre; viscosity 1."""

    quick: ClassVar[dict[str, Any]] = {"nodes": 21, "t_end": 2.0, "tracers": 100}

    length: float = Field(2.0, gt=0, description="of the fibre")
    nodes: int = Field(41, ge=5, description="of the fibre")
    rate: float = Field(1.0, gt=0, description="of the shear")
    angle: float = Field(
        0.2, description="of the fibre from the z axis against the flow at the start, radians"
    )
    bending: float = Field(1.0, gt=0, description="moduli a1 = a2 = a3")
    shearing: float = Field(100.0, gt=0, description="moduli b1 = b2 = b3")
    tracers: int = Field(500, ge=0, description="points that follow the flow")
    t_end: float = Field(10.0, gt=0, description="simulated time")
    interval: float = Field(0.1, gt=0, description="simulated time between frames")

    def build(self, **common: Any) -> mrs.Simulation:
        """Return the fibre and the tracers."""
        along = np.array([-np.sin(self.angle), 0.0, np.cos(self.angle)])
        line = mrs.geometry.straight(
            self.length, self.nodes, origin=-0.5 * self.length * along, direction=along
        )
        fibre = mrs.Rods(
            line,
            bending=self.bending,
            twisting=self.bending,
            shearing=self.shearing,
            stretching=self.shearing,
            name="fibre",
        )
        points = (np.random.default_rng(0).random((self.tracers, 3)) - 0.5) * 2.0 * self.length
        fluid = mrs.Fluid(
            epsilon=2.0 * self.length / (self.nodes - 1), background=mrs.flows.shear(self.rate)
        )
        return mrs.Simulation(fluid, [fibre, mrs.Tracers(points)], **common)

    def check(self, sim: mrs.Simulation) -> mrs.Check:
        """Return the largest speed that the fibre gives a tracer beyond one and a half lengths.

        Expected is the flow of its force dipole: far away, every body without net force and net
        torque has this flow (Batchelor 1970, J. Fluid Mech. 41, 545). The next term is less than
        a fifth. Tracers carry no forces: with nothing but their own drag they follow the shear.
        """
        now = sim.now
        fibre, tracers = np.split(now.points, [self.nodes])
        disturbance = now.motion[self.nodes :, :3] - sim.fluid.flow("velocity", tracers, sim.time)
        centre = fibre.mean(axis=0)
        dipole = (fibre - centre).T @ now.loads[: self.nodes, :3]
        r = tracers - centre
        far = np.linalg.norm(r, axis=1) > 1.5 * self.length
        square = (r[far] ** 2).sum(axis=1)
        along = np.einsum("ni,ij,nj->n", r[far], dipole, r[far]) / square
        outward = (3.0 * along - np.trace(dipole)) / (8.0 * np.pi * square)
        return mrs.Check(
            "largest speed of far tracers beside the shear",
            float(np.linalg.norm(disturbance[far], axis=1).max(initial=0.0)),
            float(np.abs(outward).max(initial=0.0)),
            0.2,
        )
