"""Random sums over a wall and in periodic boxes, and the errors that are achieved."""

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

import treecode as tc
from tests.cases.tolerance import EPSILONS, KERNELS, SETS, STRENGTHS, error_at, strengths_of

KINDS = {
    "wall": ("RegularizedStokeslet", "RegularizedStokesletRotlet", "Stokeslet"),
    "box": ("RegularizedStokeslet", "RegularizedStokesletRotlet"),
}
BACKENDS = "auto", "auto", "kitc"  # over a wall; operators of fmm by name take long to build
HEIGHTS = 0.0, 0.01, 0.3, 10.0  # of the lowest point
_CHECKED = 500  # targets at which large sums are compared


class Bounded(NamedTuple):
    """A random sum within a boundary and what is asked of it."""

    kind: str
    kernel: str
    epsilon: float
    points: str
    strengths: str
    backend: str
    height: float
    n: int
    tol: float
    seed: int

    @classmethod
    def draw(cls, seed, kind, largest):
        """Return the case with a number: tolerances and sizes are uniform in their logarithms."""
        rng = np.random.default_rng([seed, 5])
        return cls(
            kind,
            str(rng.choice(KINDS[kind])),
            float(rng.choice(EPSILONS)),
            str(rng.choice(list(SETS))),
            str(rng.choice(STRENGTHS)),
            str(rng.choice(BACKENDS)) if kind == "wall" else "auto",
            float(rng.choice(HEIGHTS)),
            int(10.0 ** rng.uniform(2.0, np.log10(largest))),
            float(f"{10.0 ** rng.uniform(-9.0, -2.0):.1e}"),
            seed,
        )

    def make(self):
        """Return kernel, points, strengths and boundary: any plane, or any cell."""
        rng = np.random.default_rng([self.seed, 6])
        kernel = KERNELS[self.kernel](self.epsilon)
        points, q = strengths_of(self.strengths, kernel, SETS[self.points](self.n, rng), rng)
        if self.kind == "box":
            cell = np.eye(3) + np.triu(rng.uniform(-0.3, 0.3, (3, 3)))
            return kernel, points, q, tc.Periodic(cell * 10.0 ** rng.uniform(-0.3, 0.5))
        points[:, 2] += self.height - points[:, 2].min()
        turn, origin = Rotation.random(random_state=self.seed), rng.standard_normal(3)
        wall = tc.Wall(origin, turn.apply([0.0, 0.0, 1.0]))
        return kernel, turn.apply(points) + origin, q, wall


def solve(case):
    """Return the achieved error, of velocities and of angular velocities, and what was chosen.

    By the exact sums within the boundary, which other tests compare with oracles. What is refused
    has no error.
    """
    kernel, points, q, boundary = case.make()
    plan = tc.Plan(kernel, case.backend, tol=case.tol, boundary=boundary).set_points(points)
    try:
        values = plan.execute(q)
    except tc.ToleranceError:
        return 0.0, "refused"
    drawn = np.random.default_rng(7).permutation(len(points))[:_CHECKED]
    exact = tc.evaluate(kernel, points, q, points[drawn], backend="direct", boundary=boundary)
    units = [slice(start, start + 3) for start in range(0, exact.shape[1], 3)]
    error = max(error_at(drawn, values[:, unit], exact[:, unit]) for unit in units)
    return error, str(plan.choice)
