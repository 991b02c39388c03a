"""Boundaries of the fluid: the flow within them as sums over translation-invariant kernels."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from treecode.kernels.base import Kernel


class Term(NamedTuple):
    """One sum of those that make the flow within a boundary; None for what stays as it is.

    Attributes
    ----------
    kernel : Kernel
    sources : callable, optional
        Of points, (N, 3): returns where the sources of this term are, for example their images.
    strengths : callable, optional
        Of points, (N, 3), and strengths, (N, strength_size) of the kernel of free space: returns
        the strengths of this term.
    values : callable, optional
        Of targets, (M, 3), and the values of this term there: returns what it adds to the flow,
        (M, value_size) of the kernel of free space.
    """

    kernel: Kernel
    sources: Callable[[np.ndarray], np.ndarray] | None = None
    strengths: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None
    values: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None

    def sources_of(self, points: np.ndarray) -> np.ndarray:
        """Return the sources of this term, (N, 3)."""
        return points if self.sources is None else self.sources(points)

    def strengths_of(self, points: np.ndarray, strengths: np.ndarray) -> np.ndarray:
        """Return the strengths of this term, (N, its kernel's strength_size)."""
        return strengths if self.strengths is None else self.strengths(points, strengths)

    def flow_of(self, targets: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Return what this term adds to the flow at targets, (M, value_size)."""
        return values if self.values is None else self.values(targets, values)


class Boundary:
    """A condition on the flow at walls, which images of the sources meet.

    A subclass says by `terms` which sums take the place of the one in free space. Methods of
    summation, tolerances and samples of errors need nothing of their own for it.
    """

    def terms(self, kernel: Kernel) -> Sequence[Term]:
        """Return the sums that replace the sum over `kernel` in free space.

        Parameters
        ----------
        kernel : Kernel
            A ValueError says if there is no such sum.
        """
        raise NotImplementedError


class FreeSpace(Boundary):
    """No boundary: the fluid is everywhere."""

    def terms(self, kernel: Kernel) -> Sequence[Term]:
        """Return the sum itself."""
        return (Term(kernel),)
