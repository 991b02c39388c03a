"""A sum whose targets are shared by ranks; points and strengths are known to all of them.

This is algorithm 2 of T. Each rank sums at targets that are neighbours in space, and all are told
the values. The shares of the targets follow the work that they have made.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from treecode.boundaries.base import BoundedKernel
from treecode.boundaries.within import BoundedSum, Within
from treecode.curve import first_keys
from treecode.kernels.base import Kernel
from treecode.methods import registry
from treecode.methods.base import Method, Sum
from treecode.methods.registry import Choice
from treecode.ranks import OneRank, Shared
from treecode.sliced_sum import SlicedSum
from treecode.timing import Seconds

_LEVEL = 10  # of the cells along whose curve targets are shared
_IMBALANCE = 0.02  # of the work of a rank beyond the mean, from which on shares are changed


def made(choice: Choice, kernel: Any, ranks: OneRank, progress: bool = False) -> Sum:
    """Return the sum of a choice, without points yet, shared by the ranks."""
    if isinstance(kernel, BoundedKernel):
        return _of_terms(choice, kernel, partial(made, ranks=ranks, progress=progress))
    if ranks.size == 1:
        return choice.sum(kernel, progress)
    across = _across(choice, kernel, ranks, progress)
    if across is not None:
        return SlicedSum(across, ranks)
    return SharedSum(choice, kernel, ranks, progress and ranks.rank == 0)


def spread(choice: Choice, kernel: Any, ranks: OneRank, progress: bool = False) -> Sum:
    """Return the sum of a choice, without points yet, of which each rank has some."""
    if isinstance(kernel, BoundedKernel):
        return _of_terms(choice, kernel, partial(spread, ranks=ranks, progress=progress))
    across = _across(choice, kernel, ranks, progress)
    assert across is not None, "see `require_spread`"
    return SlicedSum(across, OneRank())


def _of_terms(
    choice: Choice, kernel: BoundedKernel, make: Callable[[Choice, Kernel], Sum]
) -> BoundedSum:
    """Return the sum of a choice within a boundary, of sums that `make` returns for its terms."""
    method = registry.method_for(kernel, choice.backend)
    assert isinstance(method, Within)
    parameters = method.divided(choice.parameters)
    choices = [Choice(choice.backend, **own) for own in parameters]
    kernels = [term.kernel for term in kernel.terms]
    return BoundedSum(method, kernel.terms, list(map(make, choices, kernels)))


def require_spread(backend: str) -> None:
    """Refuse the name of a method that has no sum over points of which each rank has some."""
    methods = map(registry.get, registry.names())
    names = [m.name for m in methods if type(m).across is not Method.across]
    if backend not in names:
        allowed = ", ".join(map(repr, names))
        raise ValueError(f"backend must be {allowed} with distributed=True, got {backend!r}")


def require_all_or_none(ranks: OneRank, targets: np.ndarray | None) -> None:
    """Refuse targets that some ranks give, and others do not."""
    without = ranks.exchange(targets is None)
    if len(set(without)) > 1:
        raise ValueError(
            f"targets must be given by all ranks or by none, got None on rank "
            f"{without.index(True)}; a rank without targets gives an array of shape (0, 3)"
        )


def _across(choice: Choice, kernel: Kernel, ranks: OneRank, progress: bool) -> Sum | None:
    method = registry.get(choice.backend)
    parameters = method.complete(choice.parameters)
    return method.across(kernel, parameters, ranks, progress and ranks.rank == 0)


def along_curve(points: np.ndarray) -> np.ndarray:
    """Return the order of points, (3, N), along the curve of Morton through 1024^3 cells."""
    low, extent = points.min(axis=1), np.ptp(points, axis=1).max()
    last = (1 << _LEVEL) - 1
    cells = ((points - low[:, None]) / (extent or 1.0) * last).astype(np.int64)
    return np.argsort(first_keys(_LEVEL, cells.T), kind="stable")


def balanced(cuts: np.ndarray, work: Sequence[float]) -> np.ndarray:
    """Return other ends of shares, (R + 1,), between which the work should be equal.

    Within each share that has been summed it is taken as constant. Counts of work tell it, not
    times: a sum depends on no clock.

    Parameters
    ----------
    cuts : (R + 1,) int64
        Where the shares begin and end that have been summed.
    work : sequence of R floats
        Of each of them.
    """
    ranks, total = len(work), sum(work)
    if ranks * max(work) <= (1.0 + _IMBALANCE) * total:
        return cuts
    done = np.concatenate([[0.0], np.cumsum(work)])
    moved = cuts.copy()
    moved[1:-1] = np.rint(np.interp(total * np.arange(1, ranks) / ranks, done, cuts))
    return moved


class SharedSum:
    """A `methods.base.Sum` of which each rank makes its share.

    A sum with the attribute `ranks` is told of them, and its shares follow the work. Of any other
    the values may depend on the shares. They are equal then, or else those of a resumed run would
    be others.

    Parameters
    ----------
    choice : Choice
    kernel : Kernel
    ranks : OneRank
    progress : bool
    """

    def __init__(self, choice: Choice, kernel: Kernel, ranks: OneRank, progress: bool) -> None:
        self._ranks = ranks
        self._own = choice.sum(kernel, progress)
        if isinstance(self._own, Shared):
            self._own.ranks = ranks
        self._shared = Seconds()
        self._pairs: tuple[int | None, int | None] = None, None
        self._received: int | None = None
        self._cuts, self._work = ranks.cuts(0), [0.0] * ranks.size

    @property
    def effort(self) -> float:
        """Work of the last sum, of all ranks, in pairs."""
        return sum(self._work)

    @property
    def parameters(self) -> Mapping[str, Any]:
        """Those of the share, which are the same on all ranks."""
        return self._own.parameters

    @property
    def seconds(self) -> Mapping[str, float]:
        """By stage, on this rank: those of its share, and what sharing takes."""
        return {**self._own.seconds, **self._shared}

    def set_points(self, sources: np.ndarray, targets: np.ndarray | None) -> None:
        """Take points, (3, N) and (3, M): a share of the targets, and all sources.

        Where the sum does not know of ranks, the outermost targets are in each share, so that no
        box around points differs.
        """
        self._shared, self._pairs, self._received = Seconds(), (None, None), None
        with self._shared.stage("sharing"):
            everywhere = sources if targets is None else targets
            count = everywhere.shape[1]
            self._cuts = self._ranks.first(self._next_cuts(count))
            self._work = [0.0] * self._ranks.size
            self._order = along_curve(everywhere) if count else np.arange(0)
            begin, end = self._cuts[self._ranks.rank : self._ranks.rank + 2]
            own = self._order[begin:end]
            self._count = len(own)
            if targets is not None and count and not isinstance(self._own, Shared):
                own = np.concatenate([own, targets.argmin(axis=1), targets.argmax(axis=1)])
            share = np.ascontiguousarray(everywhere[:, own])
        self._own.set_points(sources, share)
        self.sources, self.source_order = self._own.sources, self._own.source_order
        if targets is None:
            self.targets, self.target_order = self.sources, self.source_order
        else:
            self.targets, self.target_order = targets, np.arange(count)

    def _next_cuts(self, count: int) -> np.ndarray:
        if count == self._cuts[-1] and isinstance(self._own, Shared):
            return balanced(self._cuts, self._work)
        return self._ranks.cuts(count)

    def execute(self, strengths: np.ndarray) -> np.ndarray:
        """Return the sum, (M, value_size), of strengths (N, strength_size), on all ranks."""
        received = self._ranks.received
        own = self._own.execute(strengths)[: self._count]
        info = self._own.info()
        with self._shared.stage("waiting"):
            done = self._ranks.exchange(
                (self._own.effort, info["near_pairs"] or 0, info["far_pairs"] or 0)
            )
        self._work, near, far = map(list, zip(*done, strict=True))
        self._pairs = sum(near), sum(far)
        with self._shared.stage("communication"):
            gathered = self._ranks.gather(own)
            values = np.empty_like(gathered)
            values[self._order] = gathered
        self._received = self._ranks.received - received
        return values

    def info(self) -> dict[str, Any]:
        """Return that of the share, pairs of all ranks, and bytes that came from the others."""
        near, far = self._pairs
        own = self._own.info()
        kept = self._order.nbytes + (0 if self.targets is self.sources else self.targets.nbytes)
        return {
            **own,
            "ranks": self._ranks.size,
            "near_pairs": near,
            "far_pairs": far,
            "bytes": own["bytes"] + kept,
            "received_bytes": self._received,
        }
