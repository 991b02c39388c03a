"""The walk of a batch of targets down a tree of sources (K algorithm 2, T algorithm 1)."""

from __future__ import annotations

from typing import Any

import numpy as np

from treecode._jit import Driver, inlined, method_hook, standalone, ticks
from treecode._lanes import LANES
from treecode.kernels.base import SMALLEST, Kernel, strength_row, weights
from treecode.pairs import accumulate_near
from treecode.threads import Threads
from treecode.tree import Tree

# Targets that go down the tree together: enough to share the set-up of a far field, few enough
# that every thread has work and that their sums stay in the first-level cache.
BATCH_SIZE = 512

# Notes on a batch: pairs summed, and ticks of a clock that went by meanwhile.
NEAR_PAIRS, FAR_PAIRS, NEAR_TICKS, FAR_TICKS, ALL_TICKS = range(5)
NOTES = 5


def acceptance(tree: Tree, theta: float) -> np.ndarray:
    """Return the square of the distance from which each cluster is well separated, (r/theta)^2.

    A target exactly at the centre of a cluster without extent is not well separated (r/R is 0/0).
    """
    with np.errstate(over="ignore"):  # of a tiny theta, for which no cluster is far enough
        return np.maximum((tree.radius / theta) ** 2, SMALLEST)


def accepted(tree: Tree, distance2: np.ndarray, targets: Tree) -> np.ndarray:
    """Tell which clusters some target may be far from: the others need no expansion, (C,).

    Those that the farthest corner of the box around the targets is not far from have none. The root
    of a tree is such a cluster where targets are sources.
    """
    if not len(targets.radius):
        return np.zeros(len(tree.radius), bool)
    corner = np.abs(tree.center - targets.center[:, :1]) + targets.half[:, :1]
    return (corner * corner).sum(axis=0) >= distance2


@method_hook
def holds(self: Any, cluster: int) -> bool:
    """Tell whether an expansion exists for this cluster (it does not where points are cheaper)."""
    return self.holds(cluster)


@method_hook
def approximate(self: Any, kernel, tree, cluster, targets, first, last, out) -> None:
    """Add the expansion of `cluster` at ``targets[:, first:last]`` to ``out[:, first:last]``."""
    self.approximate(kernel, tree, cluster, targets, first, last, out)


@method_hook
def terms(self: Any) -> int:
    """Return the number of terms of one expansion, as evaluated for one target."""
    return self.terms()


@inlined
def _accepts(distance2, center, targets, i):
    dx = targets[0, i] - center[0]
    dy = targets[1, i] - center[1]
    dz = targets[2, i] - center[2]
    return dx * dx + dy * dy + dz * dz >= distance2


@inlined
def _separate(distance2, center, block, live, identity):
    """Move the well separated of the first `live` targets behind the others; count those."""
    near = 0
    end = live
    while True:
        while near < end and not _accepts(distance2, center, block, near):
            near += 1
        while near < end and _accepts(distance2, center, block, end - 1):
            end -= 1
        if near == end:
            return near
        for d in range(block.shape[0]):
            block[d, near], block[d, end - 1] = block[d, end - 1], block[d, near]
        identity[near], identity[end - 1] = identity[end - 1], identity[near]


@inlined
def _sum_points(kernel, tree, cluster, block, first, last, sources, weights, like, out, notes):
    start, stop = tree.start[cluster], tree.stop[cluster]
    since = ticks()
    center = tree.center[:, cluster]
    accumulate_near(like, center, kernel, block, first, last, sources, weights, start, stop, out)
    notes[NEAR_TICKS] += ticks() - since
    notes[NEAR_PAIRS] += (last - first) * (stop - start)


@inlined
def _sum_terms(kernel, expansion, tree, cluster, block, first, last, out, notes):
    since = ticks()
    approximate(expansion, kernel, tree, cluster, block, first, last, out)
    notes[FAR_TICKS] += ticks() - since
    notes[FAR_PAIRS] += (last - first) * terms(expansion)


@standalone
def _walk(
    kernel, expansion, tree, distance2, sources, weights, block, identity, stack, like, notes
):
    """Sum over all sources for one batch.

    `block` holds the coordinates of the targets and, below them, their sums. The decision is
    taken target by target, as in the papers: at each cluster the targets that accept it are
    moved to the end of those that arrived, and the rest go on. Both are contiguous.
    """
    out = block[3:]
    stack[0, 0] = 0
    stack[0, 1] = len(identity)
    height = 1
    while height > 0:
        height -= 1
        cluster, live = stack[height, 0], stack[height, 1]
        near = _separate(distance2[cluster], tree.center[:, cluster], block, live, identity)
        if near < live:
            if holds(expansion, cluster):
                _sum_terms(kernel, expansion, tree, cluster, block, near, live, out, notes)
            else:
                _sum_points(
                    kernel, tree, cluster, block, near, live, sources, weights, like, out, notes
                )
        if near > 0:
            if tree.children[cluster] == 0:
                _sum_points(
                    kernel, tree, cluster, block, 0, near, sources, weights, like, out, notes
                )
            for k in range(tree.children[cluster]):
                stack[height, 0] = tree.child[cluster] + k
                stack[height, 1] = near
                height += 1


@standalone
def _evaluate_batch(
    kernel, expansion, tree, distance2, sources, weights, targets, order, batch, like, values, notes
):
    since = ticks()
    first = batch * BATCH_SIZE
    size = min(BATCH_SIZE, targets.shape[1] - first)
    block = np.zeros((3 + values.shape[1], size + LANES - 1))
    identity = np.empty(size, np.int64)
    for i in range(size):
        identity[i] = order[first + i]
        for d in range(3):
            block[d, i] = targets[d, first + i]
    stack = np.empty((7 * (tree.level[-1] + 1) + 1, 2), np.int64)
    _walk(kernel, expansion, tree, distance2, sources, weights, block, identity, stack, like, notes)
    for i in range(size):
        for c in range(values.shape[1]):
            values[identity[i], c] = block[3 + c, i]
    notes[ALL_TICKS] = ticks() - since


@Driver
def evaluate_batches(
    kernel, expansion, tree, distance2, sources, weights, targets, order, begin, end, like, values,
    notes,
):  # fmt: skip
    """Evaluate the batches ``begin:end`` of targets.

    The result of a batch does not depend on what is done beside it.

    Parameters
    ----------
    kernel : Kernel
    expansion : NamedTuple with `holds`, `approximate` and `terms`
    tree : Tree
        Of the sources.
    distance2 : (C,) float64
        See `acceptance`.
    sources, weights : (3, N) and (weight_size, N) float64
        In tree order.
    targets : (3, M) float64
        Sorted in space.
    order : (M,) int64
        Row of `values` for each target.
    begin, end : int
    like : (0,) float32 or float64
        Of the precision in which points are summed.
    values : (M, value_size) float64
        Overwritten.
    notes : (number of batches, NOTES) int64
        Zeros, to which those of each batch are added.
    """
    for batch in range(begin, end):
        _evaluate_batch(
            kernel,
            expansion,
            tree,
            distance2,
            sources,
            weights,
            targets,
            order,
            batch,
            like,
            values,
            notes[batch],
        )


def load_weights(
    kernel: Kernel, strengths: np.ndarray, order: np.ndarray, out: np.ndarray, threads: Threads
) -> None:
    """Write the linear weights of ``strengths[order]`` to the columns of `out`."""

    def load_some(some: slice) -> None:
        write_weights(kernel, strengths, order, some.start, some.stop, out)

    threads(load_some, len(order), least=BATCH_SIZE)


@Driver
def write_weights(kernel, strengths, order, begin, end, out):
    """Write the columns ``begin:end``; see `load_weights`."""
    for i in range(begin, end):
        w = weights(kernel, strength_row(kernel, strengths, order[i]))
        for c in range(len(w)):
            out[c, i] = w[c]
