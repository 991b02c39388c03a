"""The same code as plain Python (NUMBA_DISABLE_JIT=1), and so that coverage can see it.

Small enough for a debugger: far fields, several levels, an odd number of targets.
"""

import numpy as np
import pytest

import treecode as tc
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
