"""The pieces of the curve of Morton that ranks have, and the places of points on it."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from treecode._jit import compiled
from treecode.curve import END, LEVELS, MASKS, cells_of, first_keys, length
from treecode.methods.fmm.octree import Box, root_corner
from treecode.ranks import OneRank
from treecode.threads import Threads

_AROUND = np.stack(np.meshgrid(*3 * [[-1, 0, 1]], indexing="ij"), axis=-1).reshape(-1, 3)


def keys_of(points: np.ndarray, box: Box, width: float, threads: Threads) -> np.ndarray:
    """Return the place of each point on the curve, (P,) uint64.

    Parameters
    ----------
    points : (3, P) float64
    box : Box
        Around all points.
    width : float
        Side of the root.
    threads : Threads
    """
    keys = np.empty(points.shape[1], np.uint64)
    corner, levels = root_corner(box, width)

    def find(some: slice) -> None:
        _keys(points, some.start, corner, width, min(levels, LEVELS), keys[some])

    threads(find, len(keys), least=1000)
    return keys


@compiled
def _keys(points, start, corner, width, levels, keys):
    """Write where the points from `start` on lie.

    A plane between two cubes belongs to the lower one. So a tree sorts points, and as its centres,
    planes are exact.
    """
    side, last = width * 0.5**levels, (1 << levels) - 1
    for i in range(len(keys)):
        key = 0
        for d in range(3):
            x, low = points[d, start + i], corner[d]
            cell = min(max(math.ceil((x - low) / side) - 1, 0), last)
            if cell > 0 and x <= low + cell * side:
                cell -= 1
            elif cell < last and x > low + (cell + 1) * side:
                cell += 1
            for shift, mask in MASKS:
                cell = (cell | cell << shift) & mask
            key |= cell << d
        keys[i] = key << 3 * (LEVELS - levels)


class Shared(NamedTuple):
    """The cubes in which several ranks have points, from the root on.

    Attributes
    ----------
    level, parent : (S,) int64
        The parent is one of them; -1 for the root.
    cell : (S, 3) int64
    """

    level: np.ndarray
    parent: np.ndarray
    cell: np.ndarray


class Pieces:
    """The pieces of the curve that ranks have: an `octree.Region`.

    Parameters
    ----------
    ranks : OneRank
    box : Box
        Around all points.
    begin : (size + 1,) uint64
        First key of each rank, and the end.
    """

    def __init__(self, ranks: OneRank, box: Box, begin: np.ndarray) -> None:
        self._ranks, self.box, self.begin = ranks, box, begin

    def straddles(self, level: int, cell: np.ndarray) -> np.ndarray:
        """Tell which cubes of a level, with cells (n, 3), reach into the pieces of others."""
        if level > LEVELS:
            return np.zeros(len(cell), bool)
        low = first_keys(level, cell)
        first, stop = self.begin[self._ranks.rank : self._ranks.rank + 2]
        return (low < first) | (low + length(level) > stop)

    def most(self, fullest: int, in_full: int, count: int) -> tuple[int, int, int]:
        """Return the most of all, and the totals of two numbers."""
        told = self._ranks.exchange((fullest, in_full, count))
        most, *others = zip(*told, strict=True)
        return max(most), sum(others[0]), sum(others[1])

    def around(self, level: int, cell: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the first and the last rank, (n, 27), in the 27 cubes around cells of a level.

        Cubes outside the root are those of the cell itself.
        """
        near = cell[:, None] + _AROUND
        inside = ((near >= 0) & (near < 1 << level)).all(axis=2)
        low = first_keys(level, np.where(inside[..., None], near, cell[:, None]))
        first = np.searchsorted(self.begin, low, "right") - 1
        last = np.searchsorted(self.begin, low + length(level), "left") - 1
        return first, last

    def shared(self) -> Shared:
        """Return the cubes in which several ranks have points: those around a first key inside."""
        inner = np.unique(self.begin[1:-1])
        levels, parents = [np.zeros(1, np.int64)], [np.full(1, -1)]
        cells = [np.zeros((1, 3), np.int64)]
        above, before = np.zeros(1, np.uint64), 0
        for level in range(1, LEVELS + 1):
            inside = inner & (length(level) - np.uint64(1)) != 0
            starts = np.unique(inner[inside & (inner < END)] // length(level) * length(level))
            if not len(starts):
                break
            up = starts // length(level - 1) * length(level - 1)
            levels.append(np.full(len(starts), level))
            parents.append(before + np.searchsorted(above, up))
            cells.append(cells_of(level, starts))
            before, above = before + len(above), starts
        return Shared(np.concatenate(levels), np.concatenate(parents), np.concatenate(cells))
