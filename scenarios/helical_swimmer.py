"""A free elastic flagellum that swims by a wave of twisted curvature running along it.

The picture: the preferred curvature turns about the rod as it travels, so the rod is a rotating
corkscrew without a motor. Nothing holds it: it swims against the wave, and spins.

    mrs run helical_swimmer --set curvature=0.5
"""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from pydantic import Field

import mrs


class HelicalSwimmer(mrs.Scenario):
    """Options of the flagellum; micrometres, grams times 1e-6 and seconds, say; viscosity 1."""

    quick: ClassVar[dict[str, Any]] = {"nodes": 41, "epsilon": 0.25, "t_end": 1.0}

    length: float = Field(10.0, gt=0, description="of the rod")
    nodes: int = Field(101, ge=5, description="of the rod")
    epsilon: float | None = Field(
        None, gt=0, description="blob size; by default two spacings of the nodes"
    )
    curvature: float = Field(0.5, gt=0, description="preferred, radians per length")
    wavelength: float = Field(5.0, gt=0, description="of the wave")
    period: float = Field(1.0, gt=0, description="of the wave")
    bending: float = Field(10.0, gt=0, description="moduli a1 = a2 = a3")
    shearing: float = Field(400.0, gt=0, description="moduli b1 = b2 = b3")
    t_end: float = Field(5.0, gt=0, description="simulated time")
    interval: float = Field(0.05, gt=0, description="simulated time between frames")

    def build(self, **common: Any) -> mrs.Simulation:
        """Return the flagellum."""
        k, omega, curvature = 2 * np.pi / self.wavelength, 2 * np.pi / self.period, self.curvature

        def corkscrew(s: np.ndarray, t: np.ndarray) -> np.ndarray:
            phase = k * s - omega * t
            return curvature * np.column_stack([np.cos(phase), np.sin(phase), np.zeros_like(s)])

        rod = mrs.Rods(
            mrs.geometry.straight(self.length, self.nodes),
            bending=self.bending,
            twisting=self.bending,
            shearing=self.shearing,
            stretching=self.shearing,
            intrinsic_curvature=corkscrew,
            name="flagellum",
        )
        epsilon = self.epsilon or 2.0 * self.length / (self.nodes - 1)
        return mrs.Simulation(mrs.Fluid(epsilon=epsilon), [rod], **common)

    def check(self, sim: mrs.Simulation) -> mrs.Check:
        """Return the net force on the fluid in units of the sum of all forces' sizes."""
        loads = sim.now.loads[:, :3]
        return mrs.Check(
            "net force", float(np.linalg.norm(loads.sum(axis=0)) / np.abs(loads).sum()), 0.0, 1e-12
        )
