"""Swimmers in a cube, pushing or pulling themselves through the fluid that all of them stir.

The picture: the pairs of particles of K 8.1 come to life. At first they point anywhere; where they
meet they turn each other, and repel each other before they touch.

    mrs run swimmer_suspension --set count=500 --set stroke=puller
"""

from __future__ import annotations

from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import Field

import mrs
from mrs.scenarios.helical_swimmer import flow


class SwimmerSuspension(mrs.Scenario):
    """Options of the suspension; the unit of length is a swimmer's length."""

    quick: ClassVar[dict[str, Any]] = {"count": 60, "size": 5.0, "t_end": 2.0, "interval": 0.1}

    count: int = Field(1000, ge=1, description="swimmers")
    size: float = Field(12.0, gt=0, description="edge of the cube in which they start")
    stroke: Literal["pusher", "puller"] = Field("pusher", description="flagellum behind or before")
    force: float = Field(1.0, gt=0, description="thrust")
    epsilon: float = Field(0.1, gt=0, description="blob size of both particles")
    repulsion: float = Field(4.0, ge=0, description="steric force at contact; 0 for none")
    seed: int = Field(0, ge=0, description="of the random start")
    t_end: float = Field(10.0, gt=0, description="simulated time")
    interval: float = Field(0.1, gt=0, description="simulated time between frames")

    def build(self, **common: Any) -> mrs.Simulation:
        """Return the suspension."""
        reach = 1.0 if self.stroke == "pusher" else -1.0
        positions, orientations = mrs.random_suspension(
            self.count, self.size, 2.0 * self.epsilon, reach=reach, seed=self.seed
        )
        swimmers = mrs.Swimmers(
            positions, orientations, length=1.0, force=self.force, stroke=self.stroke
        )
        forces = [mrs.Steric(self.repulsion, self.epsilon)] if self.repulsion else []
        return mrs.Simulation(mrs.Fluid(epsilon=self.epsilon), [swimmers], forces=forces, **common)

    def check(self, sim: mrs.Simulation) -> mrs.Check:
        """Return the median speed of up to 100 swimmers across their orientation.

        Expected is the same median with velocities from the sum of K eq. (7.2), written out,
        without a swimmer's own thrust. A swimmer alone moves straight on. A swimmer that feels only
        its own drag does so as well, unless another one touches it.
        """
        (swimmers,) = sim.bodies
        assert isinstance(swimmers, mrs.Swimmers)
        now = sim.now
        thrust, _ = swimmers.loads(sim.time, sim.state)
        sample = min(self.count, 100)

        def by_others(i: int) -> np.ndarray:
            own, others = [i, i + self.count], now.loads.copy()
            others[own] -= thrust[own]
            loads = np.pad(others, ((0, 0), (0, 3)))  # no torques
            return flow(now.points[[i]], now.points, loads, sim.fluid)[0]

        along = swimmers.orientations(sim.state.quaternions)[:sample]

        def across(velocity: np.ndarray) -> float:
            return float(np.median(np.linalg.norm(np.cross(along, velocity), axis=1)))

        return mrs.Check(
            "median speed across the orientation",
            across(now.motion[:sample]),
            across(np.array([by_others(i) for i in range(sample)])),
            0.01,
        )
