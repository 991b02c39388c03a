"""The walk up the tree that fills the expansions: K algorithm 2 line 6, T section 5."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import prange

from treecode._jit import compiled_parallel, method_hook
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


def fill(expansion: Any, tree: Tree, sources: np.ndarray, weights: np.ndarray) -> None:
    """Compute the expansions of all clusters that have one.

    Parameters
    ----------
    expansion : NamedTuple
        With the methods above, and `slot`, the row of each cluster in its data or -1.
    tree : Tree
    sources, weights : (3, N) and (weight_size, N) float64
        In tree order.
    """
    levels = np.searchsorted(tree.level, np.arange(tree.depth + 2))
    _fill(expansion, tree, levels, sources, weights)


@compiled_parallel
def _fill(expansion, tree, levels, sources, weights):
    for level in range(len(levels) - 2, -1, -1):
        for cluster in prange(levels[level], levels[level + 1]):
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
