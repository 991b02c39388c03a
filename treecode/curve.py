"""The curve of Morton through the cubes of an octree: a key is a place on it."""

from __future__ import annotations

import numpy as np

LEVELS = 21  # of cubes that the curve tells apart: three bits each of a key
END = np.uint64(1 << 3 * LEVELS)
MASKS = (  # that spread 21 bits, a third of them at a time
    (32, 0x1F00000000FFFF),
    (16, 0x1F0000FF0000FF),
    (8, 0x100F00F00F00F00F),
    (4, 0x10C30C30C30C30C3),
    (2, 0x1249249249249249),
)


def first_keys(level: int, cells: np.ndarray) -> np.ndarray:
    """Return the first key in each of some cubes, (...), with cells (..., 3) of one level."""
    finest = cells >> max(0, level - LEVELS)
    bits = finest.astype(np.uint64)
    for shift, mask in MASKS:
        bits = (bits | bits << np.uint64(shift)) & np.uint64(mask)
    keys = bits[..., 0] | bits[..., 1] << np.uint64(1) | bits[..., 2] << np.uint64(2)
    return keys << np.uint64(3 * max(0, LEVELS - level))


def length(level: int) -> np.uint64:
    """Return how many keys a cube of a level has."""
    return np.uint64(1 << 3 * max(0, LEVELS - level))


def cells_of(level: int, keys: np.ndarray) -> np.ndarray:
    """Return the cells, (n, 3), of the cubes of a level, at most `LEVELS`, around keys."""
    cells = np.zeros((len(keys), 3), np.int64)
    octants = keys >> np.uint64(3 * (LEVELS - level))
    for bit in range(level):
        for d in range(3):
            one = octants >> np.uint64(3 * bit + d) & np.uint64(1)
            cells[:, d] |= one.astype(np.int64) << bit
    return cells
