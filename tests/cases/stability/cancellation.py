"""Section 2: sums that are small beside their terms."""

import math
from typing import NamedTuple

import numpy as np

import treecode as tc
from tests.cases.oracle import UNIT, exact, sizes
from tests.cases.stability.findings import at_least, at_most, case
from tests.cases.stability.sums import THETA, plan_of, truncation

APART = 1e-6  # distance in a pair
LEAF_SIZE = 1000


class _Pairs(NamedTuple):
    """Forces at points that come in pairs, and their sums at the targets."""

    kernel: tc.Kernel
    sources: np.ndarray
    targets: np.ndarray
    forces: tuple
    """Random ones, and ones that are opposite in each pair."""
    sums: list
    """Exact, of both."""
    sizes: np.ndarray
    """Sums of the sizes of terms, of random forces."""
    squares: float
    """Root of the sum of the squares of all terms, of random forces."""
    dipoles: float
    """Size of the sums of what each pair of opposite forces adds up to."""


@case("2. Strong cancellation", slow=True, count=1_000_000, samples=100)
@case("2. Strong cancellation", count=20_000, samples=50)
def cancellation(count, samples):
    """Forces at points that come in pairs, 1e-6 apart; the error is sampled at targets.

    Random forces less their mean: an error is at most theta^(p+1) of the terms' sizes, but for
    their roundings, 32 units. Such errors add up as the sum itself does, to the root of the sum of
    squares; five times that, and sqrt(N) roundings of the sum, bound the error over the sum.

    Opposite forces in each pair: a cluster that holds both errs by a derivative, so that the error
    over what the pairs add up to, |f| d / R^2, is that of random forces over their sizes, times
    (p + 2) / theta. The faces of the smallest boxes part a share 1.5 d / side of the pairs, whose
    errors are those of random forces. Roundings do not cancel. The error of "fmm" is of degree n
    in a cube of half side h, where it changes by at most n^2/h times its size (Markov).
    """
    pairs = _pairs(count, samples)
    terms, (any_sum, pair_sum) = np.linalg.norm(pairs.sizes), map(np.linalg.norm, pairs.sums)
    yield at_least("random forces: terms' sizes over the sum", terms / any_sum, 300)
    yield at_least("opposite forces: terms' sizes over the sum", terms / pair_sum, 1e8)
    for backend, degree in (("direct", 1), ("kitc", 8), ("taylor", 8)):
        yield from _by_degree(pairs, backend, degree)
    yield from _by_fmm(pairs, 1e-8)


def _pairs(count, samples):
    """Return `count` points in the cube [-1, 1]^3, and exact sums at `samples` targets there."""
    rng = np.random.default_rng(0)
    half = count // 2
    points, force = rng.uniform(-1.0, 1.0, (half, 3)), rng.uniform(-1.0, 1.0, (half, 3))
    aside = rng.normal(size=(half, 3))
    aside *= APART / np.linalg.norm(aside, axis=1)[:, None]
    order = rng.permutation(count)
    sources = np.concatenate([points, points + aside])[order]
    opposite = np.concatenate([force, -force])[order]
    drawn = rng.uniform(-1.0, 1.0, (count, 3))
    drawn -= drawn.mean(axis=0)
    kernel = tc.RegularizedStokeslet(epsilon=count ** (-1 / 3))
    targets = rng.uniform(-1.0, 1.0, (samples, 3))

    def reference(function, strengths):
        return np.concatenate([function(kernel, sources, strengths, x[None]) for x in targets])

    gradients = [_powers(kernel, points, force, 2, x).sum() for x in targets]
    return _Pairs(
        kernel,
        sources,
        targets,
        forces=(drawn, opposite),
        sums=[reference(exact, strengths) for strengths in (drawn, opposite)],
        sizes=reference(sizes, drawn),
        squares=np.linalg.norm([_powers(kernel, sources, drawn, 1, x) for x in targets]),
        dipoles=APART * np.linalg.norm(gradients),
    )


def _powers(kernel, points, forces, power, target):
    """Return 4 |f| / (8 pi mu R^power), of a term or, for the second power, of its gradient."""
    R2 = ((points - target) ** 2).sum(axis=1) + kernel.epsilon**2
    return np.linalg.norm(forces, axis=1) * R2 ** (-0.5 * power) / (2.0 * np.pi * kernel.viscosity)


def _errors(pairs, plan):
    """Return the absolute errors of a plan, of random and of opposite forces."""
    plan.set_points(pairs.sources, pairs.targets)
    both = zip(pairs.forces, pairs.sums, strict=True)
    return [abs(plan.execute(strengths) - expected) for strengths, expected in both]


def _by_degree(pairs, backend, degree):
    plan = plan_of(pairs.kernel, backend, degree=degree, leaf_size=LEAF_SIZE)
    of_any, of_pairs = _errors(pairs, plan)
    terms, (any_sum, pair_sum) = np.linalg.norm(pairs.sizes), map(np.linalg.norm, pairs.sums)
    count = len(pairs.sources)
    name = backend if backend == "direct" else f"{backend}, degree {degree}"
    bound = truncation(backend, degree) + 32 * UNIT
    yield at_most(f"{name}, random forces: error over sizes", (of_any / pairs.sizes).max(), bound)
    relative = np.linalg.norm(of_any) / any_sum
    bound_of_any = 5.0 * (bound + math.sqrt(count) * UNIT) * pairs.squares / any_sum
    yield at_most(f"{name}, random forces: error over the sum", relative, bound_of_any)
    found = (of_pairs / pairs.sizes).max()
    yield at_most(f"{name}, opposite forces: error over sizes", found, bound)
    bound = 32 * UNIT * terms
    if backend != "direct":
        side = 2.0 * (LEAF_SIZE / 8 / count) ** (1 / 3)
        bound += (degree + 2) / THETA * np.linalg.norm(of_any) / terms * pairs.dipoles
        bound += math.sqrt(1.5 * APART / side) * np.linalg.norm(of_any)
    relative = np.linalg.norm(of_pairs) / pair_sum
    yield at_most(f"{name}, opposite forces: error over the sum", relative, bound / pair_sum)


def _by_fmm(pairs, tol):
    plan = tc.Plan(pairs.kernel, "fmm", tol=tol)
    of_any, of_pairs = map(np.linalg.norm, _errors(pairs, plan))
    terms, (any_sum, pair_sum) = np.linalg.norm(pairs.sizes), map(np.linalg.norm, pairs.sums)
    info, name = plan.info(), f"fmm, tol {tol:g}"
    bound = tol * pairs.squares / any_sum
    yield at_most(f"{name}, random forces: error over the sum", of_any / any_sum, bound)
    half = plan._sum._tree.half(info["depth"])
    change = APART * info["degree"] ** 2 / half + math.sqrt(1.5 * APART / (2.0 * half))
    bound = (32 * UNIT * terms + change * tol * pairs.squares) / pair_sum
    yield at_most(f"{name}, opposite forces: error over the sum", of_pairs / pair_sum, bound)
