"""A periodic cell cut into small ones: where points are, and which rows are within a distance.

Small cells that follow each other along the third lattice vector are a row. Points are sorted along
rows, so that all points of a row between two places are one range.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from treecode.kernels.periodic import heights

_SLICES = 4  # small cells for the width of a row: ends of ranges are found to that
_WIDTHS = range(1, 9)  # rows within the cut-off
_COPY, _ROW = 1.5, 8.0  # pairs that take as long as to copy a source, or to find those of a row
_FEWEST = 64  # small cells are no more than twice as many as points, or so many
_MOST_TARGETS = 128  # in a group, which one thread takes
_COUNTED = 40_000  # points by which crowding is measured,
_MOST_CELLS = 64  # and cells for it, along each lattice vector


class Grid(NamedTuple):
    """Small cells.

    Attributes
    ----------
    vectors : (3, 3) float64
        Lattice vectors, in rows.
    shape : (3,) int64
        Small cells along each of them.
    rows : (R, 2) int64
        Rows within the cut-off, as differences from the row of a target.
    reach : (R, 2) int64
        Differences from the small cell of a target, along each row, between which sources are.
    """

    vectors: np.ndarray
    shape: np.ndarray
    rows: np.ndarray
    reach: np.ndarray


def make_grid(vectors: np.ndarray, cut_off: float, sources: int, targets: int) -> Grid:
    """Return small cells of a cell of volume 1, for a cut-off within which points interact."""
    width = _row_width(cut_off, sources, targets)
    shape = np.maximum(1, (heights(vectors) / width).astype(np.int64))
    shape[2] *= _SLICES
    most = max(_FEWEST, 2 * (sources + targets))
    while math.prod(shape.tolist()) > most:
        shape[shape.argmax()] = -(-shape.max() // 2)
    return Grid(vectors, shape, *_rows_within(vectors, shape, cut_off))


def pairs_of_a_target(cut_off: float, sources: float, targets: float) -> float:
    """Return the pairs that a target takes as long as, of so many points in the cell."""
    width = _row_width(cut_off, sources, targets)
    return _pairs(width, cut_off, sources, targets)


def _row_width(cut_off: float, sources: float, targets: float) -> float:
    """Return how wide rows should be: wide ones sum in vain, narrow ones copy sources in vain."""
    widths = (cut_off / n for n in _WIDTHS)
    return min(widths, key=lambda width: _pairs(width, cut_off, sources, targets))


def _pairs(width: float, c: float, sources: float, targets: float) -> float:
    """Return the pairs within a cut-off of a cube, and what finding and copying sources adds."""
    volume = width**3 + 6.0 * width**2 * c + math.pi * c**2 * (3.0 * width + 4.0 / 3.0 * c)
    rows = (2.0 * c / width + 2.0) ** 2
    once = _COPY * volume * sources + _ROW * rows
    return volume * sources + once / max(1.0, targets * width**3)


def _rows_within(
    vectors: np.ndarray, shape: np.ndarray, cut_off: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the rows within a cut-off of a row, and the places along them."""
    length = float(np.linalg.norm(vectors[2]))
    along = vectors @ vectors[2] / length
    across = vectors[:2] - np.outer(along[:2], vectors[2] / length)
    steps = across / shape[:2, None]
    gram = steps @ steps.T
    # Rows at (x, y) steps are at least |x| det / |second step| apart.
    det = gram[0, 0] * gram[1, 1] - gram[0, 1] ** 2
    far = [int(cut_off * math.sqrt(gram[1 - i, 1 - i] / det)) + 1 for i in range(2)]
    rows = np.array(
        [(i, j) for i in range(-far[0], far[0] + 1) for j in range(-far[1], far[1] + 1)]
    )
    least = _least_norms(gram, rows.astype(float))
    near = least < cut_off**2
    rows, half = rows[near], np.sqrt(cut_off**2 - least[near])
    slope = along[:2] / shape[:2]
    middle = rows @ slope
    spread = np.abs(slope).sum()
    scale = shape[2] / length
    low = np.floor((-half - middle - spread) * scale)
    high = np.floor((half - middle + spread) * scale) + 1.0
    return rows, np.stack([low, high], axis=1).astype(np.int64)


def _least_norms(gram: np.ndarray, centers: np.ndarray) -> np.ndarray:
    """Return the least of ``x gram x`` over the squares of side 2 around some centers, (n, 2)."""
    inside = np.abs(centers).max(axis=1) <= 1.0
    least = np.full(len(centers), np.inf)
    for fixed in range(2):  # else it is on an edge
        other = 1 - fixed
        for side in (-1.0, 1.0):
            x = centers[:, fixed] + side
            best = -gram[0, 1] * x / gram[other, other]
            y = np.clip(best, centers[:, other] - 1.0, centers[:, other] + 1.0)
            norm = gram[fixed, fixed] * x**2 + 2.0 * gram[0, 1] * x * y + gram[other, other] * y**2
            least = np.minimum(least, norm)
    return np.where(inside, 0.0, least)


class Sorted(NamedTuple):
    """Points sorted along rows.

    Attributes
    ----------
    places : (3, N) float64
        Wrapped into the cell, in parts of the lattice vectors, from 0 to 1.
    order : (N,) int64
        Which of the given points stands at each place.
    start : (small cells + 1,) int64
        The first point of each small cell.
    """

    places: np.ndarray
    order: np.ndarray
    start: np.ndarray


def sort_points(grid: Grid, points: np.ndarray) -> Sorted:
    """Wrap points, (3, N), into the cell, and sort them."""
    places = _places(grid.vectors, points)
    cells = _cells_of(grid.shape, places)
    order = np.argsort(cells, kind="stable")
    counts = np.bincount(cells, minlength=math.prod(grid.shape.tolist()))
    start = np.concatenate([[0], np.cumsum(counts)])
    return Sorted(np.ascontiguousarray(places[:, order]), order, start)


def _places(vectors: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return points, (3, N), in parts of the lattice vectors, from 0 to 1."""
    places = np.linalg.inv(vectors).T @ points
    return np.asarray(places - np.floor(places))


def _cells_of(shape: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Return the number of the small cell of each point, (N,)."""
    indices = np.minimum((places * shape[:, None]).astype(np.int64), shape[:, None] - 1)
    return np.asarray((indices[0] * shape[1] + indices[1]) * shape[2] + indices[2])


def find_groups(grid: Grid, start: np.ndarray) -> np.ndarray:
    """Return groups of sorted targets that are close to each other in a row.

    Returns
    -------
    (G, 6) int64 ndarray
        The row (two numbers), the first and the last small cell in it, the first target and the one
        behind the last.
    """
    n1, n2, n3 = grid.shape.tolist()
    lows = np.arange(0, n3, _SLICES)
    highs = np.minimum(lows + _SLICES, n3)
    row = np.arange(n1 * n2).repeat(len(lows))
    low, high = np.tile(lows, n1 * n2), np.tile(highs, n1 * n2)
    first, stop = start[row * n3 + low], start[row * n3 + high]
    pieces = -(-(stop - first) // _MOST_TARGETS)
    which = np.arange(len(row)).repeat(pieces)
    piece = np.arange(len(which)) - (np.cumsum(pieces) - pieces)[which]
    begin = first[which] + piece * _MOST_TARGETS
    end = np.minimum(begin + _MOST_TARGETS, stop[which])
    row = row[which]
    return np.stack([row // n2, row % n2, low[which], high[which] - 1, begin, end], axis=1)


def crowding(
    vectors: np.ndarray, sources: np.ndarray, targets: np.ndarray | None
) -> Callable[[float], float]:
    """Return a function of a distance: by how much more pairs are within it than of even points.

    Points, (3, N) and (3, M), are counted by cells that are as wide.
    """
    across = heights(vectors)
    given = [sources] if targets is None else [sources, targets]
    some = [points[:, :: -(-points.shape[1] // _COUNTED) or 1] for points in given]
    places = [_places(vectors, points) for points in some]

    def ratio(distance: float) -> float:
        shape = np.clip((across / distance).astype(np.int64), 1, _MOST_CELLS)
        cells = math.prod(shape.tolist())
        counts = [np.bincount(_cells_of(shape, x), minlength=cells).astype(float) for x in places]
        itself = float(counts[0].sum()) if targets is None else 0.0
        pairs = float(counts[0] @ counts[-1]) - itself
        return max(1.0, cells * pairs / max(1.0, counts[0].sum() * counts[-1].sum() - itself))

    return ratio
