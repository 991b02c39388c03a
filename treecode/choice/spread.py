"""The search for a tolerance that is kept, where no rank has all points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from treecode.accuracy import Parts
from treecode.choice.refusals import ToleranceError
from treecode.choice.search import Search
from treecode.methods.base import Sum
from treecode.methods.registry import Choice
from treecode.shared_sum import spread

_FINEST = 1e-13  # tolerance that a method takes
_CLOSER = 0.5  # part of the tolerance that is aimed at, by the error seen,
_AT_MOST = 0.3  # and of the one that was aimed at before


@dataclass
class SpreadSearch(Search):
    """The search for a tolerance of the one method given that keeps `tol`; see `Search`."""

    def __call__(
        self,
        sources: np.ndarray,
        targets: np.ndarray | None,
        strengths: np.ndarray,
        parts: Parts,
    ) -> tuple[Choice, Sum, np.ndarray]:
        """Return the choice for own points (3, N) and (3, M), its sum, and the values it gave.

        Raises
        ------
        ToleranceError
            With the tolerance that can be had.
        """
        (method,) = self.methods
        aimed, least = self.tol, np.inf
        while aimed >= _FINEST:
            choice = Choice(method.name, **method.complete({**self.given, "tol": aimed}))
            sum_ = spread(choice, self.kernel, self.ranks, self.progress)
            sum_.set_points(sources, targets)
            values = sum_.execute(strengths)
            bound = self.bound(sum_, strengths, values, parts)
            if bound <= self.tol:
                return choice, sum_, values
            least = min(least, bound)
            aimed *= min(_AT_MOST, _CLOSER * self.tol / bound)
        raise ToleranceError.of(self.tol, least, f"by {method.name!r}")
