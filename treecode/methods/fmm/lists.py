"""Who acts on whom directly: leaves on leaves, and cubes on cubes of another size."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from treecode.methods.fmm.octree import Octree, direct_lists
from treecode.threads import Threads


class Lists(NamedTuple):
    """Leaves of a tree, and what acts on boxes not through a translation.

    Attributes
    ----------
    has_targets : (boxes,) bool
    source_leaves, target_leaves : int64 arrays
    near : begin and entries
        What acts on the targets of each of `target_leaves`, as of `octree.direct_lists`.
    coarse_boxes : int64 array
        Boxes on whose expansion points of larger leaves act,
    coarse : begin and entries
        which are these.
    proxy_boxes : int64 array
        Boxes whose expansion acts on targets of larger leaves, as points that stand for it.
    """

    has_targets: np.ndarray
    source_leaves: np.ndarray
    target_leaves: np.ndarray
    near: tuple[np.ndarray, np.ndarray]
    coarse_boxes: np.ndarray
    coarse: tuple[np.ndarray, np.ndarray]
    proxy_boxes: np.ndarray

    def boxes_with_targets(self, tree: Octree, level: int) -> np.ndarray:
        """Return those of one level."""
        boxes = np.arange(tree.first[level], tree.first[level + 1])
        return boxes[self.has_targets[boxes]]


def find_lists(tree: Octree, expansion_size: int, threads: Threads) -> Lists:
    """Find the lists of a tree; an expansion stands for more than `expansion_size` points only."""
    sources, targets = np.diff(tree.source)[:, 0], np.diff(tree.target)[:, 0]
    has_targets = targets > 0
    target_leaves = np.flatnonzero(tree.leaf & has_targets)
    near = direct_lists(tree, target_leaves, expansion_size, False, threads)
    every = np.arange(len(tree.level))
    begin, entries = direct_lists(tree, every, expansion_size, True, threads)
    coarse_boxes = np.flatnonzero(np.diff(begin))
    return Lists(
        has_targets,
        np.flatnonzero(tree.leaf & (sources > 0)),
        target_leaves,
        near,
        coarse_boxes,
        (np.append(0, np.diff(begin)[coarse_boxes].cumsum()), entries),
        np.unique(~near[1][near[1] < 0]),
    )
