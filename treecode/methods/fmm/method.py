"""The fast multipole method as others see it: its parameters, and its offers for a tolerance."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from functools import partial
from typing import Any, ClassVar

import numpy as np

from treecode import check
from treecode.kernels.base import Kernel
from treecode.methods.base import KEYWORDS, Case, Method, Offer, Parameter
from treecode.methods.fmm.bases import MAX_DEGREE
from treecode.methods.fmm.distributed import DistributedFastMultipole
from treecode.methods.fmm.sizing import precision_for
from treecode.methods.fmm.summation import FastMultipole
from treecode.ranks import OneRank

NAME = "fmm"
TOLERANCES = tuple(10.0 ** (-0.5 * k) for k in range(1, 26))  # few operators serve many cases


class FastMultipoleMethod(Method):
    """The fast multipole method for isotropic kernels, which takes a tolerance itself.

    `width` is the side of the root of its octree, and `pieces` are where the pieces of the curve
    begin that ranks have. They depend on points that were set before.
    """

    name = NAME
    parameters: ClassVar = {
        "degree": Parameter(partial(check.integer, low=1, high=MAX_DEGREE)),
        "leaf_size": KEYWORDS["leaf_size"]._replace(default=None, required=False),
        "tol": KEYWORDS["tol"],
        "pieces": Parameter(check.hexadecimals),
        "width": Parameter(partial(check.number, low=0.0, high=math.inf, low_inclusive=True)),
    }
    any_kernel = False

    def refuse(self, given: Mapping[str, Any]) -> None:
        """Refuse a precision."""
        precision = given.get("precision")
        check.absent(f"with backend {NAME!r}, where tol decides", precision=precision)

    def seeks(self, given: Mapping[str, Any]) -> bool:
        """Tell whether no degree is given, beside which `tol` is only aimed at."""
        return "degree" not in given

    def make(
        self, kernel: Kernel, parameters: Mapping[str, Any], progress: bool = False
    ) -> FastMultipole:
        """Return a sum without points."""
        return FastMultipole(kernel, parameters, progress)

    def across(
        self, kernel: Kernel, parameters: Mapping[str, Any], ranks: OneRank, progress: bool = False
    ) -> DistributedFastMultipole:
        """Return a sum without points of which each rank has some."""
        return DistributedFastMultipole(kernel, parameters, progress, ranks)

    def describe(self, parameters: Mapping[str, Any]) -> str:
        """Return the name with the tolerance."""
        return f"{self.name}({parameters['tol']:.2g})"

    def offers(self, case: Case, given: Mapping[str, Any]) -> Iterator[Offer]:
        """Yield the sum of the largest tolerance that should do, or else of the smallest.

        By name it is first expected to reach what it is asked for.
        """
        fitted = case.fitted(self.name)
        if fitted is None:
            return
        by_name = "tol" in given
        smaller = tuple(tol for tol in TOLERANCES if tol < case.tol)
        for tol in (case.tol, *smaller) if by_name else TOLERANCES:
            error = tol if by_name else case.scale * self.expected_error(fitted, tol)
            parameters = {"tol": tol}
            if "leaf_size" in given:
                parameters["leaf_size"] = given["leaf_size"]
            offer = Offer(parameters, error, math.inf)
            if case.will_do(self.name, offer):
                yield self._priced(case, offer, fitted)
                return
        yield offer

    def expected_error(self, fitted: Mapping[str, Any], tol: float) -> float:
        """Return the fitted error, in units of that of the probe."""
        offset, slope = fitted["error"]
        return float(10.0 ** (offset + slope * math.log10(tol)))

    def building_seconds(self, fitted: Mapping[str, Any], tol: float, sizes: int) -> float:
        """Return how long operators take to build, for cubes of some sizes."""
        offset, slope = fitted["build"]
        return float(10.0 ** (offset + slope * math.log10(tol))) * (sizes if fitted["each"] else 1)

    def amounts(
        self, sum_: FastMultipole, sources: np.ndarray, targets: np.ndarray
    ) -> tuple[list[float], int]:
        """Return what a sum takes, for which seconds are fitted, and how many sizes of cubes.

        Near pairs, cubes in near pairs, points, and points times what an expansion takes for each,
        in proportion to the third power of the digits. Targets are the same array as sources if
        they are not apart.
        """
        pairs, cubes, sizes = sum_.work(sources, None if targets is sources else targets)
        # Points that are sources and targets are expanded, and expansions evaluated there.
        count = sources.shape[1] + targets.shape[1]
        return [pairs, cubes, count, -count * math.log10(sum_.tol) ** 3], sizes

    def price(
        self,
        kernel: Kernel,
        parameters: Mapping[str, Any],
        sources: np.ndarray,
        targets: np.ndarray | None,
        fitted: Mapping[str, Any],
        sums: int,
    ) -> tuple[float, float]:
        """Return the side of the root, and the seconds of each of so many sums.

        Sources and targets are (3, N), and (3, M) or None if they are the sources.
        """
        sum_ = FastMultipole(kernel, parameters, False)
        amounts, sizes = self.amounts(sum_, sources, sources if targets is None else targets)
        rates = fitted["seconds"][precision_for(sum_.tol)]
        seconds = sum(rate * amount for rate, amount in zip(rates, amounts, strict=True))
        return sum_.width, seconds + self.building_seconds(fitted, sum_.tol, sizes) / sums

    def _priced(self, case: Case, offer: Offer, fitted: Mapping[str, Any]) -> Offer:
        """Return an offer with the side of the root, and its seconds; once for each tolerance."""
        known = case.memory.setdefault(self.name, {})
        tol = offer.parameters["tol"]
        if tol not in known:
            apart = None if case.targets is case.sources else case.targets
            points = case.sources, apart
            width, seconds = self.price(case.kernel, offer.parameters, *points, fitted, case.sums)
            known[tol] = {**offer.parameters, "width": width}, seconds
        parameters, seconds = known[tol]
        return offer._replace(parameters=parameters, seconds=seconds)


METHOD = FastMultipoleMethod()
