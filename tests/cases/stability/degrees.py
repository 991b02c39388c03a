"""Section 1: barycentric interpolation to degree 20."""

import numpy as np

import treecode as tc
from tests.cases.oracle import KERNELS, UNIT, exact, random_case, sizes
from tests.cases.stability.findings import at_most, case
from tests.cases.stability.sums import name_of, plan_of


def lagrange(degree, x):
    """Return the Lagrange polynomials of the Chebyshev points at x as products, (x, n + 1)."""
    nodes = np.cos(np.arange(degree + 1) * np.arccos(np.longdouble(-1)) / degree)
    factors = (x[:, None, None] - nodes) / (nodes[:, None] - nodes + np.eye(degree + 1))
    factors[:, range(degree + 1), range(degree + 1)] = 1
    return factors.prod(axis=2)


@case("1. Condition of the barycentric weights, degrees 1 to 20")
def lebesgue_constants():
    """One source at the worst place of a box: the sum of its |weights| over the Chebyshev points.

    It is the cube of the Lebesgue function, for which there is a product formula, and at most
    1 + (2/pi) log(n + 1) cubed. Barycentric weights carry some 5 n roundings in a coordinate.
    """
    differences, growth = [], []
    for degree in range(1, 21):
        x = np.linspace(-1.0, 1.0, 1001).astype(np.longdouble)
        worst = x[[abs(lagrange(degree, x)).sum(axis=1).argmax()]]
        constant = abs(lagrange(degree, worst)).sum()
        corners = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), axis=-1).reshape(-1, 3)
        points = np.concatenate([np.full(((degree + 1) ** 3, 3), float(worst[0])), corners])
        strengths = np.zeros_like(points)
        strengths[0, 0] = 1.0
        plan = plan_of(tc.Stokeslet(), "kitc", degree=degree, leaf_size=len(points))
        plan.set_points(points, [[9.0, 0.0, 0.0]]).execute(strengths)
        found = abs(plan._sum._expansion.weights[0, 0]).sum()
        rounded = 3 * 5 * degree * UNIT * constant  # those of each weight
        differences.append(abs(found / constant**3 - 1) / rounded)
        growth.append(found / (1.0 + 2.0 / np.pi * np.log(degree + 1.0)) ** 3)
    yield at_most("relative difference to the product formula, in roundings", max(differences), 1)
    yield at_most("sum of weights over (1 + (2/pi) log(n + 1))^3", max(growth), 1)


@case("1. Error against degree, to 20")
def error_against_degree():
    """One box seen from four and from twenty half sides; half the sources within ulps of its nodes.

    The error falls until it is rounding, and stays there: a rounding of a source's own terms grows
    by the Lebesgue constant in each coordinate, 25 in three at degree 20. Errors are in units of
    the sum of the terms' sizes.
    """
    count = 10_000
    rng = np.random.default_rng(2)
    nodes = np.cos(np.arange(21) * np.pi / 20)
    off = 10.0 ** rng.uniform(-17, -8, (count // 2, 3))
    off *= rng.choice([-1.0, 0.0, 1.0], off.shape)
    on_nodes = np.clip(rng.choice(nodes, off.shape) + off, -1.0, 1.0)
    on_nodes[:2] = [[-1.0] * 3, [1.0] * 3]  # the box
    ways = rng.normal(size=(20, 3))
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    targets = np.concatenate([4.0 * ways, 20.0 * ways])
    for kernel in KERNELS:
        points, strengths, _ = random_case(kernel, count, 1)
        points[: count // 2] = on_nodes
        given = kernel, points, strengths, targets
        expected, size, errors = exact(*given), sizes(*given), []
        for degree in range(1, 21):
            plan = plan_of(kernel, "kitc", degree=degree, leaf_size=count)
            values = plan.set_points(points, targets).execute(strengths)
            assert plan.info()["near_pairs"] == 0
            errors.append((abs(values - expected) / size).reshape(2, -1).max(axis=1))
        near, far = np.array(errors).T / UNIT
        falls = (near[1:] / near[:-1])[near[1:] > 25].max()
        where = name_of(kernel)
        yield at_most(f"{where}: from one degree to the next, above rounding", falls, 0.9)
        yield at_most(f"{where}: roundings at degree 20, near by", near[-1], 25)
        yield at_most(f"{where}: roundings at degrees 10 to 20, far away", far[9:].max(), 25)
