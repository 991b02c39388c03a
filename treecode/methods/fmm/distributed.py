"""A sum by the fast multipole method over points that no rank has all of.

Each rank gives some sources and targets, and gets the values at its targets. Within the sum, points
are on the rank whose piece of the curve they lie in. That rank has their tree, the cubes of others
that are near (`ghosts`), and the cubes that several ranks have points in.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from treecode.kernels.base import Kernel
from treecode.methods.fmm.curve import Pieces, keys_of
from treecode.methods.fmm.far_field import Expansions
from treecode.methods.fmm.ghosts import essential
from treecode.methods.fmm.hierarchy import first_level
from treecode.methods.fmm.lists import find_lists
from treecode.methods.fmm.octree import Box, build_octree, root_widths
from treecode.methods.fmm.partition import aligned, divide
from treecode.methods.fmm.sizing import choose_width, expansion_size, sampling_interval
from treecode.methods.fmm.summation import FastMultipole
from treecode.ranks import NOTHING, Delivery, OneRank
from treecode.threads import Threads
from treecode.timing import Seconds
from treecode.traversal import load_weights

_BALANCE = 1.1  # most work of a rank, relative to the mean, with which pieces are kept,
_FIRST = 1.02  # and with which they are taken at first
_TRIES = 3  # partitions


class Journey(NamedTuple):
    """How rows go to the ranks that own their points, and back.

    Attributes
    ----------
    order : (n,) int64
        Own rows by rank,
    place : (n,) int64
        and where each of them is then.
    sent, got : lists of int
        Rows for and of each rank.
    """

    ranks: OneRank
    order: np.ndarray
    place: np.ndarray
    sent: list[int]
    got: list[int]

    @classmethod
    def plan(cls, pieces: Pieces, keys: np.ndarray, ranks: OneRank) -> Journey:
        """Return the journey of points with some keys, (n,) uint64."""
        owner = np.searchsorted(pieces.begin[1:-1], keys, side="right")
        owner = owner.astype(np.min_scalar_type(ranks.size))  # small numbers are sorted by digits
        order = np.argsort(owner, kind="stable")
        place = np.empty_like(order)
        place[order] = np.arange(len(order))
        sent = np.bincount(owner, minlength=ranks.size).tolist()
        _, got = ranks.deliver(np.empty((len(keys), 0)), sent)
        return cls(ranks, order, place, sent, got)

    def go(self, rows: np.ndarray) -> np.ndarray:
        """Return the rows that others and this rank send here, (n, columns) of each."""
        return self.ranks.post(np.take(rows, self.order, axis=0), self.sent, self.got).rows()

    def back(self, rows: np.ndarray) -> np.ndarray:
        """Return rows of own points, from rows in the order in which `go` returned them."""
        arrived = self.ranks.post(rows, self.got, self.sent).rows()
        return np.take(arrived, self.place, axis=0)


class DistributedFastMultipole(FastMultipole):
    """A sum of which each rank has some points, and the tree near them.

    Parameters
    ----------
    kernel : Kernel
    parameters : mapping
        Of `method.FastMultipoleMethod`.
    progress : bool
    ranks : OneRank
    """

    def __init__(
        self, kernel: Kernel, parameters: Mapping[str, Any], progress: bool, ranks: OneRank
    ) -> None:
        super().__init__(kernel, parameters, progress)
        self._ranks = ranks
        pieces = [int(number, 16) for number in parameters.get("pieces", "").split()]
        # First keys of the pieces and the end, before they are aligned.
        fits = len(pieces) == ranks.size + 1
        self._begin = np.array(pieces, np.uint64) if fits else None
        self._received, self._effort = 0, 0.0

    @property
    def parameters(self) -> dict[str, Any]:
        """Those that were given, the side of the root, and the pieces of the ranks."""
        known = super().parameters
        if self._begin is not None:
            known["pieces"] = " ".join(f"{key:x}" for key in self._begin.tolist())
        return known

    def set_points(self, sources: np.ndarray, targets: np.ndarray | None) -> None:
        """Take own points, (3, N) and (3, M), and find who acts on whom."""
        self.seconds = Seconds()
        self._pairs, self._tree = None, None
        given = [sources] if targets is None else [sources, targets]
        self._target_count = given[-1].shape[1]
        counts = self._ranks.add_up(np.array([points.shape[1] for points in given]))
        if not counts.all():
            return
        with Threads() as threads:
            with self.seconds.stage("partition", more=True):
                box = self._box(given)
                self._choose_common_width(box, given, int(counts.sum()), threads)
                find = partial(keys_of, box=box, width=self.width, threads=threads)
                keys = [find(points) for points in given]
                along = tuple(map(np.sort, keys))
                bound = _FIRST if self._begin is None else _BALANCE
                if self._begin is None:
                    everywhere = np.sort(np.concatenate(keys))
                    self._begin = divide(self._ranks, everywhere, np.ones(len(everywhere)))
            leaf_size = int(counts.sum()) if counts.sum() <= self._direct else self.leaf_size
            begin = np.empty(0, np.uint64)
            for attempt in range(_TRIES):
                with self.seconds.stage("partition", more=True):
                    before, begin = begin, aligned(self._ranks, self._begin, along, leaf_size)
                    if np.array_equal(before, begin):
                        break  # leaves are not divided
                    pieces = Pieces(self._ranks, box, begin)
                    self._journeys = [Journey.plan(pieces, some, self._ranks) for some in keys]
                    own = [
                        np.ascontiguousarray(journey.go(points.T).T)
                        for journey, points in zip(self._journeys, given, strict=True)
                    ]
                self._build(pieces, own, leaf_size, threads)
                if attempt + 1 == _TRIES or self._is_balanced(bound):
                    break
                with self.seconds.stage("partition", more=True):
                    self._begin = divide(self._ranks, *self._work_on_curve(find))
        with self.seconds.stage("operators"):
            self._serve()

    def _box(self, given: list[np.ndarray]) -> Box:
        """Return the box around the points of all ranks."""
        points = np.concatenate(given, axis=1)
        low, high = points.min(axis=1, initial=math.inf), points.max(axis=1, initial=-math.inf)
        told = self._ranks.exchange((low, high))
        return Box(np.min([low for low, _ in told], axis=0), np.max([h for _, h in told], axis=0))

    def _choose_common_width(
        self, box: Box, given: list[np.ndarray], count: int, threads: Threads
    ) -> None:
        """Choose the side of the root by a sample of all, and keep it as long as they fit."""
        widths = root_widths(box)
        if widths[0] <= self.width <= widths[-1]:
            return
        every = sampling_interval(count, self.leaf_size)
        samples = [
            np.ascontiguousarray(self._ranks.gather(points.T[::every]).T) for points in given
        ]
        split = None if len(given) == 1 else samples[0].shape[1]
        sample = np.concatenate(samples, axis=1)
        choice = choose_width(
            widths, sample, split, every, self.leaf_size, self._cube_cost, threads
        )
        self.width, self._work = self._ranks.first(choice)

    def _build(
        self, pieces: Pieces, own: list[np.ndarray], leaf_size: int, threads: Threads
    ) -> None:
        """Build the tree of own points and of those that others have near them."""
        with self.seconds.stage("tree", more=True):
            points = np.concatenate(own, axis=1) if len(own) > 1 else own[0]
            split = None if len(own) == 1 else own[0].shape[1]
            tree, self.source_order, self.target_order = build_octree(
                points, split, leaf_size, self.width, threads, pieces
            )
            sources = points
            self.targets = points
            if split is not None:
                sources = np.ascontiguousarray(own[0][:, self.source_order])
                self.targets = np.ascontiguousarray(own[1][:, self.target_order])
        with self.seconds.stage("ghosts", more=True):
            self._others = others = essential(tree, sources, pieces, self._ranks)
            self.sources = np.concatenate([sources, others.points], axis=1)
        with self.seconds.stage("tree", more=True):
            self._tree = others.tree
            terms = expansion_size(self.tol, self.degree)
            self._lists = find_lists(others.tree, terms, threads, others.expands)
            self._leaf_work = self._work_of_leaves()

    def _work_of_leaves(self) -> np.ndarray:
        """Return the work, in pairs, at each of the leaves with targets."""
        assert self._tree is not None
        begin, entries = self._lists.near
        acting = np.where(entries >= 0, entries, 0)
        counts = np.diff(self._tree.source)[acting, 0]
        counts = np.where(entries >= 0, counts, expansion_size(self.tol, self.degree))
        total = np.append(0, counts.cumsum())[begin]
        pairs = np.diff(total) * np.diff(self._tree.target[self._lists.target_leaves])[:, 0]
        cubes = np.count_nonzero(self._lists.has_targets)
        return pairs + self._cube_cost * cubes / max(1, len(pairs))

    def _is_balanced(self, bound: float) -> bool:
        work = self._ranks.exchange(float(self._leaf_work.sum()))
        return max(work) <= bound * sum(work) / len(work)

    def _work_on_curve(
        self, find: Callable[[np.ndarray], np.ndarray]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the keys of own targets along the curve, and the work for each."""
        assert self._tree is not None
        number = np.diff(self._tree.target[self._lists.target_leaves])[:, 0]
        work = np.repeat(self._leaf_work / number, number)
        keys = find(self.targets)
        order = np.argsort(keys, kind="stable")
        return keys[order], work[order]

    def _serve(self) -> None:
        """Get the operators for the levels of all ranks."""
        assert self._tree is not None
        told = self._ranks.exchange((first_level(self._tree, self._lists), self._tree.depth))
        depth = max(deepest for _, deepest in told)
        first = min(level for level, _ in told)
        self._operators.serve(first, [self._tree.half(level) for level in range(first, depth + 1)])

    def execute(self, strengths: np.ndarray) -> np.ndarray:
        """Return the sum at own targets, (M, value_size), of own strengths (N, strength_size)."""
        if self._tree is None:
            self._pairs, self._effort = (0, 0), 0.0
            return np.zeros((self._target_count, self.kernel.value_size))
        received = self._ranks.received
        with self.seconds.stage("communication"):
            strengths = self._journeys[0].go(strengths)
        values = super().execute(strengths)
        with self.seconds.stage("waiting"):
            told = self._ranks.exchange((super().effort, self._pairs or (0, 0)))
        self._effort = sum(effort for effort, _ in told)
        near, far = np.sum([pairs for _, pairs in told], axis=0, dtype=int).tolist()
        self._pairs = near, far
        with self.seconds.stage("communication", more=True):
            out = self._journeys[-1].back(values)
        self._received = self._ranks.received - received
        return out

    def _weights(self, strengths: np.ndarray, threads: Threads) -> tuple[np.ndarray, float]:
        """Return weights in tree order with those of others behind, and their common unit."""
        others, count = self._others, len(strengths)
        with self.seconds.stage("weights"):
            own = np.empty((self.kernel.weight_size, count))
            load_weights(self.kernel, strengths, self.source_order, own, threads)
            unit = max(self._ranks.exchange(self._power_of_two(_largest(own))))
            own /= unit
        with self.seconds.stage("communication", more=True):
            given = np.take(own, others.given_points, axis=1).T
            ghosts = self._ranks.post(given, others.sent_points, others.got_points).rows()
        return np.concatenate([own, ghosts.T], axis=1), unit

    def _send(self, multipole: Expansions) -> Delivery:
        """Begin to exchange expansions near pieces, and add up those of shared cubes."""
        others = self._others
        with self.seconds.stage("communication", more=True):
            self._unpack(
                multipole, others.shared, self._ranks.add_up(self._packed(multipole, others.shared))
            )
            given = [self._packed(multipole, boxes) for boxes in others.given_boxes]
            sent, got = map(len, given), (self._size(multipole, b) for b in others.got_boxes)
            delivery = self._ranks.post(np.concatenate(given), list(sent), list(got))
        if others.expands[self._lists.proxy_boxes].all():
            return delivery
        self._receive(multipole, delivery)  # the near field needs those of others, as points
        return NOTHING

    def _receive(self, multipole: Expansions, delivery: Delivery) -> None:
        """Put the expansions of others in their places."""
        if delivery is NOTHING:
            return
        with self.seconds.stage("communication", more=True):
            rows, stop = delivery.rows(), 0
            for some in self._others.got_boxes:
                start, stop = stop, stop + self._size(multipole, some)
                self._unpack(multipole, some, rows[start:stop])

    def _rows(
        self, multipole: Expansions, boxes: np.ndarray
    ) -> list[tuple[np.ndarray, np.ndarray]]:
        """Return the expansions of each level with the rows of some boxes."""
        assert self._tree is not None
        level = self._tree.level[boxes]
        return [
            (expansions, boxes[level == depth] - self._tree.first[depth])
            for depth, expansions in sorted(multipole.items())
        ]

    def _packed(self, multipole: Expansions, boxes: np.ndarray) -> np.ndarray:
        """Return the expansions of some boxes in a row."""
        rows = self._rows(multipole, boxes)
        flat = [expansions[some].ravel() for expansions, some in rows]
        return np.concatenate([np.empty(0, self._operators.dtype), *flat])

    def _size(self, multipole: Expansions, boxes: np.ndarray) -> int:
        return sum(
            len(some) * expansions.shape[1] for expansions, some in self._rows(multipole, boxes)
        )

    def _unpack(self, multipole: Expansions, boxes: np.ndarray, numbers: np.ndarray) -> None:
        stop = 0
        for expansions, some in self._rows(multipole, boxes):
            start, stop = stop, stop + len(some) * expansions.shape[1]
            expansions[some] = numbers[start:stop].reshape(len(some), expansions.shape[1])

    @property
    def effort(self) -> float:
        """What the last sum took of all ranks, in near pairs."""
        return self._effort

    def info(self) -> dict[str, Any]:
        """Return that of a sum, with pairs of all ranks, and cubes and bytes of this one."""
        own = super().info()
        return {**own, "ranks": self._ranks.size, "received_bytes": self._received}


def _largest(weights: np.ndarray) -> float:
    """Return the largest magnitude of weights, 0 of none."""
    return float(max(weights.max(initial=0.0), -weights.min(initial=0.0)))
