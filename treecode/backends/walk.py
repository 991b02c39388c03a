"""Sums of targets that walk down a tree of sources: treecodes, and direct summation."""

from __future__ import annotations

import sys
from types import ModuleType
from typing import Any

import numpy as np

from treecode.kernels.base import Kernel
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
    accepted,
    evaluate_batches,
    load_weights,
)
from treecode.tree import build_tree

PRECISIONS = "float64", "float32"


class Walk:
    """A sum by one of the modules `direct`, `kitc` and `taylor`; see `treecode.Plan`."""

    def __init__(
        self,
        module: ModuleType,
        kernel: Kernel,
        theta: float,
        degree: int,
        leaf_size: int,
        precision: str,
        progress: bool,
    ) -> None:
        self.kernel, self._progress = kernel, progress
        self._module_name = module.__name__  # modules cannot be pickled
        self.theta, self.degree, self.leaf_size = theta, degree, leaf_size
        self._dtype: Any = np.dtype(precision).type
        self._notes: np.ndarray | None = None

    @property
    def _module(self) -> Any:
        return sys.modules[self._module_name]

    def set_points(self, sources: np.ndarray, targets: np.ndarray | None) -> None:
        """Sort the points, (3, N) and (3, M); the arrays are kept, and permuted."""
        self.seconds = Seconds()
        with self.seconds.stage("tree"):
            self.sources = sources
            self._tree, self.source_order = self._module.build(sources, self.leaf_size)
            if targets is None:
                self.targets, self.target_order = self.sources, self.source_order
                around = self._tree
            else:
                self.targets = targets
                around, self.target_order = build_tree(targets, BATCH_SIZE, shrink=False)
            self._distance2 = self._module.distance2(self._tree, self.theta)
            wanted = accepted(self._tree, self._distance2, around)
            self._expansion = self._module.prepare(
                self.kernel, self._tree, self.degree, wanted, self._dtype
            )
            self._notes = None

    def execute(self, strengths: np.ndarray) -> np.ndarray:
        """Return the sum, (M, value_size), of strengths (N, strength_size)."""
        return self.run(strengths)[0]

    def run(self, strengths: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the sum, and the linear weights, (weight_size, N), in the order of `sources`."""
        values = np.zeros((self.targets.shape[1], self.kernel.value_size))
        weights = np.empty((self.kernel.weight_size, len(strengths)))
        batches = -(-len(values) // BATCH_SIZE)
        notes = self._notes = np.zeros((batches, NOTES), np.int64)
        if len(strengths) and len(values):
            # No more threads than batches of points: a sum of 76 points took 0.19 ms on one and
            # 10 ms on two while another process computed.
            most = -(-len(strengths) // BATCH_SIZE)
            with self.seconds.stage("weights"), Threads(most=most) as threads:
                load_weights(self.kernel, strengths, self.source_order, weights, threads)
                self._module.update(self._expansion, self._tree, self.sources, weights, threads)
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
        return values, weights

    @property
    def effort(self) -> float:
        """What the last sum took, in pairs."""
        return 0.0 if self._notes is None else float(self._notes[:, [NEAR_PAIRS, FAR_PAIRS]].sum())

    def info(self) -> dict[str, Any]:
        """Return parameters, the size of the tree, pairs of the last sum and bytes held."""
        noted = [None] * NOTES if self._notes is None else self._notes.sum(axis=0).tolist()
        held = [self.sources, self.source_order, self._distance2, *self._tree]
        held += [a for a in self._expansion if isinstance(a, np.ndarray)]
        if self.targets is not self.sources:
            held += [self.targets, self.target_order]
        return {
            "theta": self.theta,
            "degree": self.degree,
            "leaf_size": self.leaf_size,
            "precision": self._dtype.__name__,
            "depth": self._tree.depth,
            "clusters": len(self._tree.radius),
            "near_pairs": noted[NEAR_PAIRS],
            "far_pairs": noted[FAR_PAIRS],
            "bytes": sum(array.nbytes for array in held),
        }

    def _divide_walk(self, notes: np.ndarray) -> None:
        """Divide the time of the walk into near and far sums, and the rest, as batches noted."""
        ticks = notes.sum(axis=0)
        per_tick = self.seconds["walk"] / max(1, ticks[ALL_TICKS])
        for name, column in (("near", NEAR_TICKS), ("far", FAR_TICKS)):
            self.seconds[name] = per_tick * float(ticks[column])
            self.seconds["walk"] -= self.seconds[name]
