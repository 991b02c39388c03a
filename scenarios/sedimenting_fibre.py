"""An elastic fibre that falls under its weight bends into a U.

The picture: each piece of the fibre drags fluid down with it. In the middle there is fluid dragged
from both sides, so that the middle falls faster than the ends, until the elastic forces hold it
back. The fibre then falls at rest in itself, as a U: the deeper, the larger weight length^2 /
bending.

    mrs run sedimenting_fibre --set bending=0.05
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import numpy as np
from pydantic import Field

import mrs


class SedimentingFibre(mrs.Scenario):
    """Options of the fibre; viscosity 1."""

    quick: ClassVar[dict[str, Any]] = {"nodes": 17, "t_end": 3.0}

    length: float = Field(2.0, gt=0, description="of the fibre")
    nodes: int = Field(41, ge=5, description="of the fibre")
    weight: float = Field(10.0, gt=0, description="of the fibre less its buoyancy, along -z")
    bending: float = Field(0.2, gt=0, description="moduli a1 = a2 = a3")
    shearing: float = Field(100.0, gt=0, description="moduli b1 = b2 = b3")
    t_end: float = Field(8.0, gt=0, description="simulated time")
    interval: float = Field(0.1, gt=0, description="simulated time between frames")

    @property
    def log_columns(self) -> Mapping[str, Callable[[mrs.Simulation], float]]:
        """How much lower the middle is than the ends."""
        return {"depth": depth}

    def build(self, **common: Any) -> mrs.Simulation:
        """Return the fibre, level along x, each of its nodes with the same weight."""
        level = mrs.geometry.straight(
            self.length, self.nodes, origin=(-0.5 * self.length, 0, 0), direction=(1, 0, 0)
        )
        fibre = mrs.Rods(
            level,
            bending=self.bending,
            twisting=self.bending,
            shearing=self.shearing,
            stretching=self.shearing,
            name="fibre",
        )
        gravity = mrs.Gravity(per_point=(0.0, 0.0, -self.weight / self.nodes))
        fluid = mrs.Fluid(epsilon=2.0 * self.length / (self.nodes - 1))
        return mrs.Simulation(fluid, [fibre], forces=[gravity], **common)

    def check(self, sim: mrs.Simulation) -> mrs.Check:
        """Return how much faster the middle falls than the ends, at the start.

        Expected is the sum of the flows of all weights (K 7.2) across the fibre. Nodes that feel
        only their own drag all fall alike, and the fibre stays straight.
        """
        (fibre,) = sim.bodies
        start = mrs.State(fibre.positions, fibre.quaternions)
        down, middle = -sim.scene.rates(0.0, start)[: self.nodes, 2], self.nodes // 2
        assert sim.fluid.epsilon is not None
        x, square = np.linspace(0.0, self.length, self.nodes), sim.fluid.epsilon**2
        apart = (x[[middle, 0], None] - x) ** 2
        of_all = ((apart + 2.0 * square) / (apart + square) ** 1.5).sum(axis=1) / (8.0 * np.pi)
        expected = self.weight / self.nodes * (of_all[0] - of_all[1])
        return mrs.Check(
            "speed of the middle beside the ends, at the start",
            float(down[middle] - down[0]),
            float(expected),
            0.01,
        )


def depth(sim: mrs.Simulation) -> float:
    """Return how much lower the middle of the fibre is than its first node."""
    z = sim.state.positions[:, 2]
    return float(z[0] - z[len(z) // 2])
