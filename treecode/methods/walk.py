"""Sums of targets that walk down a tree of sources: treecodes, and direct summation."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from treecode.kernels.base import Kernel
from treecode.methods.base import Method, Sum
from treecode.ranks import OneRank
from treecode.threads import Threads
from treecode.timing import Seconds
from treecode.traversal import (
    ALL_TICKS,
    BATCH_SIZE,
    FAR_PAIRS,
    FAR_TICKS,
    NEAR_PAIRS,
    NEAR_TICKS,
    NOTES,
    acceptance,
    accepted,
    evaluate_batches,
    load_weights,
)
from treecode.tree import Tree, build_tree
from treecode.upward import fill


class WalkMethod(Method):
    """A method whose sums are walks: it has a tree, and expansions of the clusters.

    The expansions are a NamedTuple whose methods are compiled: `holds`, `approximate` and `terms`
    for the walk (`treecode.traversal`), and if there are any `gather_particles`, `gather_child` and
    `finish` to fill its `data` (`treecode.upward`).
    """

    def make(self, kernel: Kernel, parameters: Mapping[str, Any], progress: bool = False) -> Sum:
        """Return a walk without points."""
        return Walk(self, kernel, parameters, progress)

    def build(self, points: np.ndarray, leaf_size: int) -> tuple[Tree, np.ndarray]:
        """Sort points, (3, N), in place; return their tree and order."""
        raise NotImplementedError

    def far_distance2(self, tree: Tree, theta: float) -> np.ndarray:
        """Return the square of the distance from which each cluster is far, (C,)."""
        return acceptance(tree, theta)

    def prepare(self, kernel: Any, tree: Tree, degree: int, wanted: np.ndarray, dtype: type) -> Any:
        """Return room for the expansions of the `wanted` clusters that are to have one.

        `dtype` is the precision of the sums.
        """
        raise NotImplementedError

    def update(
        self,
        expansion: Any,
        tree: Tree,
        sources: np.ndarray,
        weights: np.ndarray,
        threads: Threads,
        ranks: OneRank,
        seconds: Seconds,
    ) -> None:
        """Fill the expansions from the sources' `weights`, (weight_size, N) in tree order."""
        fill(expansion, tree, sources, weights, threads, ranks, seconds)


class Walk:
    """A sum by a `WalkMethod`.

    Attributes
    ----------
    ranks : OneRank
        Share the targets, if there are several, and then the filling of the expansions too.
    """

    def __init__(
        self, method: WalkMethod, kernel: Kernel, parameters: Mapping[str, Any], progress: bool
    ) -> None:
        self.kernel, self.parameters, self._progress = kernel, parameters, progress
        self._method = method
        # Direct summation has no theta, no degree, and one leaf.
        self._theta = parameters.get("theta", 0.5)
        self._degree, self._leaf_size = parameters.get("degree", 0), parameters.get("leaf_size", 1)
        self._dtype: Any = np.dtype(parameters["precision"]).type
        self._notes: np.ndarray | None = None
        self.ranks = OneRank()

    def set_points(self, sources: np.ndarray, targets: np.ndarray | None) -> None:
        """Sort the points, (3, N) and (3, M); the arrays are kept, and permuted."""
        self.seconds = Seconds()
        with self.seconds.stage("tree"):
            self.sources = sources
            self._tree, self.source_order = self._method.build(sources, self._leaf_size)
            if targets is None:
                self.targets, self.target_order = self.sources, self.source_order
                around = self._tree
            else:
                self.targets = targets
                around, self.target_order = build_tree(targets, BATCH_SIZE, shrink=False)
            self._distance2 = self._method.far_distance2(self._tree, self._theta)
            wanted = accepted(self._tree, self._distance2, self._of_all_ranks(around))
            self._expansion = self._method.prepare(
                self.kernel, self._tree, self._degree, wanted, self._dtype
            )
            self._notes = None

    def execute(self, strengths: np.ndarray) -> np.ndarray:
        """Return the sum, (M, value_size), of strengths (N, strength_size)."""
        values = np.zeros((self.targets.shape[1], self.kernel.value_size))
        weights = np.empty((self.kernel.weight_size, len(strengths)))
        batches = -(-len(values) // BATCH_SIZE)
        notes = self._notes = np.zeros((batches, NOTES), np.int64)
        if len(strengths) and (len(values) or self.ranks.size > 1):
            # No more threads than batches of points: a sum of 76 points took 0.19 ms on one and
            # 10 ms on two while another process computed.
            most = -(-len(strengths) // BATCH_SIZE)
            with self.seconds.stage("weights"), Threads(most=most) as threads:
                load_weights(self.kernel, strengths, self.source_order, weights, threads)
                self._method.update(
                    self._expansion,
                    self._tree,
                    self.sources,
                    weights,
                    threads,
                    self.ranks,
                    self.seconds,
                )
            self.seconds["weights"] -= self.seconds.get("expansions", 0.0)  # a stage of its own
            like = np.empty(0, self._dtype)

            def evaluate(some: slice) -> None:
                evaluate_batches(
                    self.kernel,
                    self._expansion,
                    self._tree,
                    self._distance2,
                    self.sources,
                    weights,
                    self.targets,
                    self.target_order,
                    some.start,
                    some.stop,
                    like,
                    values,
                    notes,
                )

            with self.seconds.stage("walk"), Threads(self._progress, batches) as threads:
                threads(evaluate, batches, 1, progress=True)
            self._divide_walk(notes)
        return values

    @property
    def effort(self) -> float:
        """Work of the last sum, in pairs."""
        return 0.0 if self._notes is None else float(self._notes[:, [NEAR_PAIRS, FAR_PAIRS]].sum())

    def info(self) -> dict[str, Any]:
        """Return parameters, the size of the tree, pairs of the last sum and bytes held."""
        noted = [None] * NOTES if self._notes is None else self._notes.sum(axis=0).tolist()
        arrays = [self.sources, self.source_order, self._distance2, *self._tree]
        arrays += [a for a in self._expansion if isinstance(a, np.ndarray)]
        if self.targets is not self.sources:
            arrays += [self.targets, self.target_order]
        return {
            **self.parameters,
            "depth": self._tree.depth,
            "clusters": len(self._tree.radius),
            "near_pairs": noted[NEAR_PAIRS],
            "far_pairs": noted[FAR_PAIRS],
            "bytes": sum(array.nbytes for array in arrays),
        }

    def _of_all_ranks(self, around: Tree) -> Tree:
        """Return a tree whose root is the box around the targets of all ranks.

        It decides which clusters have an expansion: the same ones on all ranks.
        """
        if self.ranks.size == 1:
            return around
        own = self.targets
        corners = own if not own.size else np.stack([own.min(axis=1), own.max(axis=1)], axis=1)
        of_all = np.concatenate(self.ranks.exchange(corners), axis=1)
        return build_tree(of_all, BATCH_SIZE, shrink=False)[0]

    def _divide_walk(self, notes: np.ndarray) -> None:
        """Divide the time of the walk into near and far sums, and the rest, as batches noted."""
        ticks = notes.sum(axis=0)
        per_tick = self.seconds["walk"] / max(1, ticks[ALL_TICKS])
        for name, column in (("near", NEAR_TICKS), ("far", FAR_TICKS)):
            self.seconds[name] = per_tick * float(ticks[column])
            self.seconds["walk"] -= self.seconds[name]
