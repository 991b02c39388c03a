"""Which rank has which points: equal shares of the work, cut where cubes end."""

from __future__ import annotations

import numpy as np

from treecode.methods.fmm.curve import END, LEVELS, length
from treecode.ranks import OneRank


def divide(ranks: OneRank, keys: np.ndarray, work: np.ndarray) -> np.ndarray:
    """Return where the pieces of the curve begin that have equal work, (size + 1,) uint64.

    Parameters
    ----------
    ranks : OneRank
    keys : (n,) uint64
        Sorted, of the points that this rank has now, wherever they are.
    work : (n,) float64
        Of each of these points.
    """
    before = np.append(0.0, work.cumsum())
    wanted = ranks.add_up(before[-1:]) * np.arange(1, ranks.size) / ranks.size
    inner = np.zeros(ranks.size - 1, np.uint64)
    for bit in range(3 * LEVELS - 1, -1, -1):
        further = inner | np.uint64(1 << bit)
        below = ranks.add_up(before[np.searchsorted(keys, further)])
        inner = np.where(below <= wanted, further, inner)
    return np.concatenate([np.zeros(1, np.uint64), inner, [END]])


def aligned(
    ranks: OneRank, begin: np.ndarray, kinds: tuple[np.ndarray, ...], leaf_size: int
) -> np.ndarray:
    """Return the beginnings moved down to the next ones of cubes that a tree would not split.

    They are cubes with twice `leaf_size` points at most, or with none before the beginning: the
    cubes that two ranks have points in are then all split, by any rule.

    Parameters
    ----------
    ranks : OneRank
    begin : (size + 1,) uint64
    kinds : tuple of (n,) uint64 arrays
        Sorted keys of the sources and of the targets; of the points if they are the same.
    leaf_size : int
    """
    inner = begin[1:-1]
    sizes = np.array([length(level) for level in range(LEVELS + 1)])[:, None]
    starts = inner // sizes * sizes
    counts = []
    for keys in kinds:
        first = np.searchsorted(keys, starts)
        counts += [
            np.searchsorted(keys, starts + sizes) - first,
            np.searchsorted(keys, inner) - first,
        ]
    total = ranks.add_up(np.stack(counts))
    fits = (total[::2].max(axis=0) <= 2 * leaf_size) | (total[1::2].sum(axis=0) == 0)
    level = fits.argmax(axis=0)
    return np.concatenate([begin[:1], starts[level, np.arange(len(inner))], begin[-1:]])
