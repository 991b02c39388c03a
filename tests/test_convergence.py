"""The error of an expansion falls with its degree at the rate that theta sets.

For one cluster of radius r seen from a distance R the interpolation error of a kernel that is
analytic but for its singularity falls like rho^-n, where rho is the sum of the half axes
of the largest ellipse, in units of the half side, that reaches no singularity; the Taylor error
falls like (r/R)^p. An odd degree more or less, and the factor in front, are the slack: the
observed rate is a fit over all degrees, and has to reach 0.8 of the logarithm of the bound.
"""

import math

import numpy as np

import treecode as tc
from tests.cases.oracle import each_kernel, each_treecode, random_case

DEGREES = {"kitc": range(1, 13), "taylor": range(13)}


def rate(degrees, errors):
    """Return the factor by which one more degree divides the error, above rounding."""
    degrees, errors = np.array(degrees), np.array(errors)
    resolved = errors > 1e-13
    return math.exp(-np.polyfit(degrees[resolved], np.log(errors[resolved]), 1)[0])


def bound(backend, distance):
    """Return the factor of the theory for a cube [-1, 1]^3 and targets at `distance` from 0."""
    radius = math.sqrt(3.0)
    if backend == "taylor":
        return distance / radius
    # Nearest singularity seen along one axis from a corner of the cube.
    gap = distance - radius
    z = complex(1.0, gap)
    return abs(z + np.sqrt(z * z - 1))


@each_treecode
@each_kernel
def test_one_cluster(kernel, backend):
    """Far targets and one cluster with an expansion: the error is that of the expansion alone."""
    n, distance = 3000, 4.0
    rng = np.random.default_rng(0)
    points, strengths = rng.uniform(-1, 1, (n, 3)), random_case(kernel, n, 1)[1]
    points[:8] = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), -1).reshape(8, 3)  # fixes the box
    direction = rng.standard_normal((50, 3))
    targets = distance * direction / np.linalg.norm(direction, axis=1, keepdims=True)
    exact = tc.evaluate(kernel, points, strengths, targets, backend="direct")
    errors = []
    for degree in DEGREES[backend]:
        plan = tc.Plan(kernel, backend, theta=0.5, degree=degree, leaf_size=n)
        values = plan.set_points(points, targets).execute(strengths)
        assert plan.info()["near_pairs"] == 0
        assert plan.info()["clusters"] == 1
        errors.append(tc.relative_error(values, exact))
    assert math.log(rate(DEGREES[backend], errors)) > 0.8 * math.log(bound(backend, distance))
    assert errors[-1] < 1e-4 * errors[0]


@each_treecode
@each_kernel
def test_tree(kernel, backend):
    """With the tree every cluster is at r/R <= theta; the Taylor error falls at least like theta^p.

    Above some degree leaves are summed directly and the error falls faster; it never rises.
    """
    theta = 0.5
    points, strengths, _ = random_case(kernel, 4000, 3)
    exact = tc.evaluate(kernel, points, strengths, backend="direct")
    degrees, errors = [], []
    for degree in DEGREES[backend]:
        plan = tc.Plan(kernel, backend, theta=theta, degree=degree, leaf_size=100)
        error = tc.relative_error(plan.set_points(points).execute(strengths), exact)
        if plan.info()["far_pairs"] == 0:
            assert error < 1e-13
            break
        degrees.append(degree)
        errors.append(error)
    assert len(errors) >= 4
    assert math.log(rate(degrees, errors)) > 0.8 * math.log(1 / theta)
    assert np.all(np.diff(np.log(errors)) < math.log(1.1))


@each_treecode
def test_smaller_theta_is_more_accurate(backend):
    kernel = tc.RegularizedStokeslet(epsilon=0.02)
    points, strengths, _ = random_case(kernel, 4000, 4)
    exact = tc.evaluate(kernel, points, strengths, backend="direct")
    errors = [
        tc.relative_error(
            tc.evaluate(
                kernel, points, strengths, backend=backend, theta=theta, degree=3, leaf_size=70
            ),
            exact,
        )
        for theta in (0.9, 0.7, 0.5, 0.3)
    ]
    assert np.all(np.diff(errors) < 0)
