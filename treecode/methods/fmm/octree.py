"""Cubes that are halved in all directions, and who interacts with whom among them."""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol

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
PIECES = 64  # of the boxes of a level, for the threads
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


class Box(NamedTuple):
    """The box around points.

    Attributes
    ----------
    low, high : (3,) float64
    """

    low: np.ndarray
    high: np.ndarray

    @classmethod
    def around(cls, points: np.ndarray) -> Box:
        """Return the box around points, (3, P)."""
        return cls(points.min(axis=1), points.max(axis=1))


class Region(Protocol):
    """The part of a tree that a process has, where others have the rest."""

    box: Box
    """Around the points of all."""

    def straddles(self, level: int, cell: np.ndarray) -> np.ndarray:
        """Tell of which boxes of a level, with cells (n, 3), others have points as well."""

    def most(self, fullest: int, in_full: int, count: int) -> tuple[int, int, int]:
        """Return the most of all, and the totals of two numbers."""


def root_widths(box: Box) -> list[float]:
    """Return eight sides of a root around a box, from the least to almost twice that.

    They are 8, 9, ... or 15 times a power of two, so that a side stays the same while points move
    a little, and centres can be exact.
    """
    extent = 2.0 * float((0.5 * box.high - 0.5 * box.low).max())
    # Room for the outermost points, which rounding may put outside.
    least = max(extent * (1.0 + 2.0**-40) + 2.0 * _spacing(box, extent), 1e-280)
    unit = math.ldexp(1.0, math.frexp(least)[1] - 4)
    widths = [m * unit for m in (*range(8, 16), *range(16, 32, 2))]
    return [width for width in widths if width >= least][:8]


def _spacing(box: Box, width: float) -> float:
    """Return a power of two of which all doubles are multiples that may be a root's coordinates."""
    return float(np.spacing(np.abs(box).max() + width))


def root_corner(box: Box, width: float) -> tuple[np.ndarray, int]:
    """Return the lowest corner of a root around a box, and how many levels it may have.

    Centres are exact: at 48 levels they were off by a hundredth of a cube, and errors of 1e-8
    became 6e-4. So the corner, and halves of the finest sides, are multiples of one unit.
    """
    spacing = max(_spacing(box, width), _LEAST)
    levels = math.frexp(width)[1] - math.frexp(spacing)[1] - 4
    corner = np.rint((0.5 * box.low + 0.5 * box.high - 0.5 * width) / spacing) * spacing
    return corner, min(_MAX_LEVEL, max(0, levels))


def build_octree(
    points: np.ndarray,
    sources: int | None,
    leaf_size: int,
    width: float,
    threads: Threads,
    region: Region | None = None,
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
    region : Region, optional
        If these are not all points: boxes that others have points in are split, too.

    Returns
    -------
    Octree
    source_order, target_order : (N,) and (M,) int64
        ``sources_in_tree_order = sources[source_order]``; the same array if all points are both.
    """
    count = points.shape[1]
    order = np.arange(count)
    corner, levels = root_corner(region.box if region else Box.around(points), width)
    split = count if sources is None else sources
    table, cell = _split(points, order, split, corner, width, leaf_size, levels, threads, region)
    level, parent, octant, start, stop = table
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
    tree = assemble(corner, width, cell, level, parent, octant, source, target)
    return tree, *orders


def assemble(
    corner: np.ndarray,
    width: float,
    cell: np.ndarray,
    level: np.ndarray,
    parent: np.ndarray,
    octant: np.ndarray,
    source: np.ndarray,
    target: np.ndarray,
) -> Octree:
    """Return the tree of boxes, which are level by level, the children of one in a row."""
    first = np.searchsorted(level, np.arange(level[-1] + 2))
    child = np.full((len(level), OCTANTS), -1)
    child[parent[1:], octant[1:]] = np.arange(1, len(level))
    neighbour = np.full((len(level), _NEIGHBOURS), -1)
    neighbour[0, _SELF] = 0
    _meet(parent, octant, child, neighbour)
    leaf = np.all(child < 0, axis=1)
    return Octree(
        corner, width, cell, level, parent, octant, child, leaf, source, target, neighbour, first
    )


def _split(
    points: np.ndarray,
    order: np.ndarray,
    split: int,
    low: np.ndarray,
    width: float,
    leaf_size: int,
    levels: int,
    threads: Threads,
    region: Region | None,
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
        too_full = full > leaf_size
        forced = np.zeros(len(full), bool) if region is None else region.straddles(level, cells[-1])
        fullest = 3 * leaf_size if forced.any() else int(full.max(initial=0))
        amounts = fullest, int(size[too_full].sum()), count
        fullest, in_full, all_ = amounts if region is None else region.most(*amounts)
        if fullest <= 2 * leaf_size and in_full <= _FEW * all_:
            break
        boxes = np.flatnonzero(too_full | forced)
        middle = low + (cells[-1][boxes] + 0.5) * (width * 0.5**level)
        begin = np.empty((len(boxes), OCTANTS + 1), np.int64)
        begin[:, 0], begin[:, -1] = start[boxes], stop[boxes]

        some = middle, begin, forced[boxes]

        def sort(chunk: slice, some: tuple[np.ndarray, ...] = some) -> None:
            _sort(points, order, *(each[chunk] for each in some))

        threads(sort, len(boxes), 1 + len(boxes) // PIECES)
        place, octant = np.nonzero(np.diff(begin))
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
def _sort(points, order, middle, begin, forced):
    """Sort the points of some boxes by octant, and write where each begins.

    Octant o of box b is to go from ``begin[b, o]`` to ``begin[b, o + 1]``; the first and the last
    are known. If all points of a box are one, all its octants are empty unless it is `forced`.
    """
    for box in range(len(begin)):
        start, stop = begin[box, 0], begin[box, OCTANTS]
        if not forced[box] and _coincide(points, start, stop):
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
