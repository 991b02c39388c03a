"""The fast multipole method: cubes act on cubes, up and down an octree."""

from __future__ import annotations

import math
import threading
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from threadpoolctl import ThreadpoolController

from treecode._jit import free_at_fork
from treecode.fmm import passes
from treecode.fmm.octree import Octree, build_octree, direct_lists, root_widths
from treecode.fmm.operators import CLASSES, OFFSETS, Level, Transfer, make_transfer
from treecode.fmm.store import get_level
from treecode.fmm.symmetry import scale_powers
from treecode.kernels.base import MEMBERS, Kernel
from treecode.memory import memory_limit
from treecode.threads import Threads
from treecode.timing import Seconds
from treecode.traversal import load_weights

MIN_DEGREE = 1
KERNEL_MEMBERS = MEMBERS

# An operator's error in the mean square as part of the tolerance: strengths that cancel, and
# points that crowd in corners of cubes, make more of it.
_SAFETY = 0.4
SINGLE = 3e-6  # tolerance from which single precision serves, if it does for the kernel
_MEMORY = 0.5  # part of the machine's memory that operators may take
_BUILDING = 4  # operators as large as this many others are in memory when some are built
_FIRST = 2  # the coarsest level with cubes that do not touch
_DIRECT = 16  # leaves
_CHUNK = 256  # cubes that one thread takes at a time
_LEAVES = 64  # of these, where points meet points
_SAMPLE = 40_000  # points from which the side of the root is chosen,
_PER_LEAF = 8  # more if fewer than so many would be left in a leaf
_ROOM = 64  # more than any lanes
_OFFSETS = np.array(OFFSETS)


class Work(NamedTuple):
    """What a sum takes.

    Attributes
    ----------
    amounts : list of float
        Near pairs, what cubes are worth in near pairs, points, and points times what an expansion
        takes for each, in proportion to the third power of the digits.
    sizes : int
        Of cubes, each with operators of its own unless one serves all.
    """

    amounts: list[float]
    sizes: int


class Multipole:
    """A sum by the fast multipole method; see `treecode.Plan`.

    A level is served by compressed operators (`operators.Level`). `outer` holds the expansions of
    the sources in each cube, `inner` those of what far sources do in it.
    """

    def __init__(
        self,
        kernel: Kernel,
        tolerance: float,
        degree: int | None = None,
        leaf_size: int | None = None,
        progress: bool = False,
        width: float = 0.0,
    ) -> None:
        self.kernel, self.tolerance, self.degree, self.width = kernel, tolerance, degree, width
        self._progress = progress
        self._dtype: Any = np.float64
        single = precision_for(tolerance) == "float32"
        self._box_cost = _box_cost(kernel, _SAFETY * tolerance, single)
        self.leaf_size = leaf_size or int(2.0 * math.sqrt(self._box_cost / 27.0))
        # Below this many points no cube is worth its translations.
        self._direct = 0 if leaf_size else int(_DIRECT * self.leaf_size)
        self._work = math.inf, math.inf, 0
        self._served: tuple[int, list[float]] = 0, []
        self._levels: dict[int, Level] = {}
        self._transfers: dict[int, Transfer] = {}
        self._pairs = np.zeros(2, np.int64)
        self._done = False

    def set_points(self, sources: np.ndarray, targets: np.ndarray | None) -> None:
        """Sort the points, (3, N) and (3, M), and find who acts on whom; the arrays are kept."""
        self.seconds = Seconds()
        self._done = False
        same = targets is None
        points = sources if targets is None else np.concatenate([sources, targets], axis=1)
        self.sources, self.targets = sources, sources if targets is None else targets
        self.source_order = np.arange(self.sources.shape[1])
        self.target_order = np.arange(self.targets.shape[1])
        self._tree: Octree | None = None
        if not (self.sources.size and self.targets.size):
            return
        with self.seconds.stage("tree"), Threads() as threads:
            split = None if same else sources.shape[1]
            self._choose_width(points, split, threads)
            few = points.shape[1] <= self._direct
            leaf_size = points.shape[1] if few else self.leaf_size
            self._tree, self.source_order, self.target_order = build_octree(
                points, split, leaf_size, self.width, threads
            )
            if same:
                self.sources = self.targets = points
            else:
                self.sources = np.ascontiguousarray(sources[:, self.source_order])
                self.targets = np.ascontiguousarray(self.targets[:, self.target_order])
            self._find_neighbours(self._tree, threads)
        with self.seconds.stage("operators"):
            self._get_operators(self._tree)

    def work(self, sources: np.ndarray, targets: np.ndarray | None) -> Work:
        """Return what a sum over such points takes, as a sample tells; nothing is built."""
        points = sources if targets is None else np.concatenate([sources, targets], axis=1)
        with Threads() as threads:
            self._choose_width(points, None if targets is None else sources.shape[1], threads)
        pairs, cubes, sizes = self._work
        if points.shape[1] <= self._direct:
            m = sources.shape[1] if targets is None else targets.shape[1]
            pairs, cubes, sizes = sources.shape[1] * m, 0.0, 0
        # Points that are sources and targets are expanded, and expansions evaluated there.
        count = points.shape[1] * (2 if targets is None else 1)
        return Work([pairs, cubes, count, -count * math.log10(self.tolerance) ** 3], sizes)

    def execute(self, strengths: np.ndarray) -> np.ndarray:
        """Return the sum, (M, value_size), of strengths (N, strength_size)."""
        return self.run(strengths)[0]

    def run(self, strengths: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the sum, and the linear weights, (weight_size, N), in the order of `sources`."""
        weights = np.empty((self.kernel.weight_size, len(strengths)))
        values = np.zeros((self.targets.shape[1], self.kernel.value_size))
        self._pairs[:] = 0
        self._done = True
        if self._tree is None:
            return values, weights
        with _blas_of_one_thread, Threads(self._progress) as threads:
            with self.seconds.stage("weights"):
                load_weights(self.kernel, strengths, self.source_order, weights, threads)
                # A power of two: singles hold nothing below 1e-38, nor above 1e38.
                unit = math.ldexp(0.5, math.frexp(max(weights.max(), -weights.min()))[1])
                weights /= unit
            with self.seconds.stage("upward"):
                outer = self._upward(self._tree, weights, threads)
            with self.seconds.stage("translations"):
                inner = self._across(self._tree, outer, threads)
                self._across_sizes(self._tree, inner, weights, threads)
            with self.seconds.stage("downward"):
                self._downward(self._tree, inner, threads)
            with self.seconds.stage("near"):
                self._near_field(self._tree, outer, weights, values, threads)
            with self.seconds.stage("far"):
                self._evaluate(self._tree, inner, values, threads)
                values *= unit
        return values, weights * unit

    @property
    def effort(self) -> float:
        """What the last sum took, in near pairs."""
        cubes = 0 if self._tree is None else len(self._tree.level)
        return float(self._pairs[0] + self._box_cost * cubes)

    def info(self) -> dict[str, Any]:
        """Return parameters, the size of the tree, pairs of the last sum and bytes held."""
        near_pairs, far_pairs = map(int, self._pairs) if self._done else (None, None)
        held: list[np.ndarray] = [self.sources, self.source_order]
        if self.targets is not self.sources:
            held += [self.targets, self.target_order]
        depth = boxes = 0
        degrees: set[int] = set()
        if self._tree is not None:
            held += [a for a in self._tree if isinstance(a, np.ndarray)]
            held += [*self._near_lists, *self._coarse_lists]
            for level in self._levels.values():
                held += [a for a in level if isinstance(a, np.ndarray)]
                held += [a for item in level if isinstance(item, tuple) for a in item]
                degrees.add(level.degree)
            held += [array for transfer in self._transfers.values() for array in transfer]
            depth, boxes = self._tree.depth, len(self._tree.level)
        return {
            "tol": self.tolerance,
            "degree": self.degree or max(degrees, default=None),
            "leaf_size": self.leaf_size,
            "precision": np.dtype(self._dtype).name,
            "depth": depth,
            "clusters": boxes,
            "near_pairs": near_pairs,
            "far_pairs": far_pairs,
            # Levels may share their operators.
            "bytes": sum({id(array): array.nbytes for array in held}.values()),
        }

    def _choose_width(self, points: np.ndarray, split: int | None, threads: Threads) -> None:
        """Choose the side of the root, which sets how full the leaves are; keep it if it fits."""
        widths = root_widths(points)
        if widths[0] <= self.width <= widths[-1]:
            return
        every = max(1, min(-(-points.shape[1] // _SAMPLE), self.leaf_size // _PER_LEAF))
        sample = points[:, ::every]
        fewer = None if split is None else -(-split // every)
        # Counts in a sample scatter, and cubes that hardly fit in must not seem to be split.
        leaf_size = self.leaf_size / every
        leaf_size = max(1, round(leaf_size + 0.5 * math.sqrt(leaf_size * (1.0 - 1.0 / every))))

        works: dict[float, tuple[float, float, int]] = {}

        def weigh(chunk: slice) -> None:
            width = widths[chunk.start]
            with Threads(most=1) as alone:
                tree, _, _ = build_octree(sample.copy(), fewer, leaf_size, width, alone)
                leaves = np.flatnonzero(tree.leaf)
                begin, entries = direct_lists(tree, leaves, len(sample.T), False, alone)
            counts = np.append(np.diff(tree.source)[entries, 0], 0)
            near = np.add.reduceat(counts, begin[:-1]) * (np.diff(begin) > 0)
            pairs = float(near @ np.diff(tree.target)[leaves, 0]) * every**2
            cubes = self._box_cost * np.count_nonzero(tree.level >= _FIRST)
            works[width] = pairs, cubes, max(0, tree.depth + 1 - _FIRST)

        threads(weigh, len(widths), 1)
        self.width = min(works, key=lambda width: (sum(works[width][:2]), width))
        self._work = works[self.width]

    def _find_neighbours(self, tree: Octree, threads: Threads) -> None:
        """List what acts directly: leaves on leaves, and cubes on cubes of another size."""
        leaf = tree.leaf
        sources, targets = np.diff(tree.source)[:, 0], np.diff(tree.target)[:, 0]
        self._has_targets = targets > 0
        self._source_leaves = np.flatnonzero(leaf & (sources > 0))
        self._target_leaves = np.flatnonzero(leaf & self._has_targets)
        # Nodes that would stand for an expansion; its degree is known when operators are.
        worth = (self.degree or math.ceil(1.5 * math.log10(1.0 / (_SAFETY * self.tolerance)))) ** 3
        self._near_lists = direct_lists(tree, self._target_leaves, worth, False, threads)
        begin, entries = direct_lists(tree, np.arange(len(tree.level)), worth, True, threads)
        self._coarse_boxes = np.flatnonzero(np.diff(begin))
        self._coarse_lists = np.append(0, np.diff(begin)[self._coarse_boxes].cumsum()), entries
        self._proxy_boxes = np.unique(~self._near_lists[1][self._near_lists[1] < 0])

    def _get_operators(self, tree: Octree) -> None:
        """Get the operators from the first level on that has anything far from anything."""
        between_sizes = np.append(self._coarse_boxes, self._proxy_boxes)
        self._first = int(min(tree.level[between_sizes], default=tree.depth + 1))
        for level in range(_FIRST, self._first):
            boxes = self._boxes_with_targets(tree, level)
            if passes.has_far_sources(tree, boxes, _OFFSETS):
                self._first = level
                break
        halves = [tree.half(level) for level in range(self._first, tree.depth + 1)]
        if (self._first, halves) != self._served:
            self._served = 0, []  # nothing is, if building fails
            self._get_levels(halves)
            self._served = self._first, halves

    def _get_levels(self, halves: list[float]) -> None:
        """Get the operators for cubes of some sizes, each half the one before."""
        single = precision_for(self.tolerance) == "float32" and bool(halves)
        single = single and passes.single_serves(self.kernel, halves[-1], self.tolerance)
        self._dtype = np.float32 if single else np.float64
        powers = scale_powers(self.kernel, halves) if halves else None
        sizes = halves if powers is None else [1.0]  # one serves all
        if sizes:
            self._require_memory(len(sizes))
        levels: dict[float, Level] = {}

        def get(chunk: slice) -> None:
            half = sizes[chunk.start]
            levels[half] = get_level(
                self.kernel, half, _SAFETY * self.tolerance, self.degree, self._dtype
            )

        with _blas_of_one_thread, Threads() as threads:
            threads(get, len(sizes), 1)
        if powers is not None:
            levels = {half: levels[1.0].resized(half, powers) for half in halves}
        self._levels = {self._first + i: levels[half] for i, half in enumerate(halves)}
        self._transfers = {}
        for level in range(self._first + 1, self._first + len(halves)):
            if powers is not None and self._transfers:  # that between any two is the same
                self._transfers[level] = self._transfers[level - 1]
            else:
                self._transfers[level] = make_transfer(self._levels[level], self._levels[level - 1])

    def _require_memory(self, sizes: int) -> None:
        """Refuse operators that do not fit; estimated, as building them can take minutes."""
        allowed = _MEMORY * memory_limit() / (sizes + _BUILDING)
        per_rank2 = 35.0 * np.dtype(self._dtype).itemsize
        if per_rank2 * _rank(self.kernel, _SAFETY * self.tolerance) ** 2 > allowed:
            # Ranks are in proportion to the square of the digits.
            rank = _rank(self.kernel, 0.1)
            digits = math.sqrt(math.sqrt(allowed / per_rank2) / rank)
            raise ValueError(
                f"tol must be at least {10.0**-digits / _SAFETY:.1e} for the operators of cubes of "
                f"{sizes} sizes to fit in memory, got {self.tolerance:g}"
            )

    def _boxes_with_targets(self, tree: Octree, level: int) -> np.ndarray:
        boxes = np.arange(tree.first[level], tree.first[level + 1])
        return boxes[self._has_targets[boxes]]

    def _upward(self, tree: Octree, weights: np.ndarray, threads: Threads) -> dict[int, np.ndarray]:
        """Return the expansions of each level, (cubes, 8 * rank) with a row of zeros behind."""
        outer: dict[int, np.ndarray] = {}
        for level in range(tree.depth, self._first - 1, -1):
            count = tree.first[level + 1] - tree.first[level]
            outer[level] = np.zeros((count + 1, CLASSES * self._levels[level].rank), self._dtype)
            self._expand_leaves(tree, level, weights, outer[level], threads)
            if level < tree.depth:
                self._merge_children(tree, level, outer, threads)
        return outer

    def _expand_leaves(
        self, tree: Octree, level: int, weights: np.ndarray, rows: np.ndarray, threads: Threads
    ) -> None:
        """Expand the sources in the leaves of one level (P2M)."""
        operators, first = self._levels[level], tree.first[level]
        n = operators.degree
        leaves = self._source_leaves[tree.level[self._source_leaves] == level]
        basis = operators.source_bases(self._dtype)
        by_class = rows.reshape(len(rows), CLASSES, -1)

        def expand(chunk: slice) -> None:
            boxes = leaves[chunk]
            out = np.empty((len(boxes), len(weights), n, n * n), self._dtype)
            passes.expand_points(
                self.sources,
                weights,
                tree.source[boxes],
                tree.centers(boxes),
                tree.half(level),
                out,
            )
            flat = out.reshape(len(boxes), -1)
            for c in range(CLASSES):
                by_class[boxes - first, c] = flat[:, operators.source_members[c]] @ basis[c]

        threads(expand, len(leaves), _CHUNK)

    def _merge_children(
        self, tree: Octree, level: int, outer: dict[int, np.ndarray], threads: Threads
    ) -> None:
        """Add the expansions of children to those of their parents (M2M)."""
        child = tree.child[tree.first[level] : tree.first[level + 1]]
        parents = np.flatnonzero((child >= 0).any(axis=1))
        up = self._transfers[level + 1].up

        def merge(chunk: slice) -> None:
            for octant in range(8):
                some = parents[chunk][child[parents[chunk], octant] >= 0]
                rows = child[some, octant] - tree.first[level + 1]
                outer[level][some] += outer[level + 1][rows] @ up[octant]

        threads(merge, len(parents), _CHUNK)

    def _across(
        self, tree: Octree, outer: dict[int, np.ndarray], threads: Threads
    ) -> dict[int, np.ndarray]:
        """Return what cubes do to cubes of the same size, (cubes, 8, rank) each level (M2L)."""
        inner: dict[int, np.ndarray] = {}
        for level, operators in self._levels.items():
            inner[level] = np.zeros((len(outer[level]) - 1, CLASSES, operators.rank), self._dtype)
        for level in sorted(self._levels):
            self._translate(tree, level, outer[level], inner[level], threads)
        return inner

    def _translate(
        self, tree: Octree, level: int, outer: np.ndarray, inner: np.ndarray, threads: Threads
    ) -> None:
        operators = self._levels[level]
        boxes = self._boxes_with_targets(tree, level)

        pairs = np.zeros(len(boxes), np.int64)

        def translate(chunk: slice) -> None:
            passes.translate(
                tree,
                boxes[chunk],
                _OFFSETS,
                operators.matrices,
                operators.begin,
                operators.used,
                outer,
                inner,
                pairs[chunk],
            )

        threads(translate, len(boxes), _CHUNK)
        self._pairs[1] += pairs.sum()

    def _across_sizes(
        self, tree: Octree, inner: dict[int, np.ndarray], weights: np.ndarray, threads: Threads
    ) -> None:
        """Add what the points of larger leaves do in smaller cubes (P2L)."""
        for level in self._levels:
            self._act_on_smaller(tree, level, inner[level], weights, threads)

    def _act_on_smaller(
        self, tree: Octree, level: int, inner: np.ndarray, weights: np.ndarray, threads: Threads
    ) -> None:
        operators = self._levels[level]
        boxes = self._coarse_boxes
        first, stop = np.searchsorted(tree.level[boxes], (level, level + 1))
        begin, entries = self._coarse_lists
        nodes = operators.nodes(tree.half(level))
        padded = np.pad(nodes, ((0, 0), (0, _ROOM)))

        def act(chunk: slice) -> None:
            rows = slice(first + chunk.start, first + chunk.stop)
            out = np.zeros((len(boxes[rows]), self.kernel.value_size, nodes.shape[1]))
            passes.coarse_field(
                self.kernel,
                self.sources,
                weights,
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
                inner[boxes[rows] - tree.first[level], c] += flat[:, members] @ basis

        threads(act, stop - first, _LEAVES)
        acting = entries[begin[first] : begin[stop]]
        self._pairs[1] += nodes.shape[1] * np.diff(tree.source)[acting].sum()

    def _downward(self, tree: Octree, inner: dict[int, np.ndarray], threads: Threads) -> None:
        """Pass expansions on from parents to children (L2L)."""
        for level in range(self._first, tree.depth):
            self._pass_on(tree, level, inner, threads)

    def _pass_on(
        self, tree: Octree, level: int, inner: dict[int, np.ndarray], threads: Threads
    ) -> None:
        child = tree.child[tree.first[level] : tree.first[level + 1]]
        parents = np.flatnonzero((child >= 0).any(axis=1))
        down = self._transfers[level + 1].down
        above = inner[level].reshape(len(inner[level]), -1)
        below = inner[level + 1].reshape(len(inner[level + 1]), -1)

        def split(chunk: slice) -> None:
            for octant in range(8):
                some = parents[chunk][child[parents[chunk], octant] >= 0]
                rows = child[some, octant] - tree.first[level + 1]
                below[rows] += above[some] @ down[octant]

        threads(split, len(parents), _CHUNK)

    def _near_field(
        self,
        tree: Octree,
        outer: dict[int, np.ndarray],
        weights: np.ndarray,
        values: np.ndarray,
        threads: Threads,
    ) -> None:
        """Sum over neighbours point by point, and over proxies of smaller cubes (P2P, M2P)."""
        nodes, node_weights = self._proxies(tree, outer)
        slot = np.full(len(tree.level), -1)
        slot[self._proxy_boxes] = np.arange(len(self._proxy_boxes))
        begin, entries = self._near_lists
        pairs = np.zeros(len(self._target_leaves), np.int64)
        like = np.empty(0, self._dtype)

        def sum_leaves(chunk: slice) -> None:
            boxes = self._target_leaves[chunk]
            passes.near_field(
                self.kernel,
                self.sources,
                weights,
                tree.source,
                nodes,
                node_weights,
                tree.centers(self._proxy_boxes),
                slot,
                begin[chunk.start : chunk.stop + 1],
                entries,
                self.targets,
                tree.target[boxes],
                tree.centers(boxes),
                self.target_order,
                like,
                values,
                pairs[chunk],
            )

        threads(sum_leaves, len(self._target_leaves), _LEAVES, progress=True)
        self._pairs[0] += pairs.sum()

    def _proxies(self, tree: Octree, outer: dict[int, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """Return points, seen from the centres, and weights that stand for expansions of cubes."""
        boxes = self._proxy_boxes
        levels = np.unique(tree.level[boxes]).tolist()
        most = max((self._levels[level].degree for level in levels), default=0) ** 3
        points = np.zeros((len(boxes), 3, most))
        weights = np.zeros((len(boxes), self.kernel.weight_size, most))
        for level in levels:
            operators = self._levels[level]
            rows = np.flatnonzero(tree.level[boxes] == level)
            nodes = operators.nodes(tree.half(level))
            expansions = outer[level][boxes[rows] - tree.first[level]]
            by_class = expansions.reshape(len(rows), CLASSES, -1)
            coefficients = np.empty((len(rows), self.kernel.weight_size, nodes.shape[1]))
            flat = coefficients.reshape(len(rows), -1)
            for c in range(CLASSES):
                functions = by_class[:, c] @ operators.source_basis[c].T
                flat[:, operators.source_members[c]] = functions
            spread = operators.spread(coefficients * operators.source_scale[:, None])
            points[rows, :, : nodes.shape[1]] = nodes
            weights[rows, :, : nodes.shape[1]] = spread
        return points, weights

    def _evaluate(
        self, tree: Octree, inner: dict[int, np.ndarray], values: np.ndarray, threads: Threads
    ) -> None:
        """Add the expansions in the leaves at their targets (L2P)."""
        for level in range(self._first, tree.depth + 1):
            self._evaluate_leaves(tree, level, inner[level], values, threads)

    def _evaluate_leaves(
        self, tree: Octree, level: int, inner: np.ndarray, values: np.ndarray, threads: Threads
    ) -> None:
        operators, first = self._levels[level], tree.first[level]
        n = operators.degree
        leaves = self._target_leaves[tree.level[self._target_leaves] == level]
        basis = operators.value_bases(self._dtype)

        def evaluate(chunk: slice) -> None:
            boxes = leaves[chunk]
            flat = np.empty((len(boxes), self.kernel.value_size * n**3), self._dtype)
            for c in range(CLASSES):
                flat[:, operators.value_members[c]] = inner[boxes - first, c] @ basis[c].T
            passes.evaluate_points(
                flat.reshape(len(boxes), -1, n, n * n),
                self.targets,
                tree.target[boxes],
                tree.centers(boxes),
                tree.half(level),
                self.target_order,
                values,
            )

        threads(evaluate, len(leaves), _CHUNK)


def precision_for(tolerance: float) -> str:
    """Return the precision that a tolerance allows, if the kernel does."""
    return "float32" if tolerance >= SINGLE else "float64"


def _channels(kernel: Kernel) -> float:
    return kernel.weight_size * kernel.value_size / 9.0


def _rank(kernel: Kernel, tolerance: float) -> float:
    """Return about how many functions an expansion has; a level takes 35 numbers times its square.

    Measured for 3 x 3 and 6 x 6 kernels at 1e-4 to 2e-11: 29 to 45 times.
    """
    return 12.0 * math.log10(1.0 / tolerance) ** 2 * _channels(kernel) ** 0.4


def _box_cost(kernel: Kernel, tolerance: float, single: bool) -> float:
    """Return what one cube more costs, in near pairs of the same precision.

    Measured: 40 and 120 microseconds for translations at ranks of 128 and 320 in single precision,
    0.75 ms at 576 in double precision, some 15 for the rest; 0.9e9 and 0.75e9 pairs a second.
    """
    channels, rank = _channels(kernel), _rank(kernel, tolerance)
    seconds = (0.6e-9 if single else 2.2e-9) * rank**2 + 1.25e-7 * rank + 3e-5
    return seconds * (0.9e9 if single else 0.75e9) / channels**0.6


class _OneThread:
    """A context in which BLAS has one thread: products of a chunk are too small to be shared.

    The number is that of the process. Of those who ask for it at the same time the last one out
    restores it; were it each, the first one's number would be lost, and BLAS left with one thread.
    """

    def __init__(self) -> None:
        self._lock, self._users = threading.Lock(), 0

    def __enter__(self) -> None:
        with self._lock:
            if not self._users:
                self._limit = _blas().limit(limits=1, user_api="blas")
            self._users += 1

    def __exit__(self, *exception: Any) -> None:
        with self._lock:
            self._users -= 1
            if not self._users:
                self._limit.restore_original_limits()


_blas_of_one_thread = _OneThread()
free_at_fork(_blas_of_one_thread._lock)


@cache
def _blas() -> ThreadpoolController:
    return ThreadpoolController()
