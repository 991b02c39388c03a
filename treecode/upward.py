"""The walk up the tree that fills the expansions: K algorithm 2 line 6, T section 5."""

from __future__ import annotations

from typing import Any

import numpy as np

from treecode._jit import compiled, method_hook
from treecode.ranks import OneRank
from treecode.threads import Threads
from treecode.timing import Seconds
from treecode.tree import Tree


@method_hook
def gather_particles(self: Any, tree, cluster, sources, weights, start, stop) -> None:
    """Add the particles ``start:stop`` to the expansion of `cluster`."""
    self.gather_particles(tree, cluster, sources, weights, start, stop)


@method_hook
def gather_child(self: Any, tree, cluster, child) -> None:
    """Add the expansion of a child to that of `cluster`."""
    self.gather_child(tree, cluster, child)


@method_hook
def finish(self: Any, cluster) -> None:
    """Derive what is evaluated from what has been gathered."""
    self.finish(cluster)


def fill(
    expansion: Any,
    tree: Tree,
    sources: np.ndarray,
    weights: np.ndarray,
    threads: Threads,
    ranks: OneRank,
    seconds: Seconds,
) -> None:
    """Compute the expansions of all clusters that have one, on all ranks.

    Each rank fills the clusters within its share of the sources. All ranks fill those that lie in
    several shares: on each level, no more than there are ends of shares.

    Parameters
    ----------
    expansion : NamedTuple
        With the methods above; `slot`, (C,), the row of each cluster in its data or -1; and `data`,
        (slots, ...), all numbers that these methods write.
    tree : Tree
        The same on all ranks, as is `slot`.
    sources, weights : (3, N) and (weight_size, N) float64
        In tree order.
    threads : Threads
    ranks : OneRank
    seconds : Seconds
        Of which the exchange among ranks is the stage "expansions".
    """

    def fill_up(clusters: np.ndarray) -> None:
        levels = np.searchsorted(tree.level[clusters], np.arange(tree.depth + 2)).tolist()
        for first, stop in zip(levels[-2::-1], levels[:0:-1], strict=True):

            def fill_some(some: slice, level: np.ndarray = clusters[first:stop]) -> None:
                _fill(expansion, tree, level[some], sources, weights)

            threads(fill_some, stop - first)

    expansion.data[...] = 0.0
    clusters = np.flatnonzero(expansion.slot >= 0)
    if ranks.size == 1:
        fill_up(clusters)
        return
    owner = _owners(tree, clusters, ranks.cuts(sources.shape[1]))
    fill_up(clusters[owner == ranks.rank])
    with seconds.stage("expansions"):
        rows = expansion.slot[clusters]
        by_owner = np.argsort(owner, kind="stable")[np.count_nonzero(owner < 0) :]
        expansion.data[rows[by_owner]] = ranks.gather(expansion.data[rows[owner == ranks.rank]])
    fill_up(clusters[owner < 0])


def _owners(tree: Tree, clusters: np.ndarray, cuts: np.ndarray) -> np.ndarray:
    """Return in which share of the sources each of some clusters lies; -1 if not in one alone."""
    first = np.searchsorted(cuts, tree.start[clusters], side="right") - 1
    last = np.searchsorted(cuts, tree.stop[clusters] - 1, side="right") - 1
    return np.where(first == last, first, -1)


@compiled
def _fill(expansion, tree, clusters, sources, weights):
    for cluster in clusters:
        if tree.children[cluster] == 0:
            start, stop = tree.start[cluster], tree.stop[cluster]
            gather_particles(expansion, tree, cluster, sources, weights, start, stop)
        for k in range(tree.children[cluster]):
            child = tree.child[cluster] + k
            if expansion.slot[child] >= 0:
                gather_child(expansion, tree, cluster, child)
            else:
                start, stop = tree.start[child], tree.stop[child]
                gather_particles(expansion, tree, cluster, sources, weights, start, stop)
        finish(expansion, cluster)
