"""Points in the images of a cell that keep them together, and the images near them."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from treecode.kernels.periodic import heights

_SLOTS = 1024  # along each lattice vector, of which some are empty


class Images(NamedTuple):
    """Images of some points.

    Attributes
    ----------
    numbers : (n,) int64
        Of which point each is an image.
    points : (3, n) float64
    """

    numbers: np.ndarray
    points: np.ndarray


class Wrapped:
    """Sources and targets, in those images of the cell that keep them together.

    Along each lattice vector the cell begins behind the widest gap between points. So a clump is
    whole, and has few images near it.

    Parameters
    ----------
    vectors : (3, 3) float64
        Lattice vectors, in rows.
    sources : (3, N) float64
    targets : (3, M) float64
        The same array if they are the sources.

    Attributes
    ----------
    vectors : (3, 3) float64
    sources, targets : (3, N) and (3, M) float64
        In parts of the lattice vectors; the same array if they are the same points.
    """

    def __init__(self, vectors: np.ndarray, sources: np.ndarray, targets: np.ndarray) -> None:
        self.vectors = vectors
        inverse = np.linalg.inv(vectors).T
        own = inverse @ sources
        there = own if targets is sources else inverse @ targets
        begin = np.array([_behind_gap(*both) for both in zip(own, there, strict=True)])[:, None]
        self.sources = own - np.floor(own - begin)
        self.targets = self.sources if targets is sources else there - np.floor(there - begin)

    def near(self, reach: float, every: int = 1) -> Images:
        """Return all images of sources, or of one of so many, near the box around the targets.

        Those within the distance `reach` are there. If the targets are the sources, they come
        first, in their order.
        """
        numbers, places = np.arange(self.sources.shape[1])[::every], self.sources[:, ::every]
        low, high = self.targets.min(axis=1), self.targets.max(axis=1)
        for d, margin in enumerate(reach / heights(self.vectors)):
            # Sources are within a cell that the targets are in: no others reach so far.
            most = math.ceil(1.0 + margin)
            kept, shifts = [], sorted(range(-most, most + 1), key=abs)
            for shift in shifts:
                x = places[d] + shift
                kept.append(np.flatnonzero((x >= low[d] - margin) & (x <= high[d] + margin)))
            steps = np.repeat(shifts, [len(rows) for rows in kept])
            rows = np.concatenate(kept)
            numbers, places = numbers[rows], places[:, rows]
            places[d] += steps
        return Images(numbers, self.vectors.T @ places)


def _behind_gap(*given: np.ndarray) -> float:
    """Return where the widest gap between places ends, if what is one apart is the same place."""
    filled = np.zeros(_SLOTS, bool)
    for places in given:
        filled[(_SLOTS * (places - np.floor(places))).astype(np.int64) % _SLOTS] = True
    slots = np.flatnonzero(filled)
    gaps = np.diff(slots, prepend=slots[-1] - _SLOTS)
    return float(slots[gaps.argmax()] / _SLOTS)
