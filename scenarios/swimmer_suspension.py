"""Swimmers in a periodic box, pushing or pulling themselves through fluid that all of them stir.

The picture: the pairs of particles of K 8.1 come to life. At first they point anywhere; where they
meet they turn each other, and repel each other before they touch. Tracers between them are stirred.

    mrs run swimmer_suspension --set count=500 --set stroke=puller
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import Field
from scipy.special import erfc

import mrs
from mrs.scenarios.helical_swimmer import flow

# Images of a box are cut off at this distance, smoothly over that width, in boxes: without net
# forces, velocities of 60 swimmers are then right to 3e-4.
_CUTOFF, _WIDTH = 1.875, 0.75
_FARTHEST = 4.0


class SwimmerSuspension(mrs.Scenario):
    """Options of the suspension; the unit of length is a swimmer's length."""

    quick: ClassVar[dict[str, Any]] = {
        "count": 60,
        "size": 5.0,
        "tracers": 60,
        "t_end": 1.0,
        "interval": 0.1,
    }

    count: int = Field(1000, ge=1, description="swimmers")
    size: float = Field(12.0, gt=0, description="edge of the box in which they start")
    periodic: bool = Field(True, description="whether the box repeats itself in all directions")
    tracers: int = Field(500, ge=0, description="points that follow the fluid")
    stroke: Literal["pusher", "puller"] = Field("pusher", description="flagellum behind or before")
    force: float = Field(1.0, gt=0, description="thrust")
    epsilon: float = Field(0.1, gt=0, description="blob size of both particles")
    tumble_rate: float = Field(0.0, ge=0, description="tumbles of a swimmer per time")
    repulsion: float = Field(4.0, ge=0, description="steric force at contact; 0 for none")
    seed: int = Field(0, ge=0, description="of the random start, and of tumbles")
    t_end: float = Field(10.0, gt=0, description="simulated time")
    interval: float = Field(0.1, gt=0, description="simulated time between frames")

    @property
    def log_columns(self) -> Mapping[str, Callable[[mrs.Simulation], Any]]:
        """How far tracers went, and how swimmers are aligned with those near them.

        The latter is a mean for each length of distance, in small boxes for each sixth of a box.
        """
        bins = min(1.0, self.size / 6.0) * np.arange(4)
        aligned = mrs.observables.OrientationCorrelation("swimmers", bins)
        spread = mrs.observables.MeanSquareDisplacement("tracers")
        return {"alignment": aligned} | ({"tracers_msd": spread} if self.tracers else {})

    def build(self, **common: Any) -> mrs.Simulation:
        """Return the suspension."""
        reach = 1.0 if self.stroke == "pusher" else -1.0
        positions, orientations = mrs.random_suspension(
            self.count,
            self.size,
            2.0 * self.epsilon,
            reach=reach,
            seed=self.seed,
            periodic=self.periodic,
        )
        swimmers = mrs.Swimmers(
            positions,
            orientations,
            length=1.0,
            force=self.force,
            stroke=self.stroke,
            tumble_rate=self.tumble_rate,
            seed=self.seed,
        )
        drawn = np.random.default_rng((self.seed, 1)).random((self.tracers, 3))
        bodies = [swimmers, mrs.Tracers(self.size * (drawn - 0.5))]
        box: dict[str, Any] = {}
        if self.periodic:
            box["boundary"] = mrs.Periodic(np.full(3, self.size))
        forces = [mrs.Steric(self.repulsion, self.epsilon)] if self.repulsion else []
        return mrs.Simulation(
            mrs.Fluid(epsilon=self.epsilon, **box), bodies, forces=forces, **common
        )

    def check(self, sim: mrs.Simulation) -> mrs.Check:
        """Return the median speed of up to 30 swimmers across their orientation.

        Expected is the same median with velocities from the sum of K eq. (7.2), written out,
        without a swimmer's own thrust; in a periodic box over images as well. A swimmer alone
        moves straight on, but for its images. A swimmer that feels only its own drag does so as
        well, unless another one touches it.
        """
        swimmers = sim.bodies[0]
        assert isinstance(swimmers, mrs.Swimmers)
        now = sim.now
        thrust, _ = swimmers.loads(sim.time, sim.state)
        points, loads = now.points[: 2 * self.count], now.loads[: 2 * self.count]
        sample = min(self.count, 30)

        def by_others(i: int) -> np.ndarray:
            sources, weights = self._images(points, i)
            forces = weights[:, :, None] * loads
            own = [i, i + self.count]
            forces[0, own] -= thrust[own]
            with_torques = np.pad(forces.reshape(-1, 3), ((0, 0), (0, 3)))  # of zero
            return flow(points[[i]], sources.reshape(-1, 3), with_torques, sim.fluid)[0]

        along = swimmers.orientations(sim.body_state(swimmers).quaternions)[:sample]

        def across(velocity: np.ndarray) -> float:
            return float(np.median(np.linalg.norm(np.cross(along, velocity), axis=1)))

        return mrs.Check(
            "median speed across the orientation",
            across(now.motion[:sample]),
            across(np.array([by_others(i) for i in range(sample)])),
            0.01,
        )

    def _images(self, points: np.ndarray, i: int) -> tuple[np.ndarray, np.ndarray]:
        """Return images of all particles about swimmer i, (M, 2 n, 3), and their weights, (M, 2 n).

        The first are the particles nearest to it, with the swimmer itself. In free space they are
        all, with the weight 1.
        """
        if not self.periodic:
            return points[None], np.ones((1, len(points)))
        apart = points[: self.count] - points[i]
        near = points - self.size * np.tile(np.round(apart / self.size), (2, 1))
        far = int(_FARTHEST)
        boxes = np.stack(np.meshgrid(*[np.arange(-far, far + 1)] * 3), axis=-1).reshape(-1, 3)
        distance = np.linalg.norm(boxes, axis=1)
        boxes = boxes[np.argsort(distance, kind="stable")][: np.sum(distance < _FARTHEST)]
        images = near + self.size * boxes[:, None]
        distance = np.linalg.norm(images - points[i], axis=2) / self.size
        return images, 0.5 * erfc((distance - _CUTOFF) / _WIDTH)
