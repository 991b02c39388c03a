"""A kernel whose sources repeat periodically in two or three directions."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from treecode.kernels.base import weights


class PeriodicKernel(NamedTuple):
    """The flow of sources that a lattice repeats, of all images together.

    The flow, and of kernels with angular velocities the spin, has no mean over a cell of three
    vectors: in Fourier space the wave k = 0 is left out. Forces that do not add up to zero are so
    balanced by a uniform body force on the fluid. In a slab, of two vectors, there is no such mean:
    a force f along the plane drives the mean flow ``-|z| f / (2 mu A)`` at a height z above it, per
    area A of the cell. One across the plane drives none, and is balanced by the pressure.

    It has no `pair`, since a lattice sum is no sum over pairs; methods that ask for one leave it to
    others.

    Parameters
    ----------
    free : RegularizedStokeslet or RegularizedStokesletRotlet
        The kernel in free space.
    cell : tuple of three tuples of three floats
        The rows are the lattice vectors. Two of them, across z, are those of a slab.

    Examples
    --------
    >>> import treecode as tc
    >>> free = tc.RegularizedStokeslet(epsilon=0.1)
    >>> tc.Periodic((1.0, 1.0, 1.0)).bounded(free).is_slab
    False
    """

    free: Any
    cell: tuple[tuple[float, float, float], ...]

    @property
    def is_slab(self) -> bool:
        """Whether it is free along z."""
        return len(self.cell) == 2

    @property
    def strength_size(self) -> int:
        """Columns of the strengths."""
        return int(self.free.strength_size)

    @property
    def weight_size(self) -> int:
        """Components of the linear weights."""
        return int(self.free.weight_size)

    @property
    def value_size(self) -> int:
        """Components of the sum."""
        return int(self.free.value_size)

    @property
    def value_lengths(self) -> tuple[float, ...]:
        """Powers of a length in the units of the values."""
        return tuple(self.free.value_lengths)

    def weights(self, q: tuple[float, ...]) -> tuple[float, ...]:
        """Return those of the kernel in free space."""
        return weights(self.free, q)


def inverse(vectors: np.ndarray) -> np.ndarray:
    """Return the matrix, (3, n), that turns points into parts of n vectors, (n, 3), in rows.

    Two vectors are across z.
    """
    count = len(vectors)
    return np.concatenate([np.linalg.inv(vectors[:, :count]), np.zeros((3 - count, count))])


def heights(vectors: np.ndarray) -> np.ndarray:
    """Return the distances between opposite faces of a cell of n vectors, (n,)."""
    return np.asarray(1.0 / np.linalg.norm(inverse(vectors), axis=0))
