"""The search for the cheapest sum that reaches a tolerance, among those that methods offer."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from treecode.accuracy import Parts
from treecode.boundaries.base import free
from treecode.choice.probe import Probe
from treecode.choice.refusals import ToleranceError
from treecode.choice.sampling import sampled_error
from treecode.kernels.base import Kernel
from treecode.methods.base import Method, Offer, Sum
from treecode.methods.direct import EXACT
from treecode.methods.registry import Choice
from treecode.ranks import OneRank
from treecode.shared_sum import made

FEW = 100_000_000  # pairs: a tenth of a second in all, for which no choice is made
_SAMPLES = 400  # targets at which a sum that was made is looked at
_SUMS = 300  # that share the work done once, and the choice
_CHEAPER = 0.9  # of the seconds of a sum that will do, below which another is tried


class _Candidate(NamedTuple):
    """An offer of a method."""

    method: Method
    offer: Offer

    @property
    def choice(self) -> Choice:
        return Choice(self.method.name, **self.offer.parameters)


@dataclass
class Search:
    """The search for the cheapest sum that reaches a tolerance.

    Parameters
    ----------
    kernel : Kernel
    methods : tuple of Method
        To choose from.
    tol : float
        Relative error, K eq. (8.1), of each of the `accuracy.Parts`.
    given : mapping, optional
        Parameters that are not to be chosen.
    progress : bool, optional
    sums : int, optional
        Number of sums that share the work done once for all of them, and the choice.
    ranks : OneRank, optional
        Those that make the sums together.
    """

    kernel: Kernel
    methods: tuple[Method, ...]
    tol: float
    given: Mapping[str, Any] = field(default_factory=dict)
    progress: bool = False
    sums: int = _SUMS
    ranks: OneRank = field(default_factory=OneRank)

    def __call__(
        self,
        sources: np.ndarray,
        targets: np.ndarray | None,
        strengths: np.ndarray,
        parts: Parts,
    ) -> tuple[Choice, Sum, np.ndarray]:
        """Return the choice for points (3, N) and (3, M), its sum, and the values that it gave.

        Raises
        ------
        ToleranceError
            With the tolerance that can be had.
        """
        everywhere = sources if targets is None else targets
        case = Probe(
            self.kernel, sources, everywhere, strengths, parts, self.tol, self.sums, self.ranks
        )
        if self._takes_no_time(sources, everywhere):
            exact = self._make(EXACT, sources, targets)
            return EXACT, exact, exact.execute(strengths)
        tried: set[Choice] = set()
        good, limit = None, math.inf
        while limit > 0.0 and (best := self._cheapest(case, tried, limit)):
            choice = best.choice
            tried.add(choice)
            sum_ = self._made_or_refused(choice, sources, targets)
            if sum_ is None:
                case.learn(best.method.name, best.offer, math.inf)
                continue
            values = sum_.execute(strengths)
            if choice == EXACT:
                return choice, sum_, values
            bound = self.bound(sum_, strengths, values, parts)
            if good:  # at all targets, of which a few may carry the error
                bound = max(bound, float(parts.difference(values, good[2]).max()))
            case.learn(best.method.name, best.offer, bound)
            if bound <= self.tol:
                good = choice, sum_, values
                limit = _CHEAPER * best.offer.seconds * (self.sums > 1)
        assert good is not None  # else `_cheapest` refuses
        return good

    def bound(self, sum_: Sum, strengths: np.ndarray, values: np.ndarray, parts: Parts) -> float:
        """Return a bound that the error of a sum that gave `values` hardly exceeds."""
        error = sampled_error(
            self.kernel, sum_, strengths, values, parts, _SAMPLES, ranks=self.ranks
        )
        return self.ranks.first(error.bound)

    def _takes_no_time(self, sources: np.ndarray, targets: np.ndarray) -> bool:
        """Tell whether all sums together are so little that they are made directly, by pairs."""
        if not hasattr(free(self.kernel), "pair"):
            return False
        pairs = sources.shape[1] * targets.shape[1] * self.sums
        return pairs <= FEW and any(method.name == EXACT.backend for method in self.methods)

    def _make(self, choice: Choice, sources: np.ndarray, targets: np.ndarray | None) -> Sum:
        """Return a sum over copies of the points."""
        sum_ = made(choice, self.kernel, self.ranks, self.progress)
        sum_.set_points(sources.copy(), None if targets is None else targets.copy())
        return sum_

    def _made_or_refused(
        self, choice: Choice, sources: np.ndarray, targets: np.ndarray | None
    ) -> Sum | None:
        """Return a sum; None if it does not take the kernel, or does not fit in memory.

        The only method there is says so itself.
        """
        try:
            with self.ranks.together():
                return self._make(choice, sources, targets)
        except ValueError:
            if len(self.methods) == 1:
                raise
            return None

    def _offers(self, case: Probe) -> Iterator[_Candidate]:
        for method in self.methods:
            for offer in method.offers(case, self.given):
                yield _Candidate(method, offer)

    def _cheapest(self, case: Probe, tried: set[Choice], below: float) -> _Candidate | None:
        """Return the cheapest untried offer that should reach the tolerance.

        None if there is none in less than `below` seconds; an error if there is none at all.
        """
        best, least = None, math.inf
        for candidate in self._offers(case):
            name, offer = candidate.method.name, candidate.offer
            least = min(least, case.expected_error(name, offer))
            cheaper = offer.seconds < (below if best is None else best.offer.seconds)
            if cheaper and case.will_do(name, offer) and candidate.choice not in tried:
                best = candidate
        if best is None and below == math.inf:
            by = " or ".join(repr(method.name) for method in self.methods)
            raise ToleranceError.of(self.tol, least, f"by {by}")
        return best
