"""Errors of a sum that was made, by direct sums at some of its targets."""

from __future__ import annotations

import numpy as np

from treecode._lanes import LANES
from treecode.accuracy import Error, Parts
from treecode.boundaries.base import BoundedKernel, free
from treecode.kernels.base import Kernel
from treecode.methods.base import Sum
from treecode.methods.direct import EXACT
from treecode.pairs import sum_few
from treecode.ranks import OneRank
from treecode.shared_sum import made
from treecode.threads import Threads
from treecode.traversal import load_weights

WATCHED = 16  # targets at every later sum,
WATCHED_FROM = 10_000_000  # if it takes as long as so many pairs,
_WATCHED_SHARE = 200  # and so many times as long as to watch them
_ASTRAY = 2.0  # times the tolerance, from which errors there are looked into
_PIECE = 1_000_000  # pairs, for which a thread is woken


def direct_sum(kernel: Kernel, sources: np.ndarray, targets: np.ndarray, ranks: OneRank) -> Sum:
    """Return direct summation over copies of sources, (3, N), at targets, (3, M), its own."""
    exact = made(EXACT, kernel, ranks)
    exact.set_points(sources.copy(), targets)
    return exact


def sampled_error(
    kernel: Kernel,
    sum_: Sum,
    strengths: np.ndarray,
    values: np.ndarray,
    parts: Parts,
    samples: int,
    seed: int = 0,
    *,
    ranks: OneRank,
) -> Error:
    """Return the error of a sum that gave `values` for `strengths`, at so many drawn targets."""
    place = np.empty_like(sum_.target_order)
    place[sum_.target_order] = np.arange(len(values))

    def exact_at(rows: np.ndarray) -> np.ndarray:
        if parts.ranks.size > 1:
            return _over_ranks(kernel, sum_, strengths, sum_.targets[:, place[rows]], ranks)
        exact = direct_sum(kernel, sum_.sources, sum_.targets[:, place[rows]], ranks)
        return exact.execute(strengths[sum_.source_order])

    return parts.sampled_error(values, exact_at, samples, seed)


def _over_ranks(
    kernel: Kernel, sum_: Sum, strengths: np.ndarray, targets: np.ndarray, ranks: OneRank
) -> np.ndarray:
    """Return exact values at targets of this rank, (3, t), of the sources of all ranks."""
    everywhere = ranks.gather(targets.T)
    exact = direct_sum(kernel, sum_.sources, np.ascontiguousarray(everywhere.T), OneRank())
    values = ranks.add_up(exact.execute(strengths[sum_.source_order]))
    stop = int(np.cumsum(ranks.exchange(targets.shape[1]))[ranks.rank])
    return values[stop - targets.shape[1] : stop]


def seems_kept(
    kernel: Kernel,
    sum_: Sum,
    tol: float,
    strengths: np.ndarray,
    values: np.ndarray,
    parts: Parts,
    rows: np.ndarray,
    points: np.ndarray,
    ranks: OneRank,
) -> bool:
    """Look at the targets `rows`, which are at `points`, (3, n): a hundredth of a long sum.

    A sum that is kept while points and strengths change may lose its accuracy. `values` are those
    that it has given for `strengths`. Of a periodic kernel exact values take as long at few
    targets as at all of them: its sums are sampled by `Plan.refine` alone.
    """
    if not hasattr(free(kernel), "pair"):
        return True
    count = sum_.sources.shape[1]
    everywhere = int(parts.ranks.add_up(np.array(count)))
    few = min(WATCHED, int(sum_.effort / (_WATCHED_SHARE * max(1, everywhere))))
    if sum_.effort < WATCHED_FROM or not few:
        return True
    if parts.ranks.size > 1:
        few = -(-few // ranks.size)
        all_exact = _over_ranks(kernel, sum_, strengths, points[:, :few], ranks)
        return parts.seem_within(_ASTRAY * tol, values, all_exact, rows[:few])
    few = min(few, len(rows))
    if isinstance(kernel, BoundedKernel):
        exact_sum = direct_sum(kernel, sum_.sources, points[:, :few].copy(), ranks)
        all_exact = exact_sum.execute(strengths[sum_.source_order])
        return ranks.first(parts.seem_within(_ASTRAY * tol, values, all_exact, rows[:few]))
    padded = np.zeros((3, few + LANES - 1))
    padded[:, :few] = points[:, :few]
    exact = np.zeros((kernel.value_size, few))
    weights = np.empty((kernel.weight_size, count))
    sources = sum_.sources
    own = ranks.share(few)

    def sum_some(some: slice) -> None:
        start, stop = own.start + some.start, own.start + some.stop
        sum_few(kernel, padded, start, stop, sources, weights, exact)

    with Threads(most=1 + few * count // _PIECE) as threads:
        load_weights(kernel, strengths, sum_.source_order, weights, threads)
        threads(sum_some, own.stop - own.start, 1)
    all_exact = ranks.gather(exact.T[own])
    return ranks.first(parts.seem_within(_ASTRAY * tol, values, all_exact, rows[:few]))


def in_given_order(sum_: Sum) -> tuple[np.ndarray, np.ndarray | None]:
    """Return the points of a sum, (3, N) and (3, M), in the order in which they were set."""
    sources, targets = np.empty_like(sum_.sources), np.empty_like(sum_.targets)
    sources[:, sum_.source_order] = sum_.sources
    targets[:, sum_.target_order] = sum_.targets
    return sources, None if sum_.targets is sum_.sources else targets
