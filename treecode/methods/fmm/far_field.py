"""The far field, pass by pass: up the tree, across it, and down.

The multipole expansion of a cube stands for its sources as seen from far away, its local expansion
for the values that far sources make in it. Those of a level are one array each.
"""

from __future__ import annotations

import numpy as np

from treecode.methods.fmm import loops
from treecode.methods.fmm.hierarchy import ALL_OFFSETS, Hierarchy
from treecode.methods.fmm.level import CLASSES
from treecode.methods.fmm.lists import Lists
from treecode.methods.fmm.octree import Octree
from treecode.threads import Threads

_CHUNK = 256  # cubes that one thread takes at a time

Expansions = dict[int, np.ndarray]  # by level


class FarField:
    """The passes over a tree with its lists and operators, for one set of strengths.

    Attributes
    ----------
    pairs : int
        Cubes with translations so far.
    """

    def __init__(self, tree: Octree, lists: Lists, operators: Hierarchy, threads: Threads) -> None:
        self._tree, self._lists, self._operators = tree, lists, operators
        self._threads = threads
        self._levels = range(operators.first, tree.depth + 1)
        self.pairs = 0

    def upward(self, sources: np.ndarray, weights: np.ndarray) -> Expansions:
        """Return multipole expansions, (cubes, 8 * rank) with a row of zeros behind (P2M, M2M)."""
        tree, operators = self._tree, self._operators
        multipole: Expansions = {}
        for level in reversed(self._levels):
            count = tree.first[level + 1] - tree.first[level]
            size = CLASSES * operators.levels[level].rank
            multipole[level] = np.zeros((count + 1, size), operators.dtype)
            self._expand_leaves(level, sources, weights, multipole[level])
            if level < tree.depth:
                self._merge_children(level, multipole)
        return multipole

    def _expand_leaves(
        self, level: int, sources: np.ndarray, weights: np.ndarray, multipole: np.ndarray
    ) -> None:
        """Expand the sources in the leaves of one level (P2M)."""
        tree, operators, dtype = self._tree, self._operators.levels[level], self._operators.dtype
        first, n = tree.first[level], operators.degree
        leaves = self._lists.source_leaves[tree.level[self._lists.source_leaves] == level]
        basis = operators.source_bases(dtype)
        by_class = multipole.reshape(len(multipole), CLASSES, -1)

        def expand(chunk: slice) -> None:
            boxes = leaves[chunk]
            out = np.empty((len(boxes), len(weights), n, n * n), dtype)
            loops.expand_points(
                sources, weights, tree.source[boxes], tree.centers(boxes), tree.half(level), out
            )
            flat = out.reshape(len(boxes), -1)
            for c in range(CLASSES):
                by_class[boxes - first, c] = flat[:, operators.source_members[c]] @ basis[c]

        self._threads(expand, len(leaves), _CHUNK)

    def _merge_children(self, level: int, multipole: Expansions) -> None:
        """Add the multipole expansions of children to those of their parents (M2M)."""
        parents, child = self._parents(level, self._lists.has_sources)
        up = self._operators.transfers[level + 1].up

        def merge(chunk: slice) -> None:
            for octant in range(8):
                some = parents[chunk][child[parents[chunk], octant] >= 0]
                rows = child[some, octant] - self._tree.first[level + 1]
                multipole[level][some] += multipole[level + 1][rows] @ up[octant]

        self._threads(merge, len(parents), _CHUNK)

    def translate(self, multipole: Expansions) -> Expansions:
        """Return local expansions of the same level, (cubes, 8, rank) (M2L)."""
        local = {}
        for level in self._levels:
            shape = len(multipole[level]) - 1, CLASSES, self._operators.levels[level].rank
            local[level] = np.zeros(shape, self._operators.dtype)
            self._translate_level(level, multipole[level], local[level])
        return local

    def _translate_level(self, level: int, multipole: np.ndarray, local: np.ndarray) -> None:
        operators = self._operators.levels[level]
        boxes = self._lists.boxes_with_targets(self._tree, level)
        pairs = np.zeros(len(boxes), np.int64)

        def translate(chunk: slice) -> None:
            loops.translate(
                self._tree,
                boxes[chunk],
                ALL_OFFSETS,
                operators.matrices,
                operators.begin,
                operators.used,
                multipole,
                local,
                pairs[chunk],
            )

        self._threads(translate, len(boxes), _CHUNK)
        self.pairs += int(pairs.sum())

    def downward(self, local: Expansions) -> None:
        """Pass local expansions on from parents to children (L2L)."""
        for level in self._levels[:-1]:
            self._pass_on(level, local)

    def _pass_on(self, level: int, local: Expansions) -> None:
        parents, child = self._parents(level, self._lists.has_targets)
        down = self._operators.transfers[level + 1].down
        above = local[level].reshape(len(local[level]), -1)
        below = local[level + 1].reshape(len(local[level + 1]), -1)

        def split(chunk: slice) -> None:
            for octant in range(8):
                some = parents[chunk][child[parents[chunk], octant] >= 0]
                rows = child[some, octant] - self._tree.first[level + 1]
                below[rows] += above[some] @ down[octant]

        self._threads(split, len(parents), _CHUNK)

    def _parents(self, level: int, wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the wanted cubes of a level that have children, and the children of all cubes."""
        rows = slice(*self._tree.first[level : level + 2])
        child = self._tree.child[rows]
        return np.flatnonzero((child >= 0).any(axis=1) & wanted[rows]), child

    def evaluate(
        self, local: Expansions, targets: np.ndarray, order: np.ndarray, values: np.ndarray
    ) -> None:
        """Add the local expansions of leaves to the `values` at their targets (L2P)."""
        for level in self._levels:
            self._evaluate_leaves(level, local[level], targets, order, values)

    def _evaluate_leaves(
        self,
        level: int,
        local: np.ndarray,
        targets: np.ndarray,
        order: np.ndarray,
        values: np.ndarray,
    ) -> None:
        tree, operators, dtype = self._tree, self._operators.levels[level], self._operators.dtype
        first, n = tree.first[level], operators.degree
        leaves = self._lists.target_leaves[tree.level[self._lists.target_leaves] == level]
        basis = operators.value_bases(dtype)

        def evaluate(chunk: slice) -> None:
            boxes = leaves[chunk]
            flat = np.empty((len(boxes), values.shape[1] * n**3), dtype)
            for c in range(CLASSES):
                flat[:, operators.value_members[c]] = local[boxes - first, c] @ basis[c].T
            loops.evaluate_points(
                flat.reshape(len(boxes), -1, n, n * n),
                targets,
                tree.target[boxes],
                tree.centers(boxes),
                tree.half(level),
                order,
                values,
            )

        self._threads(evaluate, len(leaves), _CHUNK)
