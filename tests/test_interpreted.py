"""The same code as plain Python (NUMBA_DISABLE_JIT=1), and so that coverage can see it.

Small enough for a debugger: far fields, several levels, an odd number of targets.
"""

import numpy as np
import pytest

import treecode as tc
from tests.cases import wall_oracle
from tests.cases.oracle import each_backend, each_kernel, exact, random_case

pytestmark = pytest.mark.interpreted


@each_backend
@each_kernel
def test_small_sums(kernel, backend):
    points, strengths, targets = random_case(kernel, 70, 0, targets=5)
    plan = tc.Plan(kernel, backend, theta=0.6, degree=1, leaf_size=9)
    values = plan.set_points(points, targets).execute(strengths)
    expected = exact(kernel, points, strengths, targets)
    if backend == "direct":
        assert tc.relative_error(values, expected) < 1e-13
    else:
        assert plan.info()["far_pairs"] > 0
        assert plan.info()["depth"] > 1
        assert tc.relative_error(values, expected) < 0.6**2


def test_loads_over_a_wall():
    """Against the formulas written out."""
    kernel = tc.RegularizedStokesletRotlet(0.1)
    rng = np.random.default_rng(2)
    points, loads = rng.random((12, 3)), rng.standard_normal((12, 6))
    plan = tc.Plan(kernel, "direct", boundary=tc.Wall()).set_points(points)
    expected = wall_oracle.flow(points, points, loads, 0.1, 1.0)
    assert tc.relative_error(plan.execute(loads), expected) < 1e-12


@pytest.mark.parametrize("kernel", [tc.RegularizedStokeslet(0.1), tc.Stokeslet()])
def test_taylor_over_a_wall(kernel):
    points, strengths, targets = random_case(kernel, 70, 3, targets=5)
    wall = {"boundary": tc.Wall((0.0, 0.0, min(points[:, 2].min(), targets[:, 2].min())))}
    plan = tc.Plan(kernel, "taylor", theta=0.6, degree=1, leaf_size=9, **wall)
    values = plan.set_points(points, targets).execute(strengths)
    expected = tc.evaluate(kernel, points, strengths, targets, backend="direct", **wall)
    assert plan.info()["far_pairs"] > 0
    assert tc.relative_error(values, expected) < 0.6**2


@each_kernel
def test_points_on_chebyshev_points(kernel):
    """Corners, centre and faces of the box: every singularity of K eq. (3.1) is removed."""
    points = np.stack(np.meshgrid(*[[-1.0, 0.0, 1.0]] * 3), -1).reshape(-1, 3)
    strengths = random_case(kernel, 27, 1)[1]
    targets = np.array([[9.0, 0.0, 0.0]])
    plan = tc.Plan(kernel, "kitc", degree=2, leaf_size=9)
    points, strengths = np.tile(points, (2, 1)), np.tile(strengths, (2, 1))
    values = plan.set_points(points, targets).execute(strengths)
    assert (plan.info()["near_pairs"], plan.info()["far_pairs"]) == (0, 27)
    # Proxies are the points themselves, so nothing is approximated.
    assert tc.relative_error(values, exact(kernel, points, strengths, targets)) < 1e-13
