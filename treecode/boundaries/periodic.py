"""A box that repeats itself in three directions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from treecode import check
from treecode.boundaries.base import Boundary, Term
from treecode.kernels import RegularizedStokeslet, RegularizedStokesletRotlet
from treecode.kernels.base import Kernel
from treecode.kernels.periodic import PeriodicKernel, heights

_FLATTEST = 1e-6  # volume of a cell, as part of the product of its edges


@dataclass(frozen=True)
class Periodic(Boundary):
    """A cell that a lattice repeats, with all that is in it.

    The flow and the spin have no mean over the cell. Forces that do not add up to zero are
    balanced by a uniform body force on the fluid (H. Hasimoto, J. Fluid Mech. 5, 1959).

    Parameters
    ----------
    cell : (3,) or (3, 3) array_like
        Lengths of a box along the axes, or lattice vectors in rows. Points may be anywhere: each
        stands for its images in the cell.

    Raises
    ------
    ValueError, TypeError
        If a length is not positive, or the vectors span no volume.
    """

    kind: ClassVar[str] = "periodic"

    cell: Any

    def __post_init__(self) -> None:
        object.__setattr__(self, "cell", _checked_cell(self.cell))

    def terms(self, kernel: Kernel) -> tuple[Term]:
        """Return the sum over all images.

        Raises
        ------
        ValueError
            If the kernel is not regularized.
        """
        if not isinstance(kernel, (RegularizedStokeslet, RegularizedStokesletRotlet)):
            raise ValueError(
                "kernel must be RegularizedStokeslet or RegularizedStokesletRotlet in a periodic "
                f"box, got {kernel!r}"
            )
        return (Term(PeriodicKernel(kernel, self.cell)),)

    @property
    def vectors(self) -> np.ndarray:
        """Lattice vectors in rows, (3, 3)."""
        return np.array(self.cell)

    @property
    def heights(self) -> np.ndarray:
        """Distances between opposite faces of the cell, (3,)."""
        return heights(self.vectors)

    def images(self, points: np.ndarray) -> np.ndarray:
        """Return which image of the cell each point is in, (N, 3) int: multiples of the vectors.

        Parameters
        ----------
        points : (N, 3) ndarray
        """
        return np.floor(points @ np.linalg.inv(self.vectors)).astype(np.int64)

    def with_images(self, points: np.ndarray, reach: float) -> tuple[np.ndarray, np.ndarray]:
        """Return points in the cell and their images near it, and which point each is.

        All images within `reach` of the cell are there, also of cells with any angles.

        Parameters
        ----------
        points : (N, 3) ndarray
            Anywhere.
        reach : float
            At most half of the least of the `heights`.

        Returns
        -------
        places : (n, 3) ndarray
            The first N are the points themselves, in the cell.
        numbers : (n,) int ndarray
        """
        places, numbers = points @ np.linalg.inv(self.vectors), np.arange(len(points))
        places -= np.floor(places)
        for axis, near in enumerate(reach / self.heights):
            step = np.eye(3)[axis]
            low, high = places[:, axis] <= near, places[:, axis] >= 1.0 - near
            places = np.concatenate([places, places[low] + step, places[high] - step])
            numbers = np.concatenate([numbers, numbers[low], numbers[high]])
        return places @ self.vectors, numbers


def _checked_cell(cell: Any) -> tuple[tuple[float, ...], ...]:
    """Return lattice vectors, checked."""
    check.unmasked("cell", cell)
    try:
        array = np.asarray(cell)
    except ValueError:  # ragged
        array = np.empty(0)
    if array.shape == (3,):
        lengths = [check.positive(f"cell[{d}]", length) for d, length in enumerate(array.tolist())]
        array = np.diag(lengths)
    if array.shape != (3, 3):
        raise ValueError(f"cell must be three lengths or three lattice vectors, got {cell!r}")
    vectors = check.rows("cell", array, 3, 3)
    lengths = [check.positive(f"length of cell[{d}]", x) for d, x in enumerate(edges(vectors))]
    if not abs(np.linalg.det(vectors / np.array(lengths)[:, None])) > _FLATTEST:
        raise ValueError(f"cell must have a positive volume, got {cell!r}")
    return tuple(tuple(row) for row in vectors.tolist())


def edges(vectors: np.ndarray) -> np.ndarray:
    """Return the lengths of vectors, (3,), in rows."""
    largest = float(np.abs(vectors).max()) or 1.0
    return np.asarray(largest * np.linalg.norm(vectors / largest, axis=1))
