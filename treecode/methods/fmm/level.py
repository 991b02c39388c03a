"""The operators of cubes of one size, and which of them meet."""

from __future__ import annotations

import itertools
from typing import Any, NamedTuple

import numpy as np

from treecode.methods.fmm.legendre import along_axes, gauss, grid

CLASSES = 8
# Every translation up to reflections.
OFFSETS = [t for t in itertools.product(range(4), repeat=3) if max(t) > 1]
# Sign of a function of a class at an image, in (class, image) order.
PARITY = np.array([[(-1.0) ** bin(p & q).count("1") for q in range(8)] for p in range(8)])


class Level(NamedTuple):
    """Operators for cubes of one size.

    Attributes
    ----------
    degree : int
        Polynomials in each direction.
    source_basis, value_basis : tuple of 8 (members, rank) float64 arrays
        For each class the combinations of Legendre coefficients that are kept.
    source_members, value_members : tuple of 8 int64 arrays
        The coefficients in each class, as flat indices of (channel, k1, k2, k3).
    source_scale, value_scale : (channels,) float64
        What brings channels to one size.
    matrices : (n,) float32 or float64
        C_t for each of `OFFSETS`, transposed: for each class of values the rows are the classes of
        sources that meet it. One behind the other,
    begin : (57,) int64
        from here on,
    used : (56,) int64
        with so many functions of each class.
    """

    degree: int
    source_basis: tuple[np.ndarray, ...]
    value_basis: tuple[np.ndarray, ...]
    source_members: tuple[np.ndarray, ...]
    value_members: tuple[np.ndarray, ...]
    source_scale: np.ndarray
    value_scale: np.ndarray
    matrices: np.ndarray
    begin: np.ndarray
    used: np.ndarray

    @property
    def rank(self) -> int:
        """Compressed functions in each class."""
        return int(self.source_basis[0].shape[1])

    def resized(self, factor: float, powers: np.ndarray) -> Level:
        """Return the operators for larger cubes, if the kernel has no length of its own.

        `powers` are those of `symmetry.scale_powers`.
        """
        return self._replace(source_scale=self.source_scale * factor**-powers)

    def source_bases(self, dtype: Any) -> list[np.ndarray]:
        """Return for each class the matrix from Legendre coefficients to compressed ones."""
        return self._scaled(self.source_basis, self.source_members, self.source_scale, dtype)

    def value_bases(self, dtype: Any) -> list[np.ndarray]:
        """Return for each class the matrix whose transpose goes back to Legendre coefficients."""
        return self._scaled(self.value_basis, self.value_members, self.value_scale, dtype)

    def _scaled(self, basis: Any, members: Any, scale: np.ndarray, dtype: Any) -> list[np.ndarray]:
        channel = (m // self.degree**3 for m in members)
        return [(b / scale[c, None]).astype(dtype) for b, c in zip(basis, channel, strict=True)]

    def nodes(self, half: float) -> np.ndarray:
        """Return Gauss points in a cube, (3, degree^3)."""
        x, _ = gauss(self.degree)
        return half * grid(x)

    def project(self, values: np.ndarray) -> np.ndarray:
        """Return Legendre coefficients of values at the nodes, both (boxes, channels, degree^3)."""
        return self._apply(gauss(self.degree)[1], values)

    def spread(self, coefficients: np.ndarray) -> np.ndarray:
        """Return the weights of nodes that act as Legendre coefficients do."""
        return self._apply(gauss(self.degree)[1].T, coefficients)

    def _apply(self, matrix: np.ndarray, values: np.ndarray) -> np.ndarray:
        cubes = values.reshape(-1, *3 * (self.degree,))
        return along_axes(matrix, cubes).reshape(values.shape)


def meeting(p: int, offset: tuple[int, ...]) -> list[int]:
    """Return the classes of sources that act on class `p` across an offset."""
    fixed = sum(1 << d for d in range(3) if offset[d] == 0)
    return [q for q in range(CLASSES) if (p ^ q) & fixed == 0]
