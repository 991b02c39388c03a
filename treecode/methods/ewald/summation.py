"""A periodic sum by Ewald's method: pairs for the short part, waves for the rest."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from treecode.kernels.periodic import PeriodicKernel
from treecode.methods.ewald.cells import crowding, find_groups, make_grid, sort_points
from treecode.methods.ewald.long_part import Transforms, make_waves, precision_for
from treecode.methods.ewald.short_part import ShortStokeslet, ShortStokesletRotlet, sum_neighbours
from treecode.methods.ewald.slab import PlaneFlow, Span, padded, span_of
from treecode.methods.ewald.tuning import (
    Task,
    cheapest_split,
    pair_precision,
    seconds_of,
    split_at,
)
from treecode.ranks import OneRank
from treecode.threads import Threads
from treecode.timing import Seconds
from treecode.traversal import load_weights

_GROUPS = 64  # of targets, that a thread takes at a time


class Ewald:
    """A sum over all images of the sources.

    Parameters
    ----------
    kernel : PeriodicKernel
    parameters : mapping
        Of `method.EwaldMethod`. Without `xi` the split that should be the fastest is taken for the
        first points, and kept.
    progress : bool
    evenly : bool, optional
        Find it for so many points anywhere, and not for where they are.

    Attributes
    ----------
    ranks : OneRank
        Share the targets, if there are several.
    """

    def __init__(
        self,
        kernel: PeriodicKernel,
        parameters: Mapping[str, Any],
        progress: bool,
        evenly: bool = False,
    ) -> None:
        self.kernel, self._given, self._progress = kernel, parameters, progress
        self.tol: float = parameters["tol"]
        self.xi: float = parameters.get("xi", 0.0)
        self._evenly = evenly
        self._pairs: int | None = None
        self._cut_for: tuple[Any, ...] = ()
        self.ranks = OneRank()

    @property
    def parameters(self) -> dict[str, Any]:
        """Those that were given, and the splitting parameter: it depends on points set before."""
        return {**self._given, "xi": self.xi}

    def set_points(self, sources: np.ndarray, targets: np.ndarray | None) -> None:
        """Sort the points, (3, N) and (3, M), and cut off both parts; the arrays are kept."""
        self.seconds = Seconds()
        self._pairs = None
        everywhere = sources if targets is None else targets
        count = sum(self.ranks.exchange(everywhere.shape[1]))
        span = span_of([sources, everywhere], self.ranks)
        self._unit, self._task = scaled_task(self.kernel, sources.shape[1], count, self.tol, span)
        self._plane = None
        if self.kernel.is_slab:
            ends = Span(span.low / self._unit, span.high / self._unit)
            self._plane = PlaneFlow(self._task.vectors, ends, self._task.epsilon)
        with self.seconds.stage("tree"):
            vectors = self._task.vectors
            scaled = sources / self._unit
            scaled_targets = None if targets is None else targets / self._unit
            if not self.xi:
                even = self._evenly or self.ranks.size > 1
                known = () if even else (crowding(vectors, scaled, scaled_targets),)
                self.xi = cheapest_split(self._task, *known).xi / self._unit
            self._cut_off()
            self._sources = sort_points(self._grid, scaled)
            self._targets = self._sources
            if scaled_targets is not None:
                self._targets = sort_points(self._grid, scaled_targets)
            self._groups = find_groups(self._grid, self._targets.start)
        self.source_order, self.target_order = self._sources.order, self._targets.order
        self.sources = self.targets = np.ascontiguousarray(sources[:, self.source_order])
        if targets is not None:
            self.targets = np.ascontiguousarray(targets[:, self.target_order])

    def _cut_off(self) -> None:
        """Cut off both parts, unless it was done for as many points in the same cell."""
        task, xi = self._task, self.xi * self._unit
        cut_for = (task.vectors.tobytes(), *task[1:], xi)
        if cut_for != self._cut_for:
            self._split = split = split_at(task, xi)
            self._waves = make_waves(task.vectors, task.epsilon, split.xi, split.wave_number)
            self._grid = make_grid(task.vectors, split.distance, task.sources, task.targets)
            self._cut_for = cut_for

    def execute(self, strengths: np.ndarray) -> np.ndarray:
        """Return the sum, (M, value_size), of strengths (N, strength_size)."""
        values = np.zeros((self.targets.shape[1], self.kernel.value_size))
        self._pairs = 0
        self.seconds |= {"near": 0.0, "waves": 0.0}
        if not values.size or not len(strengths):
            return values
        with Threads(self._progress) as threads:
            with self.seconds.stage("weights"):
                weights, unit = scaled_weights(
                    self.kernel, strengths, self.source_order, self._unit, threads
                )
            self._sum(weights, values, threads)
        lengths = np.array(self.kernel.value_lengths, float)
        values *= unit * self._unit**-lengths
        return values

    def _sum(self, weights: np.ndarray, values: np.ndarray, threads: Threads) -> None:
        """Add both parts to `values`, (M, value_size).

        There are few transforms, each on one thread: the others sum pairs meanwhile.
        """
        places = self._sources.places, self._targets.places
        waves = Transforms(self._waves, precision_for(self.tol), weights, *places)
        pairs: list[int] = []

        def sum_pairs(groups: np.ndarray) -> None:
            pairs.append(self._sum_pairs(weights, groups, values))

        groups = np.array_split(self._groups, max(2, len(self._groups) // _GROUPS))
        half = len(groups) // 2
        self._share(threads, waves.forward, waves.count, sum_pairs, groups[:half])
        with self.seconds.stage("waves", more=True):
            threads(waves.apply, waves.rows)
        self._share(threads, waves.backward, waves.count, sum_pairs, groups[half:])
        waves.add_to(values, self.target_order)
        if self._plane:
            sources, targets = self.sources[2] / self._unit, self.targets[2] / self._unit
            values[self.target_order] += self._plane(weights, sources, targets)
        self._pairs = sum(pairs)

    def _share(
        self,
        threads: Threads,
        transform: Callable[[int], None],
        count: int,
        sum_pairs: Callable[[np.ndarray], None],
        groups: list[np.ndarray],
    ) -> None:
        """Make so many transforms, and sum the pairs of groups of targets, by all threads."""
        taken = np.zeros(count + len(groups))

        def work(some: slice) -> None:
            i, start = some.start, time.perf_counter()
            if i < count:
                transform(i)
            else:
                sum_pairs(groups[i - count])
            taken[i] = time.perf_counter() - start

        start = time.perf_counter()
        threads(work, len(taken), 1, progress=True)
        scale = (time.perf_counter() - start) / taken.sum()
        for stage, part in (("waves", taken[:count]), ("near", taken[count:])):
            self.seconds[stage] += float(scale * part.sum())

    def _sum_pairs(self, weights: np.ndarray, groups: np.ndarray, values: np.ndarray) -> int:
        """Add the short part at some groups of targets; return the number of pairs."""
        task, split = self._task, self._split
        kind = ShortStokesletRotlet if task.size == 6 else ShortStokeslet
        pairs: int = sum_neighbours(
            kind(task.epsilon, split.xi, split.distance),
            self._grid,
            self._sources.places,
            weights,
            self._sources.start,
            self._targets.places,
            self._targets.order,
            groups,
            np.empty(0, pair_precision(task, split)),
            values,
        )
        return pairs

    @property
    def effort(self) -> float:
        """What the last sum took, in pairs."""
        if not self._pairs:
            return 0.0
        near, waves = seconds_of(self._task, self._split)
        return self._pairs * (1.0 + waves / near)

    def info(self) -> dict[str, Any]:
        """Return parameters, cut-offs, pairs and waves of the last sum, and bytes held."""
        arrays: list[np.ndarray] = [*self._grid, *self._waves, self._groups]
        for points, given in ((self._sources, self.sources), (self._targets, self.targets)):
            arrays += [*points, given]
        return {
            **self.parameters,
            "cut_off": self._unit * self._split.distance,
            "waves": self._waves.shape,
            "near_pairs": self._pairs,
            "far_pairs": None if self._pairs is None else math.prod(self._waves.shape),
            "bytes": sum({id(array): array.nbytes for array in arrays}.values()),
        }


def scaled_task(
    kernel: PeriodicKernel, sources: int, targets: int, tol: float, span: Span
) -> tuple[float, Task]:
    """Return the edge of a cube as large as the cell, and the sum in units of it.

    The cell of a slab is padded around all points.
    """
    vectors, free = np.array(kernel.cell), kernel.free
    if kernel.is_slab:
        vectors = padded(vectors, span, free.epsilon, tol)
    scale = np.abs(vectors).max()
    unit = float(scale * abs(np.linalg.det(vectors / scale)) ** (1.0 / 3.0))
    return unit, Task(vectors / unit, free.epsilon / unit, free.value_size, sources, targets, tol)


def scaled_weights(
    kernel: PeriodicKernel,
    strengths: np.ndarray,
    order: np.ndarray,
    length: float,
    threads: Threads,
) -> tuple[np.ndarray, float]:
    """Return weights in an order, (weight_size, N), in a unit of length, and another unit of them.

    It is a power of two: singles hold nothing below 1e-38, nor above 1e38.
    """
    free = kernel.free
    weights = np.empty((free.weight_size, len(strengths)))
    load_weights(free, strengths, order, weights, threads)
    weights *= length ** -np.array(free.weight_lengths, float)[:, None]
    unit = math.ldexp(0.5, math.frexp(max(weights.max(), -weights.min()))[1])
    weights /= unit
    return weights, unit
