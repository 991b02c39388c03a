"""The errors that end a search for a sum."""

from __future__ import annotations


class ToleranceError(ValueError):
    """No sum among those allowed is as accurate as it was asked to be."""

    @classmethod
    def of(cls, tol: float, attainable: float, why: str) -> ToleranceError:
        """Return the error that says which tolerance can be had in the place of `tol`."""
        least = f"tol must be at least {1.1 * attainable:.1e}"
        return cls(
            f"{least if attainable < 1.0 else 'no tol can be kept'} for these points and strengths "
            f"({why}), got {tol:g}"
        )


class CancellationError(ToleranceError):
    """Not even direct sums in doubles are: their terms cancel to little more than rounding."""
