"""One sum, of points that are used once."""

from __future__ import annotations

from typing import Any

import numpy as np

from treecode import check
from treecode.kernels.base import Kernel
from treecode.methods.base import KEYWORDS
from treecode.plan import Plan

_OPTIONS = ("backend", *KEYWORDS, "progress", "boundary", "comm", "distributed")


def evaluate(
    kernel: Kernel, points: Any, strengths: Any, targets: Any = None, **options: Any
) -> np.ndarray:
    """Return ``sum_j K(x_i, y_j) q_j`` once; see `Plan` for the options and what is raised.

    Parameters
    ----------
    kernel : Kernel
    points : (N, 3) array_like
        Sources.
    strengths : (N, strength_size) array_like
    targets : (M, 3) array_like, optional
        The sources by default.
    **options
        `backend`, `theta`, `degree`, `leaf_size`, `precision`, `tol`, `progress`, `boundary`,
        `comm`, `distributed`.

    Returns
    -------
    (M, value_size) float64 ndarray

    Examples
    --------
    >>> import numpy as np
    >>> import treecode as tc
    >>> kernel = tc.RegularizedStokeslet(epsilon=0.01)
    >>> u = tc.evaluate(kernel, [[0, 0, 0]], [[0, 0, 1]], targets=[[0, 0, 10], [10, 0, 0]])
    >>> print((8.0 * np.pi * 10.0 * u[:, 2]).round(4))  # 2 along the force, 1 across
    [2. 1.]
    """
    if unknown := set(options).difference(_OPTIONS):
        raise TypeError(
            f"evaluate() has the options {', '.join(_OPTIONS)}, got {', '.join(sorted(unknown))}"
        )
    plan = Plan(kernel, **options)
    if plan._search:
        plan._search.sums = 1
    with plan.ranks.together():
        points = check.points("points", points)
        plan.boundary.require_inside("points", points)
        strengths = check.rows("strengths", strengths, kernel.strength_size, len(points))
        return plan.set_points(points, targets).execute(strengths)
