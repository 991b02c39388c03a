"""Which rank has which points: equal shares of the work, cut where cubes end."""

from __future__ import annotations

import numpy as np

from treecode.curve import END, LEVELS, length
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

    They are cubes with twice `leaf_size` points at most, and larger ones as long as no points lie
    between: the cubes that two ranks have points in are then all split, by any rule.

    Parameters
    ----------
    ranks : OneRank
    begin : (size + 1,) uint64
    kinds : tuple of (n,) uint64 arrays
        Sorted keys of the sources and of the targets; of the points if they are the same.
    leaf_size : int
    """
    sizes = np.array([length(level) for level in range(LEVELS + 1)])[:, None]
    inner = begin[1:-1]
    starts = inner // sizes * sizes
    counts = [np.searchsorted(k, starts + sizes) - np.searchsorted(k, starts) for k in kinds]
    small = ranks.add_up(np.stack(counts)).max(axis=0) <= 2 * leaf_size
    small[-1] = True  # no smaller cubes are told apart
    inner = _first(starts, small)
    starts = inner // sizes * sizes
    before = [np.searchsorted(k, inner) - np.searchsorted(k, starts) for k in kinds]
    inner = _first(starts, ranks.add_up(np.sum(before, axis=0)) == 0)
    return np.concatenate([begin[:1], inner, begin[-1:]])


def _first(starts: np.ndarray, fits: np.ndarray) -> np.ndarray:
    """Return for each column the start at the first level that fits."""
    return starts[fits.argmax(axis=0), np.arange(starts.shape[1])]
