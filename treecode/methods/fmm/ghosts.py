"""What a rank needs of others to sum at its own targets: cubes near its piece, points in some.

A cube acts on others within the neighbourhood of its parent only, the 27 cubes of the parent's size
around it: directly, by a translation, or as points that stand for it. So a rank is given the cubes
of others whose parents' neighbourhoods reach into its piece, and the points of the leaves whose own
neighbourhoods do. With its own cubes, and those that several ranks share, they are its tree.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from treecode.methods.fmm.curve import Pieces, Shared
from treecode.methods.fmm.octree import Octree, assemble
from treecode.ranks import OneRank

_UNKNOWN = np.array([0, 1 << 62])  # the sources of cubes of others: more than any expansion's terms
_LEVEL, _PARENT, _OCTANT, _LEAF, _POINTS = range(5)  # of a cube in a message
_BITS = np.arange(3)


class Essential(NamedTuple):
    """The tree of a rank, and what it gives and gets.

    Attributes
    ----------
    tree : Octree
        Ranges of sources are those of own ones, with those of others behind.
    expands : (B,) bool
        Cubes to whose expansions own sources contribute.
    shared : (S,) int64
        Cubes of which each rank has a part of the expansion.
    given_boxes, got_boxes : lists of int64 arrays
        Cubes for and of each rank.
    given_points : int64 array
        Own sources, in tree order, for one rank after the other,
    sent_points, got_points : lists of int
        so many for each, and so many of each.
    points : (3, G) float64
        These sources.
    """

    tree: Octree
    expands: np.ndarray
    shared: np.ndarray
    given_boxes: list[np.ndarray]
    got_boxes: list[np.ndarray]
    given_points: np.ndarray
    sent_points: list[int]
    got_points: list[int]
    points: np.ndarray


def essential(tree: Octree, sources: np.ndarray, pieces: Pieces, ranks: OneRank) -> Essential:
    """Return what a rank needs, and what others need of it.

    Parameters
    ----------
    tree : Octree
        Of its own points.
    sources : (3, N) float64
        In tree order.
    pieces : Pieces
    ranks : OneRank
    """
    alone = ~np.concatenate(
        [
            pieces.straddles(level, tree.cell[tree.first[level] : tree.first[level + 1]])
            for level in range(tree.depth + 1)
        ]
    )
    count = np.diff(tree.source)[:, 0]
    reach = _reach(tree, pieces, ranks)
    shared = pieces.shared()
    match = _matched(tree, shared)
    messages, boxes, points = [], [], []
    for rank in range(ranks.size):
        near = reach[reach[:, 1] == rank, 0]
        children = tree.child[near]
        given = np.sort(children[children >= 0])
        given = given[alone[given] & (count[given] > 0)]
        leaves = near[alone[near] & tree.leaf[near] & (count[near] > 0)]
        boxes.append(given)
        points.append(_ranges(tree.source[leaves]))
        messages.append(_message(tree, given, leaves, match))
    got, numbers = ranks.deliver(np.concatenate(messages), list(map(len, messages)))
    given, sent = np.concatenate(points), list(map(len, points))
    ghosts, got_points = ranks.deliver(np.take(sources, given, axis=1).T, sent)
    merged, new = _merged(tree, alone, shared, match, got, numbers, sources.shape[1])
    own = len(tree.level)
    of_shared = np.where(match >= 0, match, own - 1 + np.cumsum(match < 0))
    ends = np.cumsum([own + np.count_nonzero(match < 0), *numbers])
    expands = np.zeros(len(merged.level), bool)
    expands[new[:own]] = count > 0
    return Essential(
        merged,
        expands,
        new[of_shared],
        [new[some] for some in boxes],
        [new[first:stop] for first, stop in pairwise(ends)],
        given,
        sent,
        got_points,
        np.ascontiguousarray(ghosts.T),
    )


def _reach(tree: Octree, pieces: Pieces, ranks: OneRank) -> np.ndarray:
    """Return pairs of a cube and another rank into whose piece its neighbourhood reaches, (n, 2).

    They are in the order of cubes. The neighbourhood of a cube is within its parent's.
    """
    boxes = np.zeros(1, np.int64)
    pairs = [np.zeros((0, 2), np.int64)]
    for level in range(tree.depth + 1):
        first, last = pieces.around(level, tree.cell[boxes])
        row, column = np.nonzero((first != ranks.rank) | (last != ranks.rank))
        low, number = first[row, column], (last - first + 1)[row, column]
        rank = np.repeat(low + number - number.cumsum(), number) + np.arange(number.sum())
        code = np.unique(np.repeat(boxes[row], number) * ranks.size + rank)
        found = np.stack([code // ranks.size, code % ranks.size], axis=1)
        pairs.append(found[found[:, 1] != ranks.rank])
        children = tree.child[np.unique(pairs[-1][:, 0])]
        boxes = np.sort(children[children >= 0])
    return np.concatenate(pairs)


def _ranges(ranges: np.ndarray) -> np.ndarray:
    """Return the numbers in some ranges, (n, 2), one after the other."""
    number = ranges[:, 1] - ranges[:, 0]
    return np.repeat(ranges[:, 1] - number.cumsum(), number) + np.arange(number.sum())


def _matched(tree: Octree, shared: Shared) -> np.ndarray:
    """Return which cube of a tree each shared one is, -1 if it has no points there."""
    match = np.zeros(len(shared.level), np.int64)
    for i in range(1, len(match)):
        above = match[shared.parent[i]]
        octant = int((shared.cell[i] & 1) @ (1 << _BITS))
        match[i] = tree.child[above, octant] if above >= 0 else -1
    return match


def _message(tree: Octree, boxes: np.ndarray, leaves: np.ndarray, match: np.ndarray) -> np.ndarray:
    """Return cubes as another rank can read them, (n, 5) int64.

    A parent is a place in the message, or the number of a shared cube, as ``~number``.
    """
    place = np.full(len(tree.level), -1)
    local = np.flatnonzero(match >= 0)
    place[match[local]] = ~local
    place[boxes] = np.arange(len(boxes))
    points = np.full(len(tree.level), -1)
    points[leaves] = np.diff(tree.source[leaves])[:, 0]
    columns = tree.level, place[tree.parent], tree.octant, tree.leaf, points
    return np.stack([column[boxes] for column in columns], axis=1).astype(np.int64)


def _merged(
    tree: Octree,
    alone: np.ndarray,
    shared: Shared,
    match: np.ndarray,
    others: np.ndarray,
    numbers: list[int],
    sources: int,
) -> tuple[Octree, np.ndarray]:
    """Return a tree of own cubes, shared ones and those of others, and the place of each in it."""
    own, missing = len(tree.level), np.flatnonzero(match < 0)
    of_shared = match.copy()
    of_shared[missing] = own + np.arange(len(missing))
    above = others[:, _PARENT]
    begin = own + len(missing) + np.repeat(np.cumsum([0, *numbers[:-1]]), numbers)
    above = np.where(above >= 0, begin + above, of_shared[~np.minimum(above, -1)])
    parent = np.concatenate([tree.parent, of_shared[shared.parent[missing]], above])
    octants = (shared.cell[missing] & 1) @ (1 << _BITS)
    level = np.concatenate([tree.level, shared.level[missing], others[:, _LEVEL]])
    octant = np.concatenate([tree.octant, octants, others[:, _OCTANT]])
    points = others[:, _POINTS]
    known = points >= 0
    stop = sources + np.where(known, points, 0).cumsum()
    ranges = np.stack([stop - points, stop], axis=1)
    unknown = np.broadcast_to(_UNKNOWN, (len(missing), 2))
    source = np.concatenate(
        [
            np.where(alone[:, None], tree.source, _UNKNOWN),
            unknown,
            np.where(known[:, None], ranges, _UNKNOWN),
        ]
    )
    target = np.concatenate([tree.target, np.zeros((len(source) - own, 2), np.int64)])
    none = np.zeros(len(missing), bool)
    leaf = np.concatenate([tree.leaf & alone, none, others[:, _LEAF] > 0])
    return _in_levels(tree, level, parent, octant, source, target, leaf)


def _in_levels(
    tree: Octree,
    level: np.ndarray,
    parent: np.ndarray,
    octant: np.ndarray,
    source: np.ndarray,
    target: np.ndarray,
    leaf: np.ndarray,
) -> tuple[Octree, np.ndarray]:
    """Return a tree of cubes that are in any order, and the place of each in it."""
    new, order = np.zeros(len(level), np.int64), np.zeros(len(level), np.int64)
    cell = np.zeros((len(level), 3), np.int64)
    stop = 1
    for depth in range(1, int(level.max()) + 1):
        boxes = np.flatnonzero(level == depth)
        above = new[parent[boxes]]
        place = np.argsort(8 * above + octant[boxes])
        boxes, above = boxes[place], above[place]
        rows = slice(stop, stop + len(boxes))
        order[rows], new[boxes] = boxes, np.arange(rows.start, rows.stop)
        cell[rows] = 2 * cell[above] + (octant[boxes, None] >> _BITS & 1)
        stop = rows.stop
    above = np.append(-1, new[parent[order[1:]]])
    columns = level[order], above, octant[order], source[order], target[order]
    merged = assemble(tree.low, tree.width, cell, *columns)
    return merged._replace(leaf=leaf[order]), new
