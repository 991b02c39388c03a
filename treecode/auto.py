"""A tolerance as the one knob: the cheapest sum is chosen by a model, checked and corrected.

`costs.json` is the model: seconds and errors of each backend for each kernel, as fitted by
``benchmarks/fit_costs.py``. At the first sum over some points

* a treecode of low degree beside direct sums at a few targets tells how errors for these points
  and strengths compare with those of the model, single precision what its rounding does to them,
  and pairs are counted on the way of these targets;
* the cheapest sum that should reach the tolerance is done;
* its error is sampled: if it is too large a more accurate sum is done instead, and if it leaves
  room for one that is cheaper, and many are to follow, that is tried.

No time is measured: what is chosen depends on kernel, points and strengths alone.
"""

from __future__ import annotations

import json
import math
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple, NoReturn

import numpy as np

from treecode._lanes import LANES
from treecode.accuracy import Error, Parts, largest, ratio
from treecode.backends import direct, kitc, taylor
from treecode.backends.walk import PRECISIONS, Walk
from treecode.fmm.multipole import Multipole, precision_for
from treecode.kernels.base import Kernel
from treecode.pairs import sum_few
from treecode.threads import Threads
from treecode.traversal import acceptance
from treecode.tree import Tree

WALKS: dict[str, ModuleType] = {"direct": direct, "kitc": kitc, "taylor": taylor}
THETAS = 0.5, 0.6, 0.7, 0.8
DEGREES = {"kitc": range(1, 15), "taylor": range(19)}
LEAF_SIZES = 250, 500, 1000, 2000
TOLERANCES = tuple(10.0 ** (-0.5 * k) for k in range(1, 26))  # of "fmm": few operators serve many
FEW = 100_000_000  # pairs: what takes a tenth of a second in all is not thought about
PROBE: dict[str, Any] = {"theta": 0.7, "degree": 3, "leaf_size": 500}

_PILOTS = 64  # targets at which errors are looked at before a sum,
_FEW_PILOTS = 16  # more if fewer than so many would be of a group
_SAMPLES = 400  # and after it
WATCHED = 16  # at every later sum,
WATCHED_FROM = 10_000_000  # if it takes as long as so many pairs,
_WATCHED_SHARE = 200  # and so many times as long as to watch them
_ASTRAY = 2.0  # times the tolerance, from which errors there are looked into
_PIECE = 1_000_000  # pairs, for which a thread is woken
_COUNTED = 40_000  # sources among which pairs are counted
_MARGIN = 1.25  # by which errors may be larger than expected
_SUMS = 300  # that share the operators of "fmm", and the choice
_WORTH = 0.9  # of the seconds of a sum that will do, below which another is tried
_LEAST = 0.1  # of an expected error: a sum that has hardly a far field tells nothing of others
_SINGLE_UNIT = 2.0**-24  # error of singles where it does not show at the pilots
_ROUNDING = 100 * 2.0**-53  # of direct sums, relative to sums of such terms that do not cancel


class ToleranceError(ValueError):
    """No sum among those allowed is as accurate as it was asked to be."""


class CancellationError(ToleranceError):
    """Not even direct sums in doubles are: their terms cancel to little more than rounding."""


class Choice(NamedTuple):
    """A backend and its parameters; None where it has none.

    `width` is the side of the root of "fmm", 0 if it is to be chosen: it depends on points that
    were set before.
    """

    backend: str
    theta: float | None = None
    degree: int | None = None
    leaf_size: int | None = None
    precision: str | None = None
    tol: float | None = None
    width: float | None = None

    def __str__(self) -> str:
        if self.backend == "fmm":
            return f"fmm({self.tol:.2g})"
        bits = " float32" if self.precision == "float32" else ""
        if self.backend in DEGREES:
            return f"{self.backend}({self.theta:g}/{self.degree}{bits})"
        return self.backend + bits

    def sum(self, kernel: Kernel, progress: bool = False) -> Walk | Multipole:
        """Return the sum, without points yet."""
        if self.backend == "fmm":
            return Multipole(
                kernel, self.tol or 0.0, self.degree, self.leaf_size, progress, self.width or 0.0
            )
        return Walk(
            WALKS[self.backend],
            kernel,
            self.theta or 0.5,
            self.degree or 0,
            self.leaf_size or 1,
            self.precision or "float64",
            progress,
        )


EXACT = Choice("direct", precision="float64")


def is_exact(choice: Choice) -> bool:
    """Tell whether this is direct summation in doubles."""
    return choice.backend == "direct" and choice.precision != "float32"


def sampled_error(
    kernel: Kernel,
    done: Walk | Multipole,
    strengths: np.ndarray,
    values: np.ndarray,
    parts: Parts,
    samples: int,
    seed: int = 0,
) -> Error:
    """Return the error of a sum that gave `values` for `strengths`."""
    place = np.empty_like(done.target_order)
    place[done.target_order] = np.arange(len(values))

    def exact_at(rows: np.ndarray) -> np.ndarray:
        exact = _direct(kernel, done.sources, done.targets[:, place[rows]])
        return exact.execute(strengths[done.source_order])

    return parts.sampled_error(values, exact_at, samples, seed)


def _direct(kernel: Kernel, sources: np.ndarray, targets: np.ndarray) -> Walk | Multipole:
    done = EXACT.sum(kernel)
    done.set_points(sources.copy(), targets)
    return done


def able(kernel: Kernel) -> tuple[str, ...]:
    """Return the backends that take a kernel; "fmm" may refuse it later."""
    walks = (name for name in WALKS if all(hasattr(kernel, m) for m in WALKS[name].KERNEL_MEMBERS))
    return (*walks, "fmm")


@dataclass
class Search:
    """The search for the cheapest sum that reaches a tolerance.

    Parameters
    ----------
    kernel : Kernel
    backends : tuple of str
        To choose from.
    tolerance : float
        Relative error, K eq. (8.1), of each of the `accuracy.Parts`.
    theta, leaf_size : optional
        Of treecodes, where they are not to be chosen.
    progress : bool, optional
    sums : int, optional
        How many share the operators of "fmm", and the choice.
    """

    kernel: Kernel
    backends: tuple[str, ...]
    tolerance: float
    theta: float | None = None
    leaf_size: int | None = None
    progress: bool = False
    sums: int = _SUMS

    def __call__(
        self,
        sources: np.ndarray,
        targets: np.ndarray | None,
        strengths: np.ndarray,
        parts: Parts,
    ) -> tuple[Choice, Walk | Multipole, np.ndarray]:
        """Return what was chosen for points (3, N) and (3, M), the sum, and what it gave.

        Raises
        ------
        ToleranceError
            With the tolerance that can be had.
        """
        case = _Case(self, sources, sources if targets is None else targets, strengths, parts)
        kept, limit = None, math.inf
        while limit > 0.0 and (best := case.cheapest(limit)):
            choice = best.choice
            done = choice.sum(self.kernel, self.progress)
            try:
                done.set_points(sources.copy(), None if targets is None else targets.copy())
            except ValueError:
                if choice.backend != "fmm" or "direct" not in self.backends:
                    raise
                # It refuses kernels that are not isotropic, and what does not fit in memory.
                case.learn(best, math.inf)
                continue
            values = done.execute(strengths)
            if choice == EXACT:
                return choice, done, values
            bound = self.bound(done, strengths, values, parts)
            if kept:  # at all targets, of which a few may carry the error
                bound = max(bound, float(parts.difference(values, kept[2]).max()))
            case.learn(best, bound)
            if bound <= self.tolerance:
                kept, limit = (choice, done, values), _WORTH * best.seconds * (self.sums > 1)
        assert kept is not None  # else `cheapest` refuses
        return kept

    def bound(
        self, done: Walk | Multipole, strengths: np.ndarray, values: np.ndarray, parts: Parts
    ) -> float:
        """Return what the error of a sum that gave `values` hardly exceeds."""
        return sampled_error(self.kernel, done, strengths, values, parts, _SAMPLES).bound

    def seems_kept(
        self,
        done: Walk | Multipole,
        weights: np.ndarray,
        values: np.ndarray,
        parts: Parts,
        rows: np.ndarray,
        points: np.ndarray,
    ) -> bool:
        """Look at the targets `rows`, which are at `points`, (3, n): a hundredth of a long sum.

        A sum that is kept while points and strengths change may lose its accuracy. `weights` and
        `values` are what it has returned.
        """
        count = done.sources.shape[1]
        few = min(len(rows), int(done.effort / (_WATCHED_SHARE * max(1, count))))
        if done.effort < WATCHED_FROM or not few:
            return True
        padded = np.zeros((3, few + LANES - 1))
        padded[:, :few] = points[:, :few]
        exact = np.zeros((self.kernel.value_size, few))

        def sum_some(some: slice) -> None:
            sum_few(self.kernel, padded, some.start, some.stop, done.sources, weights, exact)

        with Threads(most=1 + few * count // _PIECE) as threads:
            threads(sum_some, few, 1)
        return parts.seem_within(_ASTRAY * self.tolerance, values, exact.T, rows[:few])


class _Candidate(NamedTuple):
    """A choice, and the seconds and the error that are expected of it."""

    choice: Choice
    seconds: float
    error: float


class _Case:
    """What a few targets and the sums done tell of points and strengths, and what sums there are.

    Of each kind of sum `learn` takes how its error compared with the model.
    """

    def __init__(
        self,
        search: Search,
        sources: np.ndarray,
        targets: np.ndarray,
        strengths: np.ndarray,
        parts: Parts,
    ) -> None:
        self._search, self._model, self._parts = search, model(search.kernel), parts
        self._sources, self._targets = sources, targets
        self._misses: dict[tuple[str, str | None], float] = defaultdict(lambda: 1.0)
        self._prices: dict[float, tuple[Choice, float]] = {}
        self._tried: set[Choice] = set()
        self._drawn = parts.draw(_PILOTS, _FEW_PILOTS)
        self._pilots = targets[:, self._drawn]
        exact = self._require_digits(strengths)
        pairs = sources.shape[1] * targets.shape[1] * search.sums
        self._few = pairs <= FEW and "direct" in search.backends
        self._named = search.backends == ("fmm",)  # takes a tolerance itself
        if not (self._few or self._named):
            probe = self._error_of(Choice("kitc", **PROBE), strengths, exact)
            self._scale = _MARGIN * (probe or self._model.usual_error)
            single = Choice("direct", precision="float32")
            rounding = self._error_of(single, strengths, exact) or _SINGLE_UNIT
            self._rounding = {"float64": 0.0, "float32": _MARGIN * rounding}

    def _require_digits(self, strengths: np.ndarray) -> np.ndarray:
        """Return direct sums at the pilots; refuse a tolerance beyond their rounding.

        If every source is taken or left by chance, twice the sum differs from the sum of all as
        if signs were random: by the size of sums that do not cancel.
        """
        done = _direct(self._search.kernel, self._sources, self._pilots.copy())
        exact = done.execute(strengths)
        peak = largest(exact)
        rng, spread = np.random.default_rng(0), np.zeros(())
        for _ in range(8 if len(strengths) <= _PILOTS else 1):  # few may all be taken
            taken = rng.integers(0, 2, (len(strengths), 1)) * strengths
            random = (2.0 * done.execute(taken) - exact) / peak
            spread = np.maximum(spread, self._parts.squares(random, self._drawn))
        size = self._parts.squares(exact / peak, self._drawn)
        loss = float(ratio(spread * (size > 0.0), size).max(initial=0.0))
        if _ROUNDING * loss > self._search.tolerance:
            why = f"contributions cancel to {1.0 / loss:.1g} of their size"
            self._refuse(_ROUNDING * loss, why, CancellationError)
        return exact

    def _error_of(self, choice: Choice, strengths: np.ndarray, exact: np.ndarray) -> float:
        """Return the error of a sum at the pilots."""
        done = choice.sum(self._search.kernel)
        done.set_points(self._sources.copy(), self._pilots.copy())
        values = done.execute(strengths)
        if not np.isfinite(values).all():  # beyond the range of singles
            return math.inf
        return float(self._parts.difference(values, exact, self._drawn).max())

    def cheapest(self, below: float) -> _Candidate | None:
        """Return the cheapest of what should reach the tolerance and was not tried yet.

        None if there is none in less than `below` seconds; refused if there is none at all.
        """
        if self._few:
            return _Candidate(EXACT, 0.0, 0.0)
        offers = [self._expected(walk) for walk in self._walks]
        if "fmm" in self._search.backends:
            offers.append(self._multipole())
        good = [
            offer
            for offer in offers
            if offer.error <= self._search.tolerance
            and offer.seconds < below
            and offer.choice not in self._tried
        ]
        if not good and below == math.inf:
            by = " or ".join(map(repr, self._search.backends))
            self._refuse(min(offer.error for offer in offers), f"by {by}")
        return min(good, key=lambda offer: offer.seconds, default=None)

    def learn(self, done: _Candidate, bound: float) -> None:
        """Expect of sums of the same kind what the sample says of one."""
        self._misses[_kind(done.choice)] *= max(bound / done.error, _LEAST)
        self._tried.add(done.choice)

    def _expected(self, offer: _Candidate) -> _Candidate:
        return offer._replace(error=self._misses[_kind(offer.choice)] * offer.error)

    def _refuse(
        self, attainable: float, why: str, kind: type[ToleranceError] = ToleranceError
    ) -> NoReturn:
        least = f"tol must be at least {1.1 * attainable:.1e}"
        raise kind(
            f"{least if attainable < 1.0 else 'no tol can be kept'} for these points and strengths "
            f"({why}), got {self._search.tolerance:g}"
        )

    @cached_property
    def _walks(self) -> list[_Candidate]:
        """Direct sums and treecodes, with the errors of the model."""
        return [offer for b in self._search.backends if b in WALKS for offer in self._offers(b)]

    def _offers(self, backend: str) -> Iterator[_Candidate]:
        if backend == "direct":
            pairs = self._sources.shape[1] * self._targets.shape[1]
            for precision in PRECISIONS:
                seconds = self._model.seconds("direct", precision, [pairs])
                choice = Choice("direct", precision=precision)
                yield _Candidate(choice, seconds, self._rounding[precision])
        else:
            yield from self._treecodes(backend)

    def _treecodes(self, backend: str) -> Iterator[_Candidate]:
        """Yield treecodes, with pairs counted for the pilots in a tree of some of the sources."""
        search = self._search
        leaf_sizes = LEAF_SIZES if search.leaf_size is None else (search.leaf_size,)
        every = -(-self._sources.shape[1] // _COUNTED)
        sample = self._sources[:, ::every].copy()
        tree, _ = WALKS[backend].build(sample, max(1, leaf_sizes[0] // every))
        count = self._targets.shape[1]
        even = self._targets[:, np.random.default_rng(0).permutation(count)[:_PILOTS]]
        more = count / even.shape[1]
        degrees = np.array(DEGREES[backend])
        terms = count_terms(backend, degrees)
        for theta in THETAS if search.theta is None else (search.theta,):
            cut_off = self._scale * self._model.error(backend, theta, degrees)
            met = meet(tree, even, theta)
            for leaf_size in leaf_sizes:
                near, accepted = count_pairs(met, leaf_size / every, terms / every)
                work = [
                    more * every * near,
                    more * accepted * terms,
                    more * accepted,
                    self._sources.shape[1] * terms,
                    self._sources.shape[1] + self._targets.shape[1],
                ]
                for precision in PRECISIONS:
                    seconds = self._model.seconds(backend, precision, work)
                    error = cut_off + self._rounding[precision]
                    for row in zip(degrees.tolist(), seconds, error, strict=True):
                        choice = Choice(backend, theta, row[0], leaf_size, precision)
                        yield _Candidate(choice, *row[1:])

    def _multipole(self) -> _Candidate:
        """Return the fast multipole method at the largest tolerance that should do.

        By name it is first expected to reach what it is asked for.
        """
        asked = self._search.tolerance
        smaller = tuple(tol for tol in TOLERANCES if tol < asked)
        for tol in (asked, *smaller) if self._named else TOLERANCES:
            error = tol if self._named else self._scale * self._model.multipole_error(tol)
            choice = Choice("fmm", leaf_size=self._search.leaf_size, tol=tol)
            offer = self._expected(_Candidate(choice, math.inf, error))
            if offer.error <= asked:
                choice, seconds = self._priced(tol)
                return offer._replace(choice=choice, seconds=seconds)
        return offer

    def _priced(self, tol: float) -> tuple[Choice, float]:
        """Return the fast multipole method with the side of its root, and its seconds."""
        if tol not in self._prices:
            leaf_size = self._search.leaf_size
            multipole = Multipole(self._search.kernel, tol, leaf_size=leaf_size)
            work = multipole.work(
                self._sources, None if self._targets is self._sources else self._targets
            )
            seconds = self._model.seconds("fmm", precision_for(tol), work.amounts)
            seconds += self._model.building_seconds(tol, work.sizes) / self._search.sums
            choice = Choice("fmm", leaf_size=leaf_size, tol=tol, width=multipole.width)
            self._prices[tol] = choice, seconds
        return self._prices[tol]


def _kind(choice: Choice) -> tuple[str, str | None]:
    """Return what sums have in common whose errors compare alike with the model."""
    return choice.backend, choice.precision


class Meetings(NamedTuple):
    """Clusters that targets meet on their way down a tree.

    Attributes
    ----------
    size, above : (n,) int64
        Sources in the cluster and in its parent.
    far, last : (n,) bool
        Whether it is far enough for its expansion, and whether it has no children.
    """

    size: np.ndarray
    above: np.ndarray
    far: np.ndarray
    last: np.ndarray


def meet(tree: Tree, targets: np.ndarray, theta: float) -> Meetings:
    """Walk down a tree of sources with all targets, (3, T), a level at a time."""
    distance2 = acceptance(tree, theta)
    who = np.arange(targets.shape[1])
    cluster = np.zeros_like(who)
    above = np.full_like(who, np.iinfo(who.dtype).max)
    levels = []
    while len(who):
        size = tree.stop[cluster] - tree.start[cluster]
        far = ((targets[:, who] - tree.center[:, cluster]) ** 2).sum(axis=0) >= distance2[cluster]
        last = tree.children[cluster] == 0
        levels.append(Meetings(size, above, far, last))
        on = ~far & ~last
        count = tree.children[cluster[on]]
        number = np.arange(count.sum()) - np.repeat(count.cumsum() - count, count)
        who, above = np.repeat(who[on], count), np.repeat(size[on], count)
        cluster = np.repeat(tree.child[cluster[on]], count) + number
    return Meetings(*map(np.concatenate, zip(*levels, strict=True)))


def count_pairs(
    met: Meetings, leaf_size: float, terms: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return pairs near and expansions evaluated, for leaves and terms of an expansion."""
    in_tree = met.above > leaf_size
    leaf = in_tree & ~met.far & (met.last | (met.size <= leaf_size))
    far = np.sort(met.size[in_tree & met.far])
    summed = np.searchsorted(far, terms, side="right")  # where points are fewer than terms
    near = met.size[leaf].sum() + np.append(0, far.cumsum())[summed]
    return near, len(far) - summed


def count_terms(backend: str, degree: np.ndarray) -> np.ndarray:
    """Return the terms of an expansion."""
    if backend == "kitc":
        return (degree + 1) ** 3
    return (degree + 1) * (degree + 2) * (degree + 3) // 6


class Model:
    """Seconds on one thread, and errors in units of that of `PROBE`, of one kernel.

    Attributes
    ----------
    usual_error : float
        Of `PROBE`, for random strengths in a cube.
    """

    def __init__(self, fitted: dict[str, Any]) -> None:
        self._fitted = fitted
        self.usual_error = fitted["probe"]

    def seconds(self, backend: str, precision: str, work: list[Any]) -> Any:
        """Return how long `work` takes.

        Pairs near, of which direct sums have no others; of a treecode pairs far, expansions
        evaluated, sources times terms, and points; of "fmm" see `multipole.Work`.
        """
        rates = self._fitted[backend]["seconds"][precision]
        return sum(rate * amount for rate, amount in zip(rates, work, strict=True))

    def error(self, backend: str, theta: float, degree: Any) -> Any:
        """Return the error of a treecode."""
        fitted = self._fitted[backend]
        offset, slope = (np.interp(theta, THETAS, fitted[name]) for name in ("offset", "slope"))
        return 10.0 ** (offset + slope * degree)

    def building_seconds(self, tol: float, sizes: int) -> float:
        """Return how long the operators of "fmm" take to build, for cubes of some sizes."""
        fitted = self._fitted["fmm"]
        offset, slope = fitted["build"]
        return float(10.0 ** (offset + slope * math.log10(tol))) * (sizes if fitted["each"] else 1)

    def multipole_error(self, tol: float) -> float:
        """Return the error of "fmm"."""
        offset, slope = self._fitted["fmm"]["error"]
        return float(10.0 ** (offset + slope * math.log10(tol)))


@cache
def _costs() -> dict[str, Any]:
    return dict(json.loads(Path(__file__).with_name("costs.json").read_text()))


def model(kernel: Kernel) -> Model:
    """Return the model of a kernel; of a user's own that of the one most like it in size."""
    size = kernel.weight_size * kernel.value_size
    fitted = _costs()
    alike = min(fitted, key=lambda name: abs(math.log(fitted[name]["size"] / size)))
    return Model(fitted.get(type(kernel).__name__, fitted[alike]))
