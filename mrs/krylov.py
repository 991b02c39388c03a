"""Linear equations that are solved by iterations."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy


def solved(
    applied: Callable[[np.ndarray], np.ndarray],
    right: np.ndarray,
    unit: np.ndarray | float,
    rtol: float,
    most: int,
) -> np.ndarray:
    """Return x with applied(x) = right, but for a residual, by scipy's GMRES from zero.

    Parameters
    ----------
    applied : callable
        A linear function of arrays of the shape of `right`.
    right : ndarray
    unit : ndarray or float
        Of each entry of x and of `right`: norms are of entries in these units.
    rtol : float
        Norm of the residual, relative to that of `right`.
    most : int
        Iterations at most.
    """

    def in_units(scaled: np.ndarray) -> np.ndarray:
        return (applied(scaled.reshape(right.shape) * unit) / unit).ravel()

    # Without a dtype scipy would find it by one more product.
    operator = scipy.sparse.linalg.LinearOperator((right.size,) * 2, in_units, dtype=float)
    scaled, _ = scipy.sparse.linalg.gmres(
        operator, (right / unit).ravel(), rtol=rtol, restart=most, maxiter=1
    )
    return np.asarray(scaled.reshape(right.shape) * unit)
