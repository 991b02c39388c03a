"""Ewald's method as others see it: its parameters, and its offers for a tolerance."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from functools import partial
from typing import Any, ClassVar

from treecode import check
from treecode.kernels.base import Kernel
from treecode.kernels.periodic import PeriodicKernel
from treecode.methods.base import KEYWORDS, Case, Method, Offer, Parameter, Sum
from treecode.methods.ewald.cells import crowding
from treecode.methods.ewald.slab import span_of
from treecode.methods.ewald.summation import Ewald, scaled_task
from treecode.methods.ewald.tuning import Task, cheapest_split, seconds_of
from treecode.ranks import OneRank

NAME = "ewald"
EXACT = 1e-15  # nothing is more accurate
_FINER = tuple(10.0 ** (-0.5 * n) for n in range(1, 7))  # times a tolerance that is not kept


class EwaldMethod(Method):
    """Periodic sums of regularized kernels, which take a tolerance themselves.

    `xi` is the splitting parameter, an inverse length. It depends on points that were set before.
    """

    name = NAME
    parameters: ClassVar = {
        "tol": KEYWORDS["tol"],
        "xi": Parameter(partial(check.number, low=0.0, high=math.inf)),
    }
    members = ("strength_size", "weight_size", "value_size", "weights", "free", "cell")
    any_kernel = False

    def refuse(self, given: Mapping[str, Any]) -> None:
        """Refuse a precision."""
        precision = given.get("precision")
        check.absent(f"with backend {self.name!r}, where tol decides", precision=precision)

    def seeks(self, given: Mapping[str, Any]) -> bool:
        """Return True: a tolerance is kept."""
        return True

    def make(self, kernel: Kernel, parameters: Mapping[str, Any], progress: bool = False) -> Sum:
        """Return a sum without points."""
        assert isinstance(kernel, PeriodicKernel), "see `members`"
        return Ewald(kernel, parameters, progress)

    def describe(self, parameters: Mapping[str, Any]) -> str:
        """Return the name with the tolerance."""
        return f"{self.name}({parameters['tol']:.2g})"

    def offers(self, case: Case, given: Mapping[str, Any]) -> Iterator[Offer]:
        """Yield the sum of the largest tolerance that should do, or else of the smallest."""
        for tol in (case.tol, *(case.tol * finer for finer in _FINER)):
            offer = Offer({"tol": max(tol, EXACT)}, tol, math.inf)
            if case.will_do(self.name, offer):
                yield self._priced(case, offer)
                return
        yield offer

    def _priced(self, case: Case, offer: Offer) -> Offer:
        """Return an offer with what depends on the points, and seconds; once a tolerance."""
        known = case.memory.setdefault(self.name, {})
        tol = offer.parameters["tol"]
        if tol not in known:
            known[tol] = self._split(case, tol)
        parameters, seconds = known[tol]
        return offer._replace(parameters=parameters, seconds=seconds)

    def _split(self, case: Case, tol: float) -> tuple[dict[str, Any], float]:
        """Return the parameters of the split that should cost least, and its seconds."""
        unit, task = _task_of(case, tol)
        apart = None if case.targets is case.sources else case.targets / unit
        crowded = crowding(task.vectors, case.sources / unit, apart)
        split = cheapest_split(task, crowded)
        seconds = sum(seconds_of(task, split, crowded(split.distance)))
        return {"tol": tol, "xi": split.xi / unit}, seconds


def _task_of(case: Case, tol: float) -> tuple[float, Task]:
    """Return the edge of a cube as large as the cell, and the sum in units of it."""
    assert isinstance(case.kernel, PeriodicKernel), "see `members`"
    counts = case.sources.shape[1], case.targets.shape[1]
    return scaled_task(case.kernel, *counts, tol, span_of([case.sources, case.targets], OneRank()))


METHOD = EwaldMethod()


class ExactSum(Ewald):
    """A sum to rounding, which is the same for as many points anywhere.

    Parameters
    ----------
    kernel : PeriodicKernel
    parameters : mapping
        Of the method that stands for such sums, which have none.
    progress : bool
    """

    def __init__(
        self, kernel: PeriodicKernel, parameters: Mapping[str, Any], progress: bool
    ) -> None:
        super().__init__(kernel, {"tol": EXACT}, progress, evenly=True)
        self._named = dict(parameters)

    @property
    def parameters(self) -> dict[str, Any]:
        """Those of the method."""
        return self._named


def exact_seconds(case: Case) -> float:
    """Return what a sum to rounding takes."""
    _, task = _task_of(case, EXACT)
    return sum(seconds_of(task, cheapest_split(task)))
