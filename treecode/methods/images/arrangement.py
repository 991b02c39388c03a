"""What a sum is made of: points and their near images, a split, and a box for its smooth part."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from treecode.kernels.periodic import PeriodicKernel
from treecode.methods.ewald.long_part import count_waves
from treecode.methods.ewald.slab import Span, span_of
from treecode.methods.ewald.summation import scaled_task
from treecode.methods.ewald.tuning import SPLITS, Split, Task, seconds_of_waves, split_at
from treecode.methods.images.window import Box, box_around
from treecode.methods.images.wrapping import Wrapped
from treecode.ranks import OneRank

_SOURCE = 3e-6  # seconds on one thread for a source of the free sum
_COUNTED = 10_000  # sources by which images are counted


class Arrangement(NamedTuple):
    """A sum in parts, in units of the edge of a cube as large as the cell.

    Attributes
    ----------
    unit : float
        This edge.
    task : Task
    span : Span or None
        Of the points of a slab.
    split : Split
    box : Box
        Around sources and targets below.
    places : Wrapped
    numbers : (n,) int64
        Of which source each near image is one.
    sources, targets : (3, n) and (3, M) float64
        Near images, and targets in their midst; the same array if there are no other images.
    seconds : float
        On one thread, of waves and of sources of the free sum.
    """

    unit: float
    task: Task
    span: Span | None
    split: Split
    box: Box
    places: Wrapped
    numbers: np.ndarray
    sources: np.ndarray
    targets: np.ndarray
    seconds: float

    def free_points(self) -> tuple[np.ndarray, np.ndarray | None]:
        """Return sources, (3, n), and targets, (3, M) or None if they are these, of the free sum.

        They are in the unit of the user.
        """
        same = self.targets is self.sources
        return self.unit * self.sources, None if same else self.unit * self.targets


def arrange(
    kernel: PeriodicKernel, sources: np.ndarray, targets: np.ndarray, tol: float, xi: float = 0.0
) -> Arrangement:
    """Return the parts of a sum, by a splitting parameter or by the one that should cost least.

    Sources and targets, (3, N) and (3, M), are the same array if they are the same points.
    """
    span = span_of([sources, targets], OneRank())
    unit, task = scaled_task(kernel, sources.shape[1], targets.shape[1], tol, span)
    scaled = sources / unit
    places = Wrapped(task.vectors, scaled, scaled if targets is sources else targets / unit)
    split = split_at(task, xi * unit) if xi else _cheapest_split(task, places)
    ends = Span(span.low / unit, span.high / unit) if kernel.is_slab else None
    numbers, near, there = _near(task, places, split)
    box = box_around(near, there, task, split)
    seconds = _seconds(task, split, box, len(numbers))
    return Arrangement(unit, task, ends, split, box, places, numbers, near, there, seconds)


def _near(
    task: Task, places: Wrapped, split: Split, every: int = 1
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return numbers of near images, their places, and those of targets in their midst.

    Both are one array if they are the same. Images are those of one of so many sources.
    """
    numbers, near = places.near(split.distance, every)
    alone = np.array_equal(numbers, np.arange(task.sources))
    same = alone and places.targets is places.sources
    return numbers, near, near if same else task.vectors.T @ places.targets


def _seconds(task: Task, split: Split, box: Box, near: int) -> float:
    """Return what waves take, and sources of the free sum."""
    waves = count_waves(np.diag(box.lengths), split.wave_number)
    of_near = seconds_of_waves(task.size, task.tol, waves, near + task.targets)
    return _seconds_of_cell(task, split) + of_near + _SOURCE * near


def _cheapest_split(task: Task, places: Wrapped) -> Split:
    """Return the split that should take the least time."""
    every = -(-task.sources // _COUNTED)
    best, least = None, math.inf
    for xi in SPLITS:
        split = split_at(task, xi)
        # Waves become more and more, images fewer and fewer.
        if best and _seconds_of_cell(task, split) >= least:
            break
        numbers, near, there = _near(task, places, split, every)
        box = box_around(near, there, task, split)
        seconds = _seconds(task, split, box, every * len(numbers))
        if seconds < least:
            best, least = split, seconds
    assert best is not None
    return best


def _seconds_of_cell(task: Task, split: Split) -> float:
    """Return what the waves of the cell take."""
    waves = count_waves(task.vectors, split.wave_number)
    return seconds_of_waves(task.size, task.tol, waves, task.sources + task.targets)
