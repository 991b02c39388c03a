"""Cubes that are halved in all directions, and who interacts with whom among them."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from treecode._jit import compiled, inlined
from treecode.tree import OCTANTS, count_octants, resized, sort_octants

_MAX_LEVEL = 48  # centres and cells are then whole numbers below 2^53 of one unit
_LEAST = 2.0**-490  # squares of shorter lengths are below the normal numbers
_NEIGHBOURS = 27
# Part of the points for which alone no further level is opened, if no cube holds more than twice
# what it may: its operators take longer to build than they save.
_FEW = 0.01
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
    source: np.ndarray
    target: np.ndarray
    neighbour: np.ndarray
    first: np.ndarray

    @property
    def depth(self) -> int:
        """Levels below the root."""
        return len(self.first) - 2

    @property
    def is_leaf(self) -> np.ndarray:
        """Whether each box has no children."""
        return np.all(self.child < 0, axis=1)

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
    points: np.ndarray, sources: int | None, leaf_size: int, width: float
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
    table, cells = _split(points, order, split, corner, width, leaf_size, levels)
    level, parent, octant, start, stop = table.T
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
    columns = (np.ascontiguousarray(a) for a in (level, parent, octant))
    level, parent, octant = columns
    tree = Octree(
        corner, width, cells, level, parent, octant, child, source, target, neighbour, first
    )
    return tree, *orders


@inlined
def _coincide(points, start, stop):
    """Tell whether some points are one: no cube is small enough to part them."""
    for i in range(start + 1, stop):
        for d in range(3):
            if points[d, i] != points[d, start]:
                return False
    return True


@inlined
def _fullness(order, split, count, start, stop):
    """Return how many sources, or targets if they are more, there are in a range of points."""
    if split == count:
        return stop - start
    sources = 0
    for i in range(start, stop):
        sources += order[i] < split
    return max(sources, stop - start - sources)


@compiled
def _split(points, order, split, low, width, leaf_size, levels):
    """Return level, parent, octant, start and stop of each box, and its cell."""
    capacity = 64
    table = np.zeros((capacity, 5), np.int64)
    cells = np.zeros((capacity, 3), np.int64)
    middle = np.empty(3)
    begin = np.empty(OCTANTS + 1, np.int64)
    table[0, 1] = -1
    table[0, 4] = points.shape[1]
    first, count = 0, 1
    for level in range(levels):
        full = np.empty(count - first, np.int64)
        fullest = together = 0
        for i in range(len(full)):
            start, stop = table[first + i, 3], table[first + i, 4]
            full[i] = _fullness(order, split, points.shape[1], start, stop)
            if full[i] > leaf_size:
                fullest = max(fullest, full[i])
                together += stop - start
        if fullest <= 2 * leaf_size and together <= _FEW * points.shape[1]:
            break
        side = width * 0.5**level
        for box in range(first, first + len(full)):
            start, stop = table[box, 3], table[box, 4]
            if full[box - first] <= leaf_size or _coincide(points, start, stop):
                continue
            for d in range(3):
                middle[d] = low[d] + (cells[box, d] + 0.5) * side
            count_octants(points, start, stop, middle, begin)
            sort_octants(points, order, middle, begin)
            if count + OCTANTS > capacity:
                capacity *= 2
                table = resized(table, count, capacity)
                cells = resized(cells, count, capacity)
            for octant in range(OCTANTS):
                if begin[octant + 1] > begin[octant]:
                    table[count, 0] = level + 1
                    table[count, 1] = box
                    table[count, 2] = octant
                    table[count, 3] = begin[octant]
                    table[count, 4] = begin[octant + 1]
                    for d in range(3):
                        cells[count, d] = 2 * cells[box, d] + (octant >> d & 1)
                    count += 1
        first += len(full)
    return table[:count].copy(), cells[:count].copy()


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
def _is_leaf(tree, box):
    children = 0
    for octant in range(tree.child.shape[1]):
        children += tree.child[box, octant] >= 0
    return children == 0


@inlined
def _emit(entries, count, box):
    if count < len(entries):
        entries[count] = box
    return count + 1


@inlined
def _near_below(tree, leaf, box, worth, stack, entries, count):
    """List what acts on `leaf` directly of a box of its own size that touches it."""
    stack[0] = box
    height = 1
    while height > 0:
        height -= 1
        box = stack[height]
        if _count(tree.source, box) == 0:
            continue
        if not touches(tree, box, leaf):
            proxies = _count(tree.source, box) > worth
            count = _emit(entries, count, ~box if proxies else box)
        elif _is_leaf(tree, box):
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
def _near_of(tree, leaf, worth, stack, entries):
    count = 0
    for slot in range(tree.neighbour.shape[1]):
        box = tree.neighbour[leaf, slot]
        if box >= 0:
            count = _near_below(tree, leaf, box, worth, stack, entries, count)
    around = tree.parent[leaf]
    while around >= 0:
        for slot in range(tree.neighbour.shape[1]):
            box = tree.neighbour[around, slot]
            if box >= 0 and box != around and _count(tree.source, box) and _is_leaf(tree, box):
                apart = not touches(tree, leaf, box)
                if not apart or _count(tree.target, _topmost_apart(tree, leaf, box)) <= worth:
                    count = _emit(entries, count, box)
        around = tree.parent[around]
    return count


@inlined
def _just_apart(tree, box, coarse):
    """Tell whether `coarse` is a leaf with sources that touches the parent of `box`, not `box`."""
    return (
        _count(tree.source, coarse) > 0
        and _is_leaf(tree, coarse)
        and touches(tree, tree.parent[box], coarse)
        and not touches(tree, box, coarse)
    )


@inlined
def _coarse_of(tree, box, worth, entries):
    """List the larger leaves whose sources act on the expansion of `box`."""
    count = 0
    if _count(tree.target, box) > worth:
        around = tree.parent[box]
        while around >= 0:
            for slot in range(tree.neighbour.shape[1]):
                other = tree.neighbour[around, slot]
                if other >= 0 and other != around and _just_apart(tree, box, other):
                    count = _emit(entries, count, other)
            around = tree.parent[around]
    return count


@compiled
def direct_lists(tree, boxes, worth, coarse):
    """List the boxes whose sources act on some boxes not through a translation.

    Parameters
    ----------
    tree : Octree
    boxes : (n,) int64
        Leaves with targets, or for `coarse` any boxes with targets.
    worth : int
        An expansion stands for more points than that only.
    coarse : bool
        Whether sources act on the boxes' expansions, rather than on their targets.

    Returns
    -------
    begin : (n + 1,) int64
    entries : (begin[-1],) int64
        A box whose sources act, or ``~box`` if its expansion does.
    """
    begin = np.zeros(len(boxes) + 1, np.int64)
    stack = np.empty(8 * (len(tree.first) + 1), np.int64)
    buffer = np.empty(1024, np.int64)
    entries = np.empty(0, np.int64)
    for i in range(len(boxes)):
        count = -1
        while count < 0:
            if coarse:
                count = _coarse_of(tree, boxes[i], worth, buffer)
            else:
                count = _near_of(tree, boxes[i], worth, stack, buffer)
            if count > len(buffer):
                buffer = np.empty(2 * count, np.int64)
                count = -1
        begin[i + 1] = begin[i] + count
        if begin[i + 1] > len(entries):
            larger = np.empty(max(2 * begin[i + 1], 1024), np.int64)
            for k in range(begin[i]):
                larger[k] = entries[k]
            entries = larger
        for k in range(count):
            entries[begin[i] + k] = buffer[k]
    return begin, entries[: begin[-1]].copy()
