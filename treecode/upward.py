"""The walk up the tree that fills the expansions: K algorithm 2 line 6, T section 5."""

from __future__ import annotations

from typing import Any

import numpy as np

from treecode._jit import compiled, method_hook
from treecode.threads import Threads
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
    expansion: Any, tree: Tree, sources: np.ndarray, weights: np.ndarray, threads: Threads
) -> None:
    """Compute the expansions of all clusters that have one.

    Parameters
    ----------
    expansion : NamedTuple
        With the methods above, and `slot`, the row of each cluster in its data or -1.
    tree : Tree
    sources, weights : (3, N) and (weight_size, N) float64
        In tree order.
    threads : Threads
    """
    levels = np.searchsorted(tree.level, np.arange(tree.depth + 2)).tolist()
    for first, stop in zip(levels[-2::-1], levels[:0:-1], strict=True):

        def fill_some(some: slice, first: int = first) -> None:
            begin, end = first + some.start, first + some.stop
            _fill(expansion, tree, begin, end, sources, weights)

        threads(fill_some, stop - first)


@compiled
def _fill(expansion, tree, begin, end, sources, weights):
    for cluster in range(begin, end):
        if expansion.slot[cluster] >= 0:
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
