"""Who acts on whom directly: leaves on leaves, and cubes on cubes of another size."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from treecode._jit import compiled, inlined
from treecode.methods.fmm.octree import PIECES, Octree
from treecode.threads import Threads


class Lists(NamedTuple):
    """Leaves of a tree, and what acts on boxes not through a translation.

    Attributes
    ----------
    has_sources, has_targets : (boxes,) bool
    source_leaves, target_leaves : int64 arrays
    near : begin and entries
        What acts on the targets of each of `target_leaves`, as of `direct_lists`.
    coarse_boxes : int64 array
        Boxes on whose expansion points of larger leaves act,
    coarse : begin and entries
        which are these.
    proxy_boxes : int64 array
        Boxes whose expansion acts on targets of larger leaves, as points that stand for it.
    """

    has_sources: np.ndarray
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


def find_lists(
    tree: Octree, expansion_size: int, threads: Threads, expands: np.ndarray | None = None
) -> Lists:
    """Find the lists of a tree.

    Parameters
    ----------
    tree : Octree
    expansion_size : int
        An expansion stands for more points than that only.
    threads : Threads
    expands : (boxes,) bool, optional
        Boxes whose sources are expanded here; all by default.
    """
    has_sources = np.diff(tree.source)[:, 0] > 0 if expands is None else expands
    has_targets = np.diff(tree.target)[:, 0] > 0
    target_leaves = np.flatnonzero(tree.leaf & has_targets)
    near = direct_lists(tree, target_leaves, expansion_size, False, threads)
    every = np.arange(len(tree.level))
    begin, entries = direct_lists(tree, every, expansion_size, True, threads)
    coarse_boxes = np.flatnonzero(np.diff(begin))
    return Lists(
        has_sources,
        has_targets,
        np.flatnonzero(tree.leaf & has_sources),
        target_leaves,
        near,
        coarse_boxes,
        (np.append(0, np.diff(begin)[coarse_boxes].cumsum()), entries),
        np.unique(~near[1][near[1] < 0]),
    )


@inlined
def touches(tree, fine, coarse):
    """Tell whether two boxes touch; the first is not the larger."""
    shift = tree.level[fine] - tree.level[coarse]
    for d in range(3):
        cell = tree.cell[fine, d]
        low = tree.cell[coarse, d] << shift
        if cell < low - 1 or cell > (tree.cell[coarse, d] + 1) << shift:
            return False
    return True


@inlined
def _count(ranges, box):
    return ranges[box, 1] - ranges[box, 0]


@inlined
def _emit(entries, count, box):
    if count < len(entries):
        entries[count] = box
    return count + 1


@inlined
def _near_below(tree, leaf, box, expansion_size, stack, entries, count):
    """List what acts on `leaf` directly of a box of its own size that touches it."""
    stack[0] = box
    height = 1
    while height > 0:
        height -= 1
        box = stack[height]
        if _count(tree.source, box) == 0:
            continue
        if not touches(tree, box, leaf):
            proxies = _count(tree.source, box) > expansion_size
            count = _emit(entries, count, ~box if proxies else box)
        elif tree.leaf[box]:
            count = _emit(entries, count, box)
        else:
            for octant in range(tree.child.shape[1]):
                if tree.child[box, octant] >= 0:
                    stack[height] = tree.child[box, octant]
                    height += 1
    return count


@inlined
def _topmost_apart(tree, box, coarse):
    """Return the largest box around `box` that does not touch `coarse`."""
    while not touches(tree, tree.parent[box], coarse):
        box = tree.parent[box]
    return box


@inlined
def _near_of(tree, leaf, expansion_size, stack, entries):
    count = 0
    for slot in range(tree.neighbour.shape[1]):
        box = tree.neighbour[leaf, slot]
        if box >= 0 and tree.leaf[box]:  # most are: without this, lists take 4 times longer
            if _count(tree.source, box):
                count = _emit(entries, count, box)
        elif box >= 0:
            count = _near_below(tree, leaf, box, expansion_size, stack, entries, count)
    around = tree.parent[leaf]
    while around >= 0:
        for slot in range(tree.neighbour.shape[1]):
            box = tree.neighbour[around, slot]
            if box >= 0 and tree.leaf[box] and box != around and _count(tree.source, box):
                apart = not touches(tree, leaf, box)
                if (
                    not apart
                    or _count(tree.target, _topmost_apart(tree, leaf, box)) <= expansion_size
                ):
                    count = _emit(entries, count, box)
        around = tree.parent[around]
    return count


@inlined
def _just_apart(tree, box, coarse):
    """Tell whether `coarse` is a leaf with sources that touches the parent of `box`, not `box`."""
    return (
        tree.leaf[coarse]
        and _count(tree.source, coarse) > 0
        and touches(tree, tree.parent[box], coarse)
        and not touches(tree, box, coarse)
    )


@inlined
def _coarse_of(tree, box, expansion_size, entries):
    """List the larger leaves whose sources act on the expansion of `box`."""
    count = 0
    if _count(tree.target, box) > expansion_size:
        around = tree.parent[box]
        while around >= 0:
            for slot in range(tree.neighbour.shape[1]):
                other = tree.neighbour[around, slot]
                if other >= 0 and other != around and _just_apart(tree, box, other):
                    count = _emit(entries, count, other)
            around = tree.parent[around]
    return count


def direct_lists(
    tree: Octree, boxes: np.ndarray, expansion_size: int, coarse: bool, threads: Threads
) -> tuple[np.ndarray, np.ndarray]:
    """List the boxes whose sources act on some boxes not through a translation.

    Parameters
    ----------
    tree : Octree
    boxes : (n,) int64
        Leaves with targets, or for `coarse` any boxes with targets.
    expansion_size : int
        An expansion stands for more points than that only.
    coarse : bool
        Whether sources act on the boxes' expansions, rather than on their targets.
    threads : Threads

    Returns
    -------
    begin : (n + 1,) int64
    entries : (begin[-1],) int64
        A box whose sources act, or ``~box`` if its expansion does.
    """
    lists: dict[int, tuple[np.ndarray, np.ndarray]] = {0: (np.zeros(0, np.int64),) * 2}

    def find(chunk: slice) -> None:
        lists[chunk.start] = _lists(tree, boxes[chunk], expansion_size, coarse)

    threads(find, len(boxes), 1 + len(boxes) // PIECES)
    counts, entries = map(np.concatenate, zip(*(lists[i] for i in sorted(lists)), strict=True))
    return np.append(0, counts.cumsum()), entries


@compiled
def _lists(tree, boxes, expansion_size, coarse):
    """Return how many entries each of some boxes has, and all of them."""
    counts = np.empty(len(boxes), np.int64)
    stack = np.empty(8 * (len(tree.first) + 1), np.int64)
    buffer = np.empty(1024, np.int64)
    entries = np.empty(1024, np.int64)
    stop = 0
    for i in range(len(boxes)):
        count = -1
        while count < 0:
            if coarse:
                count = _coarse_of(tree, boxes[i], expansion_size, buffer)
            else:
                count = _near_of(tree, boxes[i], expansion_size, stack, buffer)
            if count > len(buffer):
                buffer = np.empty(2 * count, np.int64)
                count = -1
        if stop + count > len(entries):
            larger = np.empty(2 * (stop + count), np.int64)
            for k in range(stop):
                larger[k] = entries[k]
            entries = larger
        for k in range(count):
            entries[stop + k] = buffer[k]
        counts[i] = count
        stop += count
    return counts, entries[:stop].copy()
