"""Near images and waves as a method: its parameters, and its offers for a tolerance."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any, ClassVar

from treecode.kernels.base import Kernel
from treecode.kernels.periodic import PeriodicKernel
from treecode.methods import fmm
from treecode.methods.base import Case, Offer, Sum
from treecode.methods.ewald.method import EwaldMethod
from treecode.methods.images.arrangement import arrange
from treecode.methods.images.summation import NearImages

NAME = "images"


class ImagesMethod(EwaldMethod):
    """The same sums by the same split, of which near images are summed in free space.

    `width` is the side of the root of the octree of the free sum. It depends on points that were
    set before.
    """

    name = NAME
    parameters: ClassVar = {
        "tol": EwaldMethod.parameters["tol"],
        "width": fmm.METHOD.parameters["width"],
        "xi": EwaldMethod.parameters["xi"],
    }

    def make(self, kernel: Kernel, parameters: Mapping[str, Any], progress: bool = False) -> Sum:
        """Return a sum without points."""
        assert isinstance(kernel, PeriodicKernel), "see `members`"
        return NearImages(kernel, parameters, progress)

    def offers(self, case: Case, given: Mapping[str, Any]) -> Iterator[Offer]:
        """Yield the sum of the largest tolerance that should do, or else of the smallest.

        Unless it is named, it takes tolerances for which the free sum has few operators.
        """
        tolerances = [tol for tol in fmm.TOLERANCES if tol <= case.tol]
        if "tol" in given:
            tolerances.insert(0, case.tol)
        if case.fitted(fmm.NAME) is None or not tolerances:
            return
        for tol in tolerances:
            offer = Offer({"tol": tol}, tol, math.inf)
            if case.will_do(self.name, offer):
                yield self._priced(case, offer)
                return
        yield offer

    def _split(self, case: Case, tol: float) -> tuple[dict[str, Any], float]:
        """Return the parameters of the split that should cost least, and its seconds."""
        assert isinstance(case.kernel, PeriodicKernel), "see `members`"
        fitted = case.fitted(fmm.NAME)
        assert fitted is not None, "see `offers`"
        parts = arrange(case.kernel, case.sources, case.targets, tol)
        width, seconds = fmm.METHOD.price(
            case.kernel.free, {"tol": tol}, *parts.free_points(), fitted, case.sums
        )
        parameters = {"tol": tol, "width": width, "xi": parts.split.xi / parts.unit}
        return parameters, seconds + parts.seconds


METHOD = ImagesMethod()
