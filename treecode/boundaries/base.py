"""A boundary of the fluid: the flow within it as sums over translation-invariant kernels."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from treecode.kernels.base import Kernel


class Term(NamedTuple):
    """One of the sums that make the flow within a boundary; None for parts that do not change.

    Attributes
    ----------
    kernel : Kernel
    sources : callable, optional
        Of points, (N, 3): returns the sources of this term, for example images, (n, 3).
    strengths : callable, optional
        Of points, (N, 3), and strengths, (N, strength_size) of the kernel of free space: returns
        the strengths of this term, a row for each of its sources.
    targets : callable, optional
        Of points, (M, 3): returns where this term is wanted, (M, 3).
    values : callable, optional
        Of points, (M, 3), and the values of this term there: returns its part of the flow,
        (M, value_size) of the kernel of free space.

    Examples
    --------
    >>> import treecode as tc
    >>> kernel = tc.RegularizedStokeslet(epsilon=0.1)
    >>> image = tc.Term(kernel, sources=lambda points: points * [1, 1, -1])  # as behind a mirror
    >>> image.alone, tc.Term(kernel).alone
    (False, True)
    """

    kernel: Kernel
    sources: Callable[[np.ndarray], np.ndarray] | None = None
    strengths: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None
    targets: Callable[[np.ndarray], np.ndarray] | None = None
    values: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None

    @property
    def alone(self) -> bool:
        """Whether this term is a sum over its kernel, and nothing else."""
        return not any(self[1:])

    def columns_of(
        self, sources: np.ndarray, targets: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray | None]:
        """Return sources and targets of this term, (3, n) and (3, M), of points (N, 3), (M, 3).

        The targets are None if they are the sources.
        """
        everywhere = sources if targets is None else targets
        own = sources if self.sources is None else self.sources(sources)
        there = everywhere if self.targets is None else self.targets(everywhere)
        same = targets is None and own is sources and there is everywhere
        return columns(own), None if same else columns(there)

    def strengths_of(self, points: np.ndarray, strengths: np.ndarray) -> np.ndarray:
        """Return the strengths of this term, (n, its kernel's strength_size)."""
        return strengths if self.strengths is None else self.strengths(points, strengths)

    def flow_of(self, targets: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Return the part of this term in the flow at targets, (M, value_size)."""
        return values if self.values is None else self.values(targets, values)


def columns(points: np.ndarray) -> np.ndarray:
    """Return a copy of points, (N, 3), by coordinates, (3, N): the sums sort it."""
    return np.array(points.T, order="C")


class Boundary:
    """A condition on the flow that images of the sources meet: at a wall, or between boxes.

    A subclass returns in `terms` the sums that replace the one in free space. Methods of
    summation, tolerances and samples of errors need no code for it.

    Examples
    --------
    >>> import numpy as np
    >>> import treecode as tc
    >>> class SlipWall(tc.Boundary):  # at z = 0: each force has a mirror image
    ...     def terms(self, kernel):
    ...         mirror = np.array([1.0, 1.0, -1.0])
    ...         image = tc.Term(kernel, lambda x: x * mirror, lambda x, forces: forces * mirror)
    ...         return tc.Term(kernel), image
    >>> kernel, targets = tc.RegularizedStokeslet(epsilon=0.1), [[0.5, 0.0, 0.0]]
    >>> points, forces = [[0.0, 0.0, 1.0]], [[1.0, 0.0, 1.0]]
    >>> print(tc.evaluate(kernel, points, forces, targets, boundary=SlipWall()).round(4))
    [[0.0574 0.     0.    ]]
    """

    def terms(self, kernel: Kernel) -> Sequence[Term]:
        """Return the sums that replace the sum over `kernel` in free space.

        Parameters
        ----------
        kernel : Kernel
            If there are no such sums for it, a ValueError says so.
        """
        raise NotImplementedError

    def outside(self, points: np.ndarray) -> np.ndarray:
        """Return the rows of points, (N, 3), that are not in the fluid; none by default."""
        return np.empty(0, np.int64)

    def require_inside(self, name: str, points: np.ndarray) -> None:
        """Refuse points, (N, 3), that are not in the fluid.

        Parameters
        ----------
        name : str
            Of the points, for the message.
        points : (N, 3) ndarray

        Raises
        ------
        ValueError
            With the first of them and its row.
        """
        rows = self.outside(points)
        if len(rows):
            row = int(rows[0])
            raise ValueError(
                f"{name} must be in the fluid, within {self}, got row {row}, "
                f"{tuple(points[row].tolist())}"
            )

    def bounded(self, kernel: Kernel) -> Any:
        """Return what is summed in the place of `kernel`: a kernel, or a `BoundedKernel`."""
        terms = tuple(self.terms(kernel))
        alone = len(terms) == 1 and terms[0].alone
        return terms[0].kernel if alone else BoundedKernel(kernel, self, terms)


class FreeSpace(Boundary):
    """No boundary: the fluid is everywhere.

    Examples
    --------
    >>> import treecode as tc
    >>> kernel, points, forces = tc.RegularizedStokeslet(epsilon=0.1), [[0, 0, 0]], [[1, 0, 0]]
    >>> u = tc.evaluate(kernel, points, forces, boundary=tc.FreeSpace())
    >>> print(u.round(4))  # 1 / (4 pi epsilon)
    [[0.7958 0.     0.    ]]
    """

    def __repr__(self) -> str:
        return "FreeSpace()"

    def terms(self, kernel: Kernel) -> Sequence[Term]:
        """Return the sum itself."""
        return (Term(kernel),)


class BoundedKernel(NamedTuple):
    """A kernel within a boundary. It has no formula for a pair: its terms are summed.

    Attributes
    ----------
    kernel : Kernel
        Of free space.
    boundary : Boundary
    terms : tuple of Term
    """

    kernel: Kernel
    boundary: Boundary
    terms: tuple[Term, ...]

    @property
    def strength_size(self) -> int:
        """Columns of the strengths."""
        return self.kernel.strength_size

    @property
    def value_size(self) -> int:
        """Components of the sum."""
        return self.kernel.value_size

    @property
    def value_lengths(self) -> tuple[float, ...]:
        """Equal for components of one unit."""
        return self.kernel.value_lengths


def free(kernel: Any) -> Kernel:
    """Return the kernel of free space."""
    of_free: Kernel = kernel.kernel if isinstance(kernel, BoundedKernel) else kernel
    return of_free
