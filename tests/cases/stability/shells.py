"""Section 5: points that crowd about a corner."""

import numpy as np

import treecode as tc
from tests.cases.oracle import exact, random_case, sizes
from tests.cases.stability.findings import at_most, case
from tests.cases.stability.sums import plan_of


@case("5. Points in 60 nested shells")
def nested_shells():
    """Each shell of 1000 points is half as large as the one before, about a corner.

    Pairs of a target, of degree 3: an outer shell costs it seven boxes of 64 terms, on
    average there are 30, and what is around it costs what it would in uniform points. Depth: one
    level a shell and two in the last. Bytes of a point: 32 for itself; 2/12.5 clusters of 112 bytes
    (an eighth of a leaf of 100 points is 12.5); expansions of 24 bytes a term, with a chain of 60
    and geometrically fewer above those that hold 64 points. About 1/3 the innermost shells are at
    the resolution of doubles: there the bound allows for coordinates that are off by an ulp.
    """
    levels, shell, theta, degree = 60, 1000, 0.7, 3
    count, terms = levels * shell, (degree + 1) ** 3
    kernel = tc.Stokeslet()
    uniform, strengths, _ = random_case(kernel, count, 9)
    options = {"theta": theta, "degree": degree, "leaf_size": 100}
    plan = plan_of(kernel, "kitc", **options).set_points(uniform)
    plan.execute(strengths)
    around = sum(plan.info()[k] for k in ("near_pairs", "far_pairs")) / count
    rows = np.random.default_rng(10).permutation(count)[:40]
    for corner in (0.0, 1 / 3):
        points = corner + _shells(levels, shell)
        plan = plan_of(kernel, "kitc", **options).set_points(points)
        values = plan.execute(strengths)[rows]
        info, where = plan.info(), f"about {corner:.3g}"
        pairs = (info["near_pairs"] + info["far_pairs"]) / count
        yield at_most(f"{where}: pairs of a target", pairs, levels / 2 * 7 * terms + around)
        yield at_most(f"{where}: depth", info["depth"], levels + 2)
        chain = levels * 24 * terms / count
        bound = 32 + 2 / 12.5 * 112 + 24 * 8 / 7 + chain
        yield at_most(f"{where}: bytes a point", info["bytes"] / count, bound)
        given = kernel, points, strengths, points[rows]
        error = abs(values - exact(*given))
        allowed = theta ** (degree + 1) * sizes(*given)
        if corner:
            ulp = np.spacing(corner)
            r = np.linalg.norm(points[rows, None] - points, axis=-1)
            moved = np.linalg.norm(strengths, axis=1) / np.maximum(r, ulp) ** 2
            allowed = allowed + ulp * moved.sum(axis=1)[:, None]
        yield at_most(f"{where}: largest error over its bound", (error / allowed).max(), 1)


@case("5. Points in 60 nested shells, by fmm", tol=1e-6)
def nested_shells_by_fmm(tol):
    """The same shells: cubes 2^-48 as wide as the root, and the twelve innermost shells in one.

    Each target's error beside the sizes of its terms, which those of its own shell are. Pairs and
    bytes beside those of uniform points: three times as many, of which twelve shells cost each
    other 12 * 12 / 60 shells more, and half as many bytes again.
    """
    levels, shell = 60, 1000
    count = levels * shell
    kernel = tc.Stokeslet()
    uniform, strengths, _ = random_case(kernel, count, 9)
    plan = tc.Plan(kernel, "fmm", tol=tol).set_points(uniform)
    plan.execute(strengths)
    usual = plan.info()
    rows = np.arange(shell // 2, count, shell)
    for corner in (0.0, 1 / 3):
        points = corner + _shells(levels, shell)
        plan.set_points(points)
        values = plan.execute(strengths)[rows]
        info, where = plan.info(), f"about {corner:.3g}"
        found, around = (
            (given["near_pairs"] + given["far_pairs"]) / count for given in (info, usual)
        )
        yield at_most(f"{where}: pairs of a target", found, 3 * around + 12 * 12 / 60 * shell)
        yield at_most(f"{where}: depth", info["depth"], 48)
        found = info["bytes"] / usual["bytes"]
        yield at_most(f"{where}: bytes beside those of uniform points", found, 1.5)
        given = kernel, points, strengths, points[rows]
        found = (abs(values - exact(*given)) / sizes(*given)).max() / tol
        yield at_most(f"{where}: largest error over the terms' sizes, over tol", found, 1)


def _shells(levels, count):
    """Return points of cubes about the origin, each half as wide as the one before, outside it."""
    points = np.random.default_rng(0).random((levels, 2 * count, 3))
    shells = [shell[shell.max(axis=1) > 0.5][:count] for shell in points]
    return np.concatenate(shells) * np.repeat(0.5 ** np.arange(levels), count)[:, None]
