"""A sum by the fast multipole method: points into an octree, then pass after pass."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from treecode.blas import blas_of_one_thread
from treecode.kernels.base import Kernel
from treecode.methods.fmm.far_field import Expansions, FarField
from treecode.methods.fmm.hierarchy import Hierarchy, first_level
from treecode.methods.fmm.lists import find_lists
from treecode.methods.fmm.near_field import NearField
from treecode.methods.fmm.octree import Box, Octree, build_octree, root_widths
from treecode.methods.fmm.sizing import (
    Work,
    choose_width,
    cube_cost,
    expansion_size,
    sampling_interval,
)
from treecode.ranks import NOTHING, Delivery
from treecode.threads import Threads
from treecode.timing import Seconds
from treecode.traversal import load_weights

_DIRECT = 16  # leaves


class FastMultipole:
    """A sum: cubes act on cubes, up and down an octree.

    Parameters
    ----------
    kernel : Kernel
    parameters : mapping
        Of `method.FastMultipoleMethod`.
    progress : bool
    """

    def __init__(self, kernel: Kernel, parameters: Mapping[str, Any], progress: bool) -> None:
        self.kernel, self._given, self._progress = kernel, parameters, progress
        self.tol, self.degree = parameters["tol"], parameters.get("degree")
        self.width: float = parameters.get("width", 0.0)
        self._cube_cost = cube_cost(kernel, self.tol)
        leaf_size = parameters.get("leaf_size")
        self.leaf_size: int = leaf_size or int(2.0 * math.sqrt(self._cube_cost / 27.0))
        # Below this many points no cube is worth its translations.
        self._direct = 0 if leaf_size else int(_DIRECT * self.leaf_size)
        self._work = Work(math.inf, math.inf, 0)
        self._operators = Hierarchy(kernel, self.tol, self.degree)
        self._pairs: tuple[int, int] | None = None  # near and far

    @property
    def parameters(self) -> dict[str, Any]:
        """Those that were given, and the side of the root: it depends on points set before."""
        return {**self._given, "width": self.width}

    def set_points(self, sources: np.ndarray, targets: np.ndarray | None) -> None:
        """Sort the points, (3, N) and (3, M), and find who acts on whom; the arrays are kept."""
        self.seconds = Seconds()
        self._pairs = None
        same = targets is None
        points = sources if targets is None else np.concatenate([sources, targets], axis=1)
        self.sources, self.targets = sources, sources if targets is None else targets
        self.source_order = np.arange(self.sources.shape[1])
        self.target_order = np.arange(self.targets.shape[1])
        self._tree: Octree | None = None
        if not (self.sources.size and self.targets.size):
            return
        with self.seconds.stage("tree"), Threads() as threads:
            split = None if same else sources.shape[1]
            self._choose_width(points, split, threads)
            few = points.shape[1] <= self._direct
            leaf_size = points.shape[1] if few else self.leaf_size
            self._tree, self.source_order, self.target_order = build_octree(
                points, split, leaf_size, self.width, threads
            )
            if same:
                self.sources = self.targets = points
            else:
                self.sources = np.ascontiguousarray(sources[:, self.source_order])
                self.targets = np.ascontiguousarray(self.targets[:, self.target_order])
            self._lists = find_lists(self._tree, expansion_size(self.tol, self.degree), threads)
        with self.seconds.stage("operators"):
            first, levels = first_level(self._tree, self._lists), range(self._tree.depth + 1)
            self._operators.serve(first, [self._tree.half(level) for level in levels[first:]])

    def work(self, sources: np.ndarray, targets: np.ndarray | None) -> Work:
        """Return what a sum over such points takes, as a sample tells; nothing is built."""
        points = sources if targets is None else np.concatenate([sources, targets], axis=1)
        with Threads() as threads:
            self._choose_width(points, None if targets is None else sources.shape[1], threads)
        if points.shape[1] > self._direct:
            return self._work
        return Work(sources.shape[1] * (sources if targets is None else targets).shape[1], 0.0, 0)

    def _choose_width(self, points: np.ndarray, split: int | None, threads: Threads) -> None:
        """Choose the side of the root, and keep it as long as points fit."""
        widths = root_widths(Box.around(points))
        if not widths[0] <= self.width <= widths[-1]:
            every = sampling_interval(points.shape[1], self.leaf_size)
            fewer = None if split is None else -(-split // every)
            self.width, self._work = choose_width(
                widths, points[:, ::every], fewer, every, self.leaf_size, self._cube_cost, threads
            )

    def execute(self, strengths: np.ndarray) -> np.ndarray:
        """Return the sum, (M, value_size), of strengths (N, strength_size)."""
        values = np.zeros((self.targets.shape[1], self.kernel.value_size))
        self._pairs = 0, 0
        if self._tree is None:
            return values
        prepared = self._tree, self._lists, self._operators
        with blas_of_one_thread, Threads(self._progress) as threads:
            weights, unit = self._weights(strengths, threads)
            far = FarField(*prepared, threads)
            near = NearField(self.kernel, *prepared, self.sources, weights, threads)
            with self.seconds.stage("upward"):
                multipole = far.upward(self.sources, weights)
            coming = self._send(multipole)
            with self.seconds.stage("near"):
                near.sum_neighbours(multipole, self.targets, self.target_order, values, coming.look)
            self._receive(multipole, coming)
            with self.seconds.stage("translations"):
                local = far.translate(multipole)
                near.act_on_smaller(local)
            with self.seconds.stage("downward"):
                far.downward(local)
            with self.seconds.stage("far"):
                far.evaluate(local, self.targets, self.target_order, values)
                values *= unit
        self._pairs = near.near_pairs, far.pairs + near.far_pairs
        return values

    def _weights(self, strengths: np.ndarray, threads: Threads) -> tuple[np.ndarray, float]:
        """Return weights in tree order, (weight_size, N), and the unit that they are in.

        It is a power of two: singles hold nothing below 1e-38, nor above 1e38.
        """
        with self.seconds.stage("weights"):
            weights = np.empty((self.kernel.weight_size, len(strengths)))
            load_weights(self.kernel, strengths, self.source_order, weights, threads)
            unit = self._power_of_two(max(weights.max(), -weights.min()))
            weights /= unit
        return weights, unit

    def _power_of_two(self, largest: float) -> float:
        """Return a power of two above the largest weight."""
        return math.ldexp(0.5, math.frexp(largest)[1])

    def _send(self, multipole: Expansions) -> Delivery:
        """Begin to exchange expansions with others."""
        return NOTHING

    def _receive(self, multipole: Expansions, coming: Delivery) -> None:
        """Take the expansions of others."""

    @property
    def effort(self) -> float:
        """What the last sum took, in near pairs."""
        cubes = 0 if self._tree is None else len(self._tree.level)
        return float((self._pairs or (0, 0))[0] + self._cube_cost * cubes)

    def info(self) -> dict[str, Any]:
        """Return parameters, the size of the tree, pairs of the last sum and bytes held."""
        near_pairs, far_pairs = self._pairs or (None, None)
        arrays: list[np.ndarray] = [self.sources, self.source_order]
        if self.targets is not self.sources:
            arrays += [self.targets, self.target_order]
        depth = boxes = 0
        degrees: set[int] = set()
        if self._tree is not None:
            arrays += [a for a in self._tree if isinstance(a, np.ndarray)]
            arrays += [*self._lists.near, *self._lists.coarse, *self._operators.arrays()]
            degrees = {level.degree for level in self._operators.levels.values()}
            depth, boxes = self._tree.depth, len(self._tree.level)
        return {
            "tol": self.tol,
            "degree": self.degree or max(degrees, default=None),
            "leaf_size": self.leaf_size,
            "precision": np.dtype(self._operators.dtype).name,
            "depth": depth,
            "clusters": boxes,
            "near_pairs": near_pairs,
            "far_pairs": far_pairs,
            # Levels may share their operators.
            "bytes": sum({id(array): array.nbytes for array in arrays}.values()),
        }
