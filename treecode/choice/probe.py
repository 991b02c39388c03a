"""Measurements at a few targets before a sum is made, and lessons of samples after it."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping
from functools import cached_property
from typing import Any

import numpy as np

from treecode.accuracy import Parts, largest, ratio
from treecode.boundaries.base import Term, free
from treecode.choice.model import Model
from treecode.choice.refusals import CancellationError
from treecode.choice.sampling import direct_sum
from treecode.methods import kitc
from treecode.methods.base import PRECISIONS, Offer
from treecode.methods.direct import EXACT
from treecode.methods.registry import Choice
from treecode.ranks import OneRank
from treecode.shared_sum import made

# Takes any kernel, is quick, and is far enough off for its error to be seen. The errors of the
# model are in units of its error: another probe asks for another fit.
PROBE = Choice(kitc.NAME, theta=0.7, degree=3, leaf_size=500)

_SINGLE = Choice(EXACT.backend, precision=PRECISIONS[1])

_PILOTS = 64  # targets at which errors are looked at before a sum,
_FEW_PILOTS = 16  # more if fewer than so many would be of a group
_MARGIN = 1.25  # by which errors may be larger than expected
_LEAST = 0.1  # of an expected error: a sum that has hardly a far field tells nothing of others
_SINGLE_UNIT = 2.0**-24  # error of singles where it does not show at the pilots
_ERRORS = "error", "offset", "slope"  # keys of the fitted model that tell errors, not costs
_ROUNDING = 100 * 2.0**-53  # of direct sums, relative to sums of such terms that do not cancel


class Probe:
    """Points and strengths for which methods offer sums: their `methods.base.Case`.

    Parameters
    ----------
    kernel : Kernel
    sources, targets : (3, N) and (3, M) float64
        One array if the targets are the sources.
    strengths : (N, strength_size) float64
    parts : Parts
    tol : float
    sums : int
        See `methods.base.Case`.
    ranks : OneRank
        That make the sums together.

    Raises
    ------
    CancellationError
        If direct sums do not keep the tolerance.
    """

    def __init__(
        self,
        kernel: Any,
        sources: np.ndarray,
        targets: np.ndarray,
        strengths: np.ndarray,
        parts: Parts,
        tol: float,
        sums: int,
        ranks: OneRank,
    ) -> None:
        self.kernel, self.sources, self.targets = kernel, sources, targets
        self.tol, self.sums, self._ranks = tol, sums, ranks
        self.memory: dict[str, Any] = {}
        self._strengths, self._parts, self._model = strengths, parts, Model(free(kernel))
        self._misses: dict[tuple[str, str], float] = defaultdict(lambda: 1.0)
        self._drawn = parts.draw(_PILOTS, _FEW_PILOTS)
        self._pilots = targets[:, self._drawn]
        self._exact = self._require_digits()

    def _require_digits(self) -> np.ndarray:
        """Return direct sums at the pilots; refuse a tolerance beyond their rounding.

        If every source is taken or left by chance, twice the sum differs from the sum of all as
        if signs were random: by the size of sums that do not cancel.
        """
        strengths = self._strengths
        sum_ = direct_sum(self.kernel, self.sources, self._pilots.copy(), self._ranks)
        exact = sum_.execute(strengths)
        peak = largest(exact)
        rng, spread = np.random.default_rng(0), np.zeros(())
        for _ in range(8 if len(strengths) <= _PILOTS else 1):  # few may all be taken
            taken = rng.integers(0, 2, (len(strengths), 1)) * strengths
            random = (2.0 * sum_.execute(taken) - exact) / peak
            spread = np.maximum(spread, self._parts.squares(random, self._drawn))
        size = self._parts.squares(exact / peak, self._drawn)
        loss = float(ratio(spread * (size > 0.0), size).max(initial=0.0))
        loss = self._ranks.first(loss)
        if _ROUNDING * loss > self.tol:
            why = f"contributions cancel to {1.0 / loss:.1g} of their size"
            raise CancellationError.of(self.tol, _ROUNDING * loss, why)
        return exact

    def error_of(self, choice: Choice) -> float:
        """Return the error of a sum at the pilots."""
        sum_ = made(choice, self.kernel, self._ranks)
        sum_.set_points(self.sources.copy(), self._pilots.copy())
        values = sum_.execute(self._strengths)
        if not np.isfinite(values).all():  # beyond the range of singles
            return math.inf
        error = float(self._parts.difference(values, self._exact, self._drawn).max())
        return self._ranks.first(error)

    def of_terms(self) -> list[_Term]:
        """Return a case for each term of a kernel within a boundary."""
        return self._terms

    @cached_property
    def _terms(self) -> list[_Term]:
        same = self.targets is self.sources
        points = self.sources.T, None if same else self.targets.T
        return [_Term(self, term, *term.columns_of(*points)) for term in self.kernel.terms]

    @cached_property
    def scale(self) -> float:
        """By how much errors are larger here than the model says."""
        return _MARGIN * (self.error_of(PROBE) or self._model.usual_error)

    @cached_property
    def rounding(self) -> Mapping[str, float]:
        """Error of each precision by rounding; the error of doubles does not count."""
        single = _MARGIN * (self.error_of(_SINGLE) or _SINGLE_UNIT)
        return dict(zip(PRECISIONS, (0.0, single), strict=True))

    def fitted(self, name: str) -> dict[str, Any] | None:
        """Return the numbers fitted to a method's costs and errors; None where there are none."""
        return self._model.fitted(name)

    def expected_error(self, name: str, offer: Offer) -> float:
        """Return the error of an offer of a method, corrected by the samples so far."""
        return self._misses[name, offer.kind] * offer.error

    def will_do(self, name: str, offer: Offer) -> bool:
        """Tell whether an offer should keep the tolerance."""
        return self.expected_error(name, offer) <= self.tol

    def learn(self, name: str, offer: Offer, bound: float) -> None:
        """Expect sums of the same kind to miss by as much as a sample of one has shown."""
        expected = self.expected_error(name, offer)
        miss = bound / expected if expected > 0.0 else math.inf
        self._misses[name, offer.kind] *= max(miss, _LEAST)


class _Term:
    """One term of a case within a boundary, as methods see it.

    Parameters
    ----------
    whole : Probe
    term : Term
    sources, targets : (3, n) and (3, M) float64
        Of the term; targets are None if they are the sources.
    """

    def __init__(
        self, whole: Probe, term: Term, sources: np.ndarray, targets: np.ndarray | None
    ) -> None:
        self._whole, self._model = whole, Model(term.kernel)
        self.kernel, self.tol, self.sums = term.kernel, whole.tol, whole.sums
        self.sources, self.targets = sources, sources if targets is None else targets
        self.memory: dict[str, Any] = {}

    @property
    def scale(self) -> float:
        return self._whole.scale

    @property
    def rounding(self) -> Mapping[str, float]:
        return self._whole.rounding

    def fitted(self, name: str) -> dict[str, Any] | None:
        """Return the costs of this kernel, and the errors of that in free space."""
        costs, errors = self._model.fitted(name), self._whole.fitted(name)
        if costs is None or errors is None:
            return None
        return {**costs, **{key: errors[key] for key in _ERRORS if key in errors}}

    def will_do(self, name: str, offer: Offer) -> bool:
        return self._whole.will_do(name, offer)

    def of_terms(self) -> list[_Term]:
        return [self]
