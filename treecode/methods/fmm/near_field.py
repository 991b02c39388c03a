"""What acts point by point: neighbouring leaves, and cubes of different size through points."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from treecode.kernels.base import Kernel
from treecode.methods.fmm import loops
from treecode.methods.fmm.hierarchy import Hierarchy
from treecode.methods.fmm.level import CLASSES
from treecode.methods.fmm.lists import Lists
from treecode.methods.fmm.octree import Octree
from treecode.threads import Threads

_LEAVES = 64  # that one thread takes at a time
_ROOM = 64  # more than any lanes


class NearField:
    """The direct sums over a tree with its lists and operators, for one set of strengths.

    Attributes
    ----------
    near_pairs, far_pairs : int
        Pairs of a target with a source or a Gauss point, and of a Gauss point with a source, so
        far.
    """

    def __init__(
        self,
        kernel: Kernel,
        tree: Octree,
        lists: Lists,
        operators: Hierarchy,
        sources: np.ndarray,
        weights: np.ndarray,
        threads: Threads,
    ) -> None:
        self._kernel, self._tree, self._lists, self._operators = kernel, tree, lists, operators
        self._sources, self._weights, self._threads = sources, weights, threads
        self.near_pairs = self.far_pairs = 0

    def act_on_smaller(self, local: dict[int, np.ndarray]) -> None:
        """Add what the points of larger leaves do in smaller cubes to local expansions (P2L)."""
        for level, expansions in local.items():
            self._act_on_level(level, expansions)

    def _act_on_level(self, level: int, local: np.ndarray) -> None:
        tree, operators = self._tree, self._operators.levels[level]
        boxes = self._lists.coarse_boxes
        first, stop = np.searchsorted(tree.level[boxes], (level, level + 1))
        begin, entries = self._lists.coarse
        nodes = operators.nodes(tree.half(level))
        padded = np.pad(nodes, ((0, 0), (0, _ROOM)))

        def act(chunk: slice) -> None:
            rows = slice(first + chunk.start, first + chunk.stop)
            out = np.zeros((len(boxes[rows]), self._kernel.value_size, nodes.shape[1]))
            loops.coarse_field(
                self._kernel,
                self._sources,
                self._weights,
                tree.source,
                begin[rows.start : rows.stop + 1],
                entries,
                padded,
                tree.centers(boxes[rows]),
                out,
            )
            coefficients = operators.project(out * operators.value_scale[:, None])
            flat = coefficients.reshape(len(out), -1)
            for c in range(CLASSES):
                members, basis = operators.value_members[c], operators.value_basis[c]
                local[boxes[rows] - tree.first[level], c] += flat[:, members] @ basis

        self._threads(act, stop - first, _LEAVES)
        acting = entries[begin[first] : begin[stop]]
        self.far_pairs += int(nodes.shape[1] * np.diff(tree.source)[acting].sum())

    def sum_neighbours(
        self,
        multipole: dict[int, np.ndarray],
        targets: np.ndarray,
        order: np.ndarray,
        values: np.ndarray,
        meanwhile: Callable[[], None],
    ) -> None:
        """Add neighbours point by point, and smaller cubes by their proxies (P2P, M2P).

        `meanwhile` is called now and then.
        """
        tree, leaves, proxy_boxes = self._tree, self._lists.target_leaves, self._lists.proxy_boxes
        nodes, node_weights = self._proxies(multipole)
        slot = np.full(len(tree.level), -1)
        slot[proxy_boxes] = np.arange(len(proxy_boxes))
        begin, entries = self._lists.near
        pairs = np.zeros(len(leaves), np.int64)
        like = np.empty(0, self._operators.dtype)

        def sum_leaves(chunk: slice) -> None:
            boxes = leaves[chunk]
            loops.near_field(
                self._kernel,
                self._sources,
                self._weights,
                tree.source,
                nodes,
                node_weights,
                tree.centers(proxy_boxes),
                slot,
                begin[chunk.start : chunk.stop + 1],
                entries,
                targets,
                tree.target[boxes],
                tree.centers(boxes),
                order,
                like,
                values,
                pairs[chunk],
            )
            meanwhile()

        self._threads(sum_leaves, len(leaves), _LEAVES, progress=True)
        self.near_pairs += int(pairs.sum())

    def _proxies(self, multipole: dict[int, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """Return points, seen from the centres, and weights that stand for expansions of cubes."""
        tree, boxes, size = self._tree, self._lists.proxy_boxes, self._kernel.weight_size
        levels = np.unique(tree.level[boxes]).tolist()
        most = max((self._operators.levels[level].degree for level in levels), default=0) ** 3
        points = np.zeros((len(boxes), 3, most))
        weights = np.zeros((len(boxes), size, most))
        for level in levels:
            operators = self._operators.levels[level]
            rows = np.flatnonzero(tree.level[boxes] == level)
            nodes = operators.nodes(tree.half(level))
            expansions = multipole[level][boxes[rows] - tree.first[level]]
            by_class = expansions.reshape(len(rows), CLASSES, -1)
            coefficients = np.empty((len(rows), size, nodes.shape[1]))
            flat = coefficients.reshape(len(rows), -1)
            for c in range(CLASSES):
                functions = by_class[:, c] @ operators.source_basis[c].T
                flat[:, operators.source_members[c]] = functions
            spread = operators.spread(coefficients * operators.source_scale[:, None])
            points[rows, :, : nodes.shape[1]] = nodes
            weights[rows, :, : nodes.shape[1]] = spread
        return points, weights
