"""Direct summation is the sum of the papers, to rounding."""

import numpy as np
import pytest

import treecode as tc
from tests.cases.oracle import (
    KERNELS,
    assert_within,
    each_kernel,
    exact,
    exact_mpmath,
    random_case,
    rounding,
)

# Tiles of two targets, batches of 256 targets, blocks of 512 or 1024 sources, and their tails.
COUNTS = [
    *[(n, None) for n in (1, 2, 3, 7, 257, 1000)],
    *[(1000, 1), (1025, 7), (1023, 3), (513, 2), (512, 256), (7, 257), (1, 1000), (3, 1000)],
]


def direct(kernel, points, strengths, targets=None):
    return tc.evaluate(kernel, points, strengths, targets, backend="direct")


@each_kernel
@pytest.mark.parametrize(("n", "m"), COUNTS)
def test_is_the_sum(kernel, n, m):
    """Any numbers of sources and targets: 1e-13 in the norm K 8.1, rounding in every entry."""
    points, strengths, targets = random_case(kernel, n, seed=n, targets=m)
    values = direct(kernel, points, strengths, targets)
    expected = exact(kernel, points, strengths, targets)
    assert tc.relative_error(values, expected) <= 1e-13
    assert_within(values, expected, rounding(kernel, points, strengths, targets))


@each_kernel
@pytest.mark.parametrize("m", [None, 4])
def test_is_the_sum_in_50_digits(kernel, m):
    """A few points, 1e-14; and the extended precision oracle is right to 1e-17."""
    points, strengths, targets = random_case(kernel, 6, seed=1, targets=m)
    expected = exact_mpmath(kernel, points, strengths, targets)
    assert tc.relative_error(direct(kernel, points, strengths, targets), expected) <= 1e-14
    if np.finfo(np.longdouble).eps < 1e-18:
        assert tc.relative_error(exact(kernel, points, strengths, targets), expected) <= 1e-17


@each_kernel
def test_targets_that_are_the_sources(kernel):
    """Passing the sources as targets changes no bit: the self terms are the same."""
    points, strengths, _ = random_case(kernel, 300, seed=2)
    np.testing.assert_array_equal(
        direct(kernel, points, strengths, points.copy()), direct(kernel, points, strengths)
    )


STRENGTHS = [
    pytest.param(kernel, slice(first, first + 3), id=f"{type(kernel).__name__}-{first}")
    for kernel in KERNELS
    for first in range(0, kernel.strength_size, 3)
]


@pytest.mark.parametrize(("kernel", "columns"), STRENGTHS)
def test_linear_in_the_strengths(kernel, columns):
    """Linear in force, torque, h and nu, where h and nu multiply and the others add."""
    points, p, _ = random_case(kernel, 200, seed=3)
    if columns.start == 0 or kernel.strength_size == 6:
        p[:, np.arange(kernel.strength_size) // 3 != columns.start // 3] = 0.0
    else:
        p[:, :3] = 0.0
    q, both = p.copy(), p.copy()
    q[:, columns] = np.random.default_rng(4).uniform(-1.0, 1.0, (200, 3))
    both[:, columns] = 2.0 * p[:, columns] - 3.0 * q[:, columns]
    plan = tc.Plan(kernel, "direct").set_points(points)
    combined = 2.0 * plan.execute(p) - 3.0 * plan.execute(q)
    bound = rounding(kernel, points, both)
    bound = bound + 2.0 * rounding(kernel, points, p) + 3.0 * rounding(kernel, points, q)
    assert_within(plan.execute(both), combined, bound)


@pytest.mark.parametrize("kernel", [tc.RegularizedStokeslet, tc.RegularizedStokesletRotlet])
@pytest.mark.parametrize("viscosity", [1e-6, 3.0, 1e30])
def test_inverse_in_the_viscosity(kernel, viscosity):
    """All channels carry the factor 1/mu, which is 1 by default."""
    points, strengths, _ = random_case(kernel, 50, seed=5)
    values = direct(kernel(0.1, viscosity), points, strengths)
    bound = rounding(kernel(0.1, viscosity), points, strengths)
    assert_within(values, direct(kernel(0.1), points, strengths) / viscosity, bound)


@each_kernel
def test_any_layout_of_the_arrays(kernel):
    """Lists, Fortran order, strides and read-only arrays give the same bits; none is written to."""
    points, strengths, targets = random_case(kernel, 40, seed=6, targets=30)
    expected = direct(kernel, points, strengths, targets)
    strided = np.repeat(np.repeat(points, 2, axis=0), 2, axis=1)[::2, ::2]
    frozen = strengths.copy()
    frozen.flags.writeable = False
    values = direct(kernel, strided, frozen, np.asfortranarray(targets))
    np.testing.assert_array_equal(values, expected)
    lists = (a.tolist() for a in (points, strengths, targets))
    np.testing.assert_array_equal(direct(kernel, *lists), expected)
    np.testing.assert_array_equal(points, random_case(kernel, 40, seed=6)[0])


@each_kernel
def test_order_of_the_points(kernel):
    """A permutation of the sources permutes the values, to the rounding of the sums."""
    points, strengths, _ = random_case(kernel, 300, seed=7)
    order = np.random.default_rng(8).permutation(300)
    values = direct(kernel, points[order], strengths[order])
    bound = 2.0 * rounding(kernel, points, strengths)[order]
    assert_within(values, direct(kernel, points, strengths)[order], bound)
