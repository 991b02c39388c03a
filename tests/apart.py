"""Random sums at targets apart from their sources, and the errors that are achieved."""

from typing import NamedTuple

import numpy as np
from test_tolerance import EPSILONS, KERNELS, SETS, STRENGTHS, strengths_of

import oracle
import treecode as tc

PLACES = {"inside": 0.0, "near": 1.0, "far": 30.0, "very far": 1e4}  # in widths of the sources
BACKENDS = "auto", "fmm"
_ORACLE = 3 * 10**6  # pairs, up to which the oracle sums; more are direct sums
_AT_A_TIME = 10**6


class Apart(NamedTuple):
    """A random sum, where its targets are and what is asked of it.

    Half of the targets are a group of their own among the sources, if `grouped`.
    """

    kernel: str
    epsilon: float
    points: str
    strengths: str
    place: str
    grouped: bool
    backend: str
    n: int
    m: int
    tol: float
    seed: int

    @classmethod
    def draw(cls, seed, smallest, largest):
        """Return the case with a number; tolerances of "fmm" are those of few operators."""
        rng = np.random.default_rng([seed, 3])
        backend = str(rng.choice(BACKENDS))
        exponent = rng.uniform(-8.0, -2.0) if backend == "auto" else -0.5 * rng.integers(4, 9)
        return cls(
            str(rng.choice(list(KERNELS))),
            float(rng.choice(EPSILONS)),
            str(rng.choice(list(SETS))),
            str(rng.choice(STRENGTHS)),
            str(rng.choice(list(PLACES))),
            bool(rng.choice([False, True])),
            backend,
            int(10.0 ** rng.uniform(*np.log10([smallest, largest]))),
            int(10.0 ** rng.uniform(2.0, 3.0)),
            float(f"{10.0**exponent:.1e}"),
            seed,
        )

    def make(self):
        """Return kernel, sources, strengths, targets and their groups."""
        rng = np.random.default_rng([self.seed, 4])
        kernel = KERNELS[self.kernel](self.epsilon)
        sources, q = strengths_of(self.strengths, kernel, SETS[self.points](self.n, rng), rng)
        targets = rng.random((self.m, 3))
        direction = rng.standard_normal(3)
        direction *= PLACES[self.place] / np.linalg.norm(direction)
        groups = np.arange(self.m) % 2 if self.grouped else np.ones(self.m, int)
        targets[groups == 1] += direction
        return kernel, sources, q, targets, groups


def achieved(kernel, sources, q, targets, groups, values):
    """Return the largest relative error, K eq. (8.1), of groups and units."""
    if len(sources) * len(targets) <= _ORACLE:
        parts = np.array_split(targets, -(-len(sources) * len(targets) // _AT_A_TIME))
        exact = np.concatenate([oracle.exact(kernel, sources, q, part) for part in parts])
    else:
        exact = tc.evaluate(kernel, sources, q, targets, backend="direct")
    return max(
        tc.relative_error(values[groups == group, unit], exact[groups == group, unit].astype(float))
        for group in set(groups)
        for unit in (slice(0, 3), slice(3, 6))[: exact.shape[1] // 3]
    )


def solve(case):
    """Return the achieved error and what has been chosen; what is refused has no error."""
    kernel, sources, q, targets, groups = case.make()
    plan = tc.Plan(kernel, case.backend, tol=case.tol).set_points(sources, targets, groups)
    try:
        values = plan.execute(q)
    except tc.ToleranceError:
        return 0.0, "refused"
    return achieved(kernel, sources, q, targets, groups, values), str(plan.choice)
