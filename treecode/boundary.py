"""Boundaries of the fluid: the flow within them as sums over translation-invariant kernels."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from treecode.kernels.base import Kernel


class Term(NamedTuple):
    """One of the sums that make the flow within a boundary; None for parts that do not change.

    Attributes
    ----------
    kernel : Kernel
    sources : callable, optional
        Of points, (N, 3): returns where the sources of this term are, for example their images.
    strengths : callable, optional
        Of points, (N, 3), and strengths, (N, strength_size) of the kernel of free space: returns
        the strengths of this term.
    values : callable, optional
        Of targets, (M, 3), and the values of this term there: returns its part of the flow,
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
        """Return the part of this term in the flow at targets, (M, value_size)."""
        return values if self.values is None else self.values(targets, values)


class Boundary:
    """A condition on the flow at walls, which images of the sources meet.

    A subclass returns in `terms` the sums that replace the one in free space. Methods of
    summation, tolerances and samples of errors need no code for it.
    """

    def terms(self, kernel: Kernel) -> Sequence[Term]:
        """Return the sums that replace the sum over `kernel` in free space.

        Parameters
        ----------
        kernel : Kernel
            If there are no such sums for it, a ValueError says so.
        """
        raise NotImplementedError


class FreeSpace(Boundary):
    """No boundary: the fluid is everywhere."""

    def terms(self, kernel: Kernel) -> Sequence[Term]:
        """Return the sum itself."""
        return (Term(kernel),)
