"""Near images and waves as a method: its parameters, and its offers for a tolerance."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from functools import partial
from typing import Any, ClassVar

from treecode import check
from treecode.kernels.base import Kernel
from treecode.kernels.periodic import PeriodicKernel
from treecode.methods import fmm
from treecode.methods.base import KEYWORDS, Case, Method, Offer, Parameter
from treecode.methods.images.arrangement import arrange
from treecode.methods.images.summation import NearImages

NAME = "images"


class ImagesMethod(Method):
    """Periodic sums of regularized kernels, which take a tolerance themselves.

    `xi` is the splitting parameter, an inverse length, and `width` the side of the root of the
    octree of the free sum. They depend on points that were set before.
    """

    name = NAME
    parameters: ClassVar = {
        "tol": KEYWORDS["tol"],
        "width": fmm.METHOD.parameters["width"],
        "xi": Parameter(partial(check.number, low=0.0, high=math.inf)),
    }
    members = ("strength_size", "weight_size", "value_size", "weights", "free", "cell")
    any_kernel = False

    def refuse(self, given: Mapping[str, Any]) -> None:
        """Refuse a precision."""
        precision = given.get("precision")
        check.absent(f"with backend {NAME!r}, where tol decides", precision=precision)

    def seeks(self, given: Mapping[str, Any]) -> bool:
        """Return True: a tolerance is kept."""
        return True

    def make(
        self, kernel: Kernel, parameters: Mapping[str, Any], progress: bool = False
    ) -> NearImages:
        """Return a sum without points."""
        assert isinstance(kernel, PeriodicKernel), "see `members`"
        return NearImages(kernel, parameters, progress)

    def describe(self, parameters: Mapping[str, Any]) -> str:
        """Return the name with the tolerance."""
        return f"{self.name}({parameters['tol']:.2g})"

    def offers(self, case: Case, given: Mapping[str, Any]) -> Iterator[Offer]:
        """Yield the sum of the largest tolerance that should do, or else of the smallest.

        Unless it is named, it takes tolerances for which the free sum has few operators.
        """
        fitted = case.fitted(fmm.NAME)
        tolerances = [tol for tol in fmm.TOLERANCES if tol <= case.tol]
        if "tol" in given:
            tolerances.insert(0, case.tol)
        if fitted is None or not tolerances:
            return
        for tol in tolerances:
            offer = Offer({"tol": tol}, tol, math.inf)
            if case.will_do(self.name, offer):
                yield self._priced(case, offer, fitted)
                return
        yield offer

    def _priced(self, case: Case, offer: Offer, fitted: Mapping[str, Any]) -> Offer:
        """Return an offer with what it depends on, and its seconds; once for each tolerance."""
        known = case.memory.setdefault(self.name, {})
        tol = offer.parameters["tol"]
        if tol not in known:
            assert isinstance(case.kernel, PeriodicKernel), "see `members`"
            parts = arrange(case.kernel, case.sources, case.targets, tol)
            width, seconds = fmm.METHOD.price(
                case.kernel.free, offer.parameters, *parts.free_points(), fitted, case.sums
            )
            known[tol] = (
                {"tol": tol, "width": width, "xi": parts.split.xi / parts.unit},
                seconds + parts.seconds,
            )
        parameters, seconds = known[tol]
        return offer._replace(parameters=parameters, seconds=seconds)


METHOD = ImagesMethod()
