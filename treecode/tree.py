"""Hierarchical clusters of points in rectangular boxes (K section 6, T section 5)."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from treecode._jit import compiled, inlined

OCTANTS = 8


class Tree(NamedTuple):
    """Clusters in breadth-first order: parents before children, the children of one in a row.

    Attributes
    ----------
    center, half : (3, C) float64
        Centre and half sides of each box.
    radius : (C,) float64
        Half the diagonal of the box.
    start, stop : (C,) int64
        Range of the cluster's points in tree order.
    child, children : (C,) int64
        First child and number of children; a leaf has none.
    level : (C,) int64
        Depth, 0 at the root.
    """

    center: np.ndarray
    half: np.ndarray
    radius: np.ndarray
    start: np.ndarray
    stop: np.ndarray
    child: np.ndarray
    children: np.ndarray
    level: np.ndarray

    @property
    def depth(self) -> int:
        """Levels below the root."""
        return int(self.level[-1]) if len(self.level) else 0


def build_tree(points: np.ndarray, leaf_size: int, shrink: bool) -> tuple[Tree, np.ndarray]:
    """Sort `points` into a tree of boxes, in place.

    The root is the smallest box around the points. A box is bisected in each direction whose side
    is longer than its longest side over sqrt(2), into 8, 4 or 2 children, until it holds at
    most `leaf_size` points (K section 6). Empty children are dropped. A box all of whose points
    lie in one child is replaced by that child, so the number of clusters is less than twice the
    number of leaves however the points are spread. Coincident points stay in one leaf.

    Parameters
    ----------
    points : (3, N) float64
        Coordinates; permuted to tree order.
    leaf_size : int
        Most points in a leaf.
    shrink : bool
        Shrink every box to its points (T section 6.1.1) rather than keep the bisected box.

    Returns
    -------
    Tree
    order : (N,) int64
        ``points_after[:, i] = points_before[:, order[i]]``.
    """
    order = np.arange(points.shape[1])
    boxes, ranges = _build(points, order, leaf_size, shrink)
    low, high = boxes[:, :3].T, boxes[:, 3:].T
    half = np.ascontiguousarray(0.5 * (high - low))
    tree = Tree(
        np.ascontiguousarray(low + half),
        half,
        np.sqrt((half * half).sum(axis=0)),
        *(np.ascontiguousarray(column) for column in ranges.T),
    )
    return tree, order


@inlined
def _bound(points, start, stop, box):
    """Write the smallest box around ``points[:, start:stop]`` to `box`: low corner, high corner."""
    for d in range(3):
        low = high = points[d, start]
        for i in range(start + 1, stop):
            low = min(low, points[d, i])
            high = max(high, points[d, i])
        box[d] = low
        box[3 + d] = high


@inlined
def _middles(box, middle):
    """Bisect the long sides: write their midpoints to `middle`, infinity for the short ones."""
    longest = max(box[3] - box[0], box[4] - box[1], box[5] - box[2])
    for d in range(3):
        low, high = box[d], box[3 + d]
        middle[d] = math.inf
        # The longest side by name: times sqrt(1/2), the smallest double rounds to itself.
        if high - low == longest or high - low > longest * math.sqrt(0.5):
            middle[d] = low + 0.5 * (high - low)
            if middle[d] >= high:  # neighbouring floating point numbers: keep them apart
                middle[d] = low


@inlined
def octant_of(points, i, middle):
    return (
        (points[0, i] > middle[0]) + 2 * (points[1, i] > middle[1]) + 4 * (points[2, i] > middle[2])
    )


@inlined
def _enter(box, middle, octant):
    """Replace `box` by its child number `octant`."""
    for d in range(3):
        if middle[d] < math.inf:
            if octant >> d & 1:  # of neighbouring numbers only the upper one is above the middle
                box[d] = middle[d] if middle[d] > box[d] else box[3 + d]
            else:
                box[3 + d] = middle[d]


@inlined
def count_octants(points, start, stop, middle, count):
    """Write `start` and how many of ``points[:, start:stop]`` lie in each octant."""
    count[0] = start
    for octant in range(OCTANTS):
        count[octant + 1] = 0
    for i in range(start, stop):
        count[octant_of(points, i, middle) + 1] += 1


@inlined
def sort_octants(points, order, middle, begin):
    """Sort points by octant, in place, as counted; octant o goes to ``begin[o]:begin[o + 1]``."""
    for octant in range(OCTANTS):
        begin[octant + 1] += begin[octant]
    cursor = np.empty_like(begin)
    for octant in range(len(begin)):
        cursor[octant] = begin[octant]
    for octant in range(OCTANTS):
        i = cursor[octant]
        while i < begin[octant + 1]:
            home = octant_of(points, i, middle)
            if home == octant:
                i += 1
            else:
                k = cursor[home]
                cursor[home] += 1
                for d in range(3):
                    points[d, i], points[d, k] = points[d, k], points[d, i]
                order[i], order[k] = order[k], order[i]
            cursor[octant] = i


# Copies are loops in the compiled functions: slices and np.concatenate cost seconds to compile.
@inlined
def resized(array, used, capacity):
    """Copy the first `used` rows to a larger array of zeros."""
    larger = np.zeros((capacity, array.shape[1]), array.dtype)
    for i in range(used):
        for k in range(array.shape[1]):
            larger[i, k] = array[i, k]
    return larger


@compiled
def _build(points, order, leaf_size, shrink):
    """Return boxes (C, 6) and ranges (C, 5): start, stop, child, children, level."""
    n = points.shape[1]
    capacity = 64
    boxes = np.zeros((capacity, 6))
    ranges = np.zeros((capacity, 5), np.int64)
    if n == 0:
        return boxes[:0], ranges[:0]
    middle = np.empty(3)
    tight = np.empty(6)
    begin = np.empty(OCTANTS + 1, np.int64)
    _bound(points, 0, n, boxes[0])
    ranges[0, 1] = n
    count = 1
    cluster = 0
    while cluster < count:
        start, stop = ranges[cluster, 0], ranges[cluster, 1]
        box = boxes[cluster]
        _bound(points, start, stop, tight)
        if shrink:
            for d in range(6):
                box[d] = tight[d]
        one_point = tight[0] == tight[3] and tight[1] == tight[4] and tight[2] == tight[5]
        if stop - start > leaf_size and not one_point:
            occupied = 1
            while occupied == 1:  # enter the only child that holds points
                _middles(box, middle)
                count_octants(points, start, stop, middle, begin)
                occupied = 0
                only = 0
                for octant in range(OCTANTS):
                    if begin[octant + 1] > 0:
                        occupied += 1
                        only = octant
                if occupied == 1:
                    _enter(box, middle, only)
            sort_octants(points, order, middle, begin)
            if count + OCTANTS > capacity:
                capacity *= 2
                boxes = resized(boxes, count, capacity)
                ranges = resized(ranges, count, capacity)
            ranges[cluster, 2] = count
            for octant in range(OCTANTS):
                if begin[octant + 1] > begin[octant]:
                    for d in range(6):
                        boxes[count, d] = box[d]
                    _enter(boxes[count], middle, octant)
                    ranges[count, 0] = begin[octant]
                    ranges[count, 1] = begin[octant + 1]
                    ranges[count, 4] = ranges[cluster, 4] + 1
                    count += 1
            ranges[cluster, 3] = count - ranges[cluster, 2]
        cluster += 1
    return boxes[:count], ranges[:count]
