"""Cubes that are halved in all directions, and who interacts with whom among them."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from treecode._jit import compiled, inlined
from treecode.threads import Threads
from treecode.tree import OCTANTS, count_octants, sort_octants

_MAX_LEVEL = 48  # centres and cells are then whole numbers below 2^53 of one unit
_LEAST = 2.0**-490  # squares of shorter lengths are below the normal numbers
_NEIGHBOURS = 27
# Part of the points for which alone no further level is opened, if no cube holds more than twice
# what it may: its operators take longer to build than they save.
_FEW = 0.01
_PIECES = 64  # of the boxes of a level, for the threads
_SELF = 13  # the number of the cell itself among its neighbours


class Octree(NamedTuple):
    """Cubes with points, level by level from the root; the children of one in a row.

    Attributes
    ----------
    low : (3,) float64
        Lowest corner of the root.
    width : float
        Side of the root.
    cell : (B, 3) int64
        Position of a box among those of its level.
    level, parent, octant : (B,) int64
        Depth, number of the parent (-1 for the root), and place in it: bit d is the upper half in
        direction d.
    child : (B, 8) int64
        Children by octant; -1 where there are no points.
    leaf : (B,) bool
        Whether a box has no children.
    source, target : (B, 2) int64
        Ranges of the sources and targets inside, in tree order.
    neighbour : (B, 27) int64
        Boxes of the same level that touch, itself included; -1 for none.
    first : (levels + 1,) int64
        First box of each level.
    """

    low: np.ndarray
    width: float
    cell: np.ndarray
    level: np.ndarray
    parent: np.ndarray
    octant: np.ndarray
    child: np.ndarray
    leaf: np.ndarray
    source: np.ndarray
    target: np.ndarray
    neighbour: np.ndarray
    first: np.ndarray

    @property
    def depth(self) -> int:
        """Levels below the root."""
        return len(self.first) - 2

    def half(self, level: int) -> float:
        """Return half the side of the boxes of a level."""
        return 0.5 * math.ldexp(self.width, -level)

    def centers(self, boxes: np.ndarray) -> np.ndarray:
        """Return the centres of some boxes, (n, 3)."""
        width = np.ldexp(self.width, -self.level[boxes])
        return self.low + (self.cell[boxes] + 0.5) * width[:, None]


def root_widths(points: np.ndarray) -> list[float]:
    """Return eight sides of a root around points, (3, P), from the least to almost twice that.

    They are 8, 9, ... or 15 times a power of two, so that a side stays the same while points move
    a little, and centres can be exact.
    """
    low, high = points.min(axis=1), points.max(axis=1)
    extent = 2.0 * float((0.5 * high - 0.5 * low).max())
    # Room for the outermost points, which rounding may put outside.
    least = max(extent * (1.0 + 2.0**-40) + 2.0 * _spacing(points, extent), 1e-280)
    unit = math.ldexp(1.0, math.frexp(least)[1] - 4)
    widths = [m * unit for m in (*range(8, 16), *range(16, 32, 2))]
    return [width for width in widths if width >= least][:8]


def _spacing(points: np.ndarray, width: float) -> float:
    """Return a power of two of which all doubles are multiples that may be a root's coordinates."""
    return float(np.spacing(np.abs(points).max() + width))


def build_octree(
    points: np.ndarray, sources: int | None, leaf_size: int, width: float, threads: Threads
) -> tuple[Octree, np.ndarray, np.ndarray]:
    """Sort points into cubes of at most `leaf_size` sources and as many targets.

    Boxes without points do not exist. Where so few points are in fuller boxes that another level
    would not pay, these hold up to twice as many.

    Parameters
    ----------
    points : (3, P) float64
        Sources, then targets; permuted.
    sources : int or None
        How many of the points are sources; None if all are both.
    leaf_size : int
    width : float
        Side of the root.
    threads : Threads

    Returns
    -------
    Octree
    source_order, target_order : (N,) and (M,) int64
        ``sources_in_tree_order = sources[source_order]``; the same array if all points are both.
    """
    count = points.shape[1]
    order = np.arange(count)
    low, high = points.min(axis=1), points.max(axis=1)
    # Centres are exact: at 48 levels they were off by a hundredth of a cube, and errors of 1e-8
    # became 6e-4. So the corner, and halves of the finest sides, are multiples of one unit.
    spacing = max(_spacing(points, width), _LEAST)
    levels = math.frexp(width)[1] - math.frexp(spacing)[1] - 4
    levels = min(_MAX_LEVEL, max(0, levels))
    corner = np.rint((0.5 * low + 0.5 * high - 0.5 * width) / spacing) * spacing
    split = count if sources is None else sources
    table, cell = _split(points, order, split, corner, width, leaf_size, levels, threads)
    level, parent, octant, start, stop = table
    first = np.searchsorted(level, np.arange(level[-1] + 2))
    child = np.full((len(level), OCTANTS), -1)
    child[parent[1:], octant[1:]] = np.arange(1, len(level))
    is_source = order < split
    ranges = np.stack([start, stop], axis=1)
    if sources is None:
        source = target = ranges
        orders = order, order
    else:
        before = np.append(0, np.cumsum(is_source))
        source = before[ranges]
        target = ranges - source
        orders = order[is_source], order[~is_source] - split
    neighbour = np.full((len(level), _NEIGHBOURS), -1)
    neighbour[0, _SELF] = 0
    _meet(parent, octant, child, neighbour)
    leaf = np.all(child < 0, axis=1)
    tree = Octree(
        corner, width, cell, level, parent, octant, child, leaf, source, target, neighbour, first
    )
    return tree, *orders


def _split(
    points: np.ndarray,
    order: np.ndarray,
    split: int,
    low: np.ndarray,
    width: float,
    leaf_size: int,
    levels: int,
    threads: Threads,
) -> tuple[np.ndarray, np.ndarray]:
    """Return level, parent, octant, start and stop of each box, (5, B), and its cell, (B, 3)."""
    count = points.shape[1]
    tables = [np.array([[0], [-1], [0], [0], [count]])]
    cells = [np.zeros((1, 3), np.int64)]
    first = 0
    for level in range(levels):
        start, stop = tables[-1][3:]
        size = full = stop - start
        if split < count:
            before = np.append(0, np.cumsum(order < split))
            sources = before[stop] - before[start]
            full = np.maximum(sources, size - sources)
        boxes = np.flatnonzero(full > leaf_size)
        if full.max() <= 2 * leaf_size and size[boxes].sum() <= _FEW * count:
            break
        middle = low + (cells[-1][boxes] + 0.5) * (width * 0.5**level)
        begin = np.empty((len(boxes), OCTANTS + 1), np.int64)
        begin[:, 0], begin[:, -1] = start[boxes], stop[boxes]

        def sort(chunk: slice, middle: np.ndarray = middle, begin: np.ndarray = begin) -> None:
            _sort(points, order, middle[chunk], begin[chunk])

        threads(sort, len(boxes), 1 + len(boxes) // _PIECES)
        place, octant = np.nonzero(np.diff(begin))
        if len(place) == 0:
            break
        lowest, highest = begin[place, octant], begin[place, octant + 1]
        parent = boxes[place]
        depth = np.full(len(place), level + 1)
        tables.append(np.stack([depth, first + parent, octant, lowest, highest]))
        cells.append(2 * cells[-1][parent] + (octant[:, None] >> np.arange(3) & 1))
        first += len(start)
    return np.concatenate(tables, axis=1), np.concatenate(cells)


@inlined
def _coincide(points, start, stop):
    """Tell whether some points are one: no cube is small enough to part them."""
    for i in range(start + 1, stop):
        for d in range(3):
            if points[d, i] != points[d, start]:
                return False
    return True


@compiled
def _sort(points, order, middle, begin):
    """Sort the points of some boxes by octant, and write where each begins.

    Octant o of box b is to go from ``begin[b, o]`` to ``begin[b, o + 1]``; the first and the last
    are known. If all points of a box are one, all its octants are empty.
    """
    for box in range(len(begin)):
        start, stop = begin[box, 0], begin[box, OCTANTS]
        if _coincide(points, start, stop):
            for octant in range(OCTANTS):
                begin[box, octant + 1] = start
        else:
            count_octants(points, start, stop, middle[box], begin[box])
            sort_octants(points, order, middle[box], begin[box])


@inlined
def relative(parent_octant, shift, d):
    """Return the parent's shift (-1, 0, 1) and the octant bit of a cell `shift` cells away."""
    position = (parent_octant >> d & 1) + shift
    return position >> 1, position & 1


@inlined
def cell_at(octant, dx, dy, dz, parent, neighbour, child):
    """Return the box that lies (dx, dy, dz) cells from a box with this octant and parent, or -1."""
    px, bx = relative(octant, dx, 0)
    py, by = relative(octant, dy, 1)
    pz, bz = relative(octant, dz, 2)
    if max(abs(px), abs(py), abs(pz)) > 1:
        return -1
    uncle = neighbour[parent, (px + 1) * 9 + (py + 1) * 3 + pz + 1]
    return child[uncle, bx + 2 * by + 4 * bz] if uncle >= 0 else -1


@compiled
def _meet(parent, octant, child, neighbour):
    """Fill the neighbours: a child of the parent's neighbours."""
    for box in range(1, len(parent)):
        for slot in range(neighbour.shape[1]):
            dx, dy, dz = slot // 9 - 1, slot // 3 % 3 - 1, slot % 3 - 1
            neighbour[box, slot] = cell_at(octant[box], dx, dy, dz, parent[box], neighbour, child)


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

    threads(find, len(boxes), 1 + len(boxes) // _PIECES)
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
