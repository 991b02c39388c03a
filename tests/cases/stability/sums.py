"""Plans of the cases, and how far their sums may be off."""

import numpy as np

import treecode as tc
from tests.cases.oracle import FREE, exact

DEGREES = {"direct": 1, "kitc": 4, "taylor": 6}
SUMS = FREE
TOLERANCE = 1e-2  # of "fmm", in singles but for singular kernels
THETA = 0.5


def plan_of(kernel, backend, **options):
    """Return a plan with THETA and the degree that the cases take for a backend."""
    options = {"theta": THETA, "degree": DEGREES[backend]} | options
    return tc.Plan(kernel, backend, **options)


def truncation(backend, degree=None):
    """Return what a treecode leaves out of a term at r/R <= THETA, in units of its size.

    A Taylor remainder begins with THETA^(degree + 1); Chebyshev interpolation errs by less.
    """
    degree = DEGREES[backend] if degree is None else degree
    return 0.0 if backend == "direct" else THETA ** (degree + 1)


def excess(tol, kernel, points, strengths):
    """Return the relative error of "fmm" over its tolerance, with two to four levels of cubes.

    The larger of those of velocities and angular velocities; 0 where all is 0.
    """
    expected = exact(kernel, points, strengths)
    with np.errstate(over="ignore"):  # of powers of lengths that this sum does not need
        plan = tc.Plan(kernel, "fmm", tol=tol, leaf_size=8).set_points(points)
        difference = plan.execute(strengths) - expected
    found = 0.0
    for columns in (slice(0, 3), slice(3, None)):
        if difference[:, columns].any():
            error = np.linalg.norm(difference[:, columns]) / np.linalg.norm(expected[:, columns])
            found = max(found, error / tol)
    return found


def name_of(kernel):
    return type(kernel).__name__
