"""A box that repeats itself in three directions, or in two."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from treecode import check
from treecode.boundaries.base import Boundary, Term
from treecode.kernels import RegularizedStokeslet, RegularizedStokesletRotlet
from treecode.kernels.base import Kernel
from treecode.kernels.periodic import PeriodicKernel, heights, inverse

_FLATTEST = 1e-6  # volume of a cell, as part of the product of its edges
_AXES = "xyz", "xy"


@dataclass(frozen=True)
class Periodic(Boundary):
    """A cell that a lattice repeats, with all that is in it: a box, or a slab.

    In a box the flow and the spin have no mean over the cell. Forces that do not add up to zero are
    balanced by a uniform body force on the fluid (H. Hasimoto, J. Fluid Mech. 5, 1959).

    A slab repeats along x and y, and fluid is everywhere along z. Forces f along it that do not add
    up to zero shear the fluid on both sides: the mean flow of each is ``-|z| f / (2 mu A)`` at a
    height z above it, per area A of the cell. Forces across it are balanced by the pressure.

    Parameters
    ----------
    cell : (3,) or (3, 3) array_like
        Lengths of a box along the axes, or lattice vectors in rows. Points may be anywhere: each
        stands for its images in the cell. For a slab it is (2,) or (2, 3), with vectors across z.
    axes : {"xyz", "xy"}, optional
        In which directions it repeats: a box, or a slab.

    Raises
    ------
    ValueError, TypeError
        If a length is not positive, or the vectors span no volume.

    Examples
    --------
    >>> import numpy as np
    >>> import treecode as tc
    >>> kernel, force = tc.RegularizedStokeslet(epsilon=0.01), [[0.0, 0.0, 1.0]]
    >>> alone = tc.evaluate(kernel, [[0.0, 0.0, 0.0]], force)
    >>> lattice = tc.evaluate(
    ...     kernel, [[0.0, 0.0, 0.0]], force, boundary=tc.Periodic((1.0, 1.0, 1.0)), tol=1e-8
    ... )
    >>> print((6.0 * np.pi * (alone - lattice)[0, 2]).round(3))  # Hasimoto's 2.837
    2.837
    """

    kind: ClassVar[str] = "periodic"

    cell: Any
    axes: str = "xyz"

    def __post_init__(self) -> None:
        check.one_of("axes", self.axes, _AXES)
        object.__setattr__(self, "cell", _checked_cell(self.cell, len(self.axes)))

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
        """Lattice vectors in rows, (3, 3), or (2, 3) of a slab."""
        return np.array(self.cell)

    @property
    def heights(self) -> np.ndarray:
        """Distances between opposite faces of the cell, one for each lattice vector."""
        return heights(self.vectors)

    def places(self, points: np.ndarray) -> np.ndarray:
        """Return points, (N, 3), in parts of the lattice vectors, (N, 3), or (N, 2) in a slab."""
        return np.asarray(points @ inverse(self.vectors))

    def images(self, points: np.ndarray) -> np.ndarray:
        """Return which image of the cell each point is in: multiples of the lattice vectors.

        Parameters
        ----------
        points : (N, 3) ndarray

        Returns
        -------
        (N, 3) int ndarray
            (N, 2) in a slab.
        """
        return np.floor(self.places(points)).astype(np.int64)

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
        near, numbers = points - self.images(points) @ self.vectors, np.arange(len(points))
        for axis, share in enumerate(reach / self.heights):
            place, step = self.places(near)[:, axis], self.vectors[axis]
            low, high = place <= share, place >= 1.0 - share
            near = np.concatenate([near, near[low] + step, near[high] - step])
            numbers = np.concatenate([numbers, numbers[low], numbers[high]])
        return near, numbers


def _checked_cell(cell: Any, count: int) -> tuple[tuple[float, ...], ...]:
    """Return so many lattice vectors, checked."""
    check.unmasked("cell", cell)
    try:
        array = np.asarray(cell)
    except ValueError:  # ragged
        array = np.empty(0)
    if array.shape == (count,):
        lengths = [check.positive(f"cell[{d}]", length) for d, length in enumerate(array.tolist())]
        array = np.diag([*lengths, 0.0])[:count, :3]
    if array.shape != (count, 3):
        number, axes = ("three", "") if count == 3 else ("two", " with axes 'xy'")
        raise ValueError(
            f"cell must be {number} lengths or {number} lattice vectors{axes}, got {cell!r}"
        )
    vectors = check.rows("cell", array, 3, count)
    if count == 2 and vectors[:, 2].any():
        raise ValueError(f"cell must have vectors across z with axes 'xy', got {cell!r}")
    lengths = [check.positive(f"length of cell[{d}]", x) for d, x in enumerate(edges(vectors))]
    directions = vectors / np.array(lengths)[:, None]
    if not abs(np.linalg.det(directions[:, :count])) > _FLATTEST:
        what = "volume" if count == 3 else "area"
        raise ValueError(f"cell must have a positive {what}, got {cell!r}")
    return tuple(tuple(row) for row in vectors.tolist())


def edges(vectors: np.ndarray) -> np.ndarray:
    """Return the lengths of vectors in rows."""
    largest = float(np.abs(vectors).max()) or 1.0
    return np.asarray(largest * np.linalg.norm(vectors / largest, axis=1))
