"""The errors that end a search for a sum."""

from __future__ import annotations


class ToleranceError(ValueError):
    """No sum among those allowed is as accurate as it was asked to be.

    Examples
    --------
    >>> import numpy as np
    >>> import treecode as tc
    >>> points = np.random.default_rng(0).random((20, 3))
    >>> pairs = np.concatenate([points, points + 1e-9])
    >>> forces = np.repeat([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]], 20, axis=0)
    >>> try:
    ...     u = tc.evaluate(tc.RegularizedStokeslet(epsilon=0.1), pairs, forces, tol=1e-9)
    ... except tc.ToleranceError:
    ...     u = tc.evaluate(tc.RegularizedStokeslet(epsilon=0.1), pairs, forces, tol=1e-4)
    """

    @classmethod
    def of(cls, tol: float, attainable: float, why: str) -> ToleranceError:
        """Return the error that says which tolerance can be had in the place of `tol`."""
        least = f"tol must be at least {1.1 * attainable:.1e}"
        return cls(
            f"{least if attainable < 1.0 else 'no tol can be kept'} for these points and strengths "
            f"({why}), got {tol:g}"
        )


class CancellationError(ToleranceError):
    """Not even direct sums in doubles are: their terms cancel to little more than rounding.

    Examples
    --------
    >>> import numpy as np
    >>> import treecode as tc
    >>> points = np.random.default_rng(0).random((20, 3))
    >>> pairs = np.concatenate([points, points + 1e-9])
    >>> forces = np.repeat([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]], 20, axis=0)
    >>> tc.evaluate(tc.RegularizedStokeslet(epsilon=0.1), pairs, forces, tol=1e-9)
    Traceback (most recent call last):
        ...
    treecode.choice.refusals.CancellationError: tol must be at least ..., got 1e-09
    """
