"""Direct summation: the treecode whose root is a leaf that no target is far from.

A lattice sum is none over pairs: of a periodic kernel it is Ewald's sum, to rounding.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, ClassVar, NamedTuple

import numpy as np

from treecode.kernels.base import Kernel
from treecode.kernels.periodic import PeriodicKernel
from treecode.methods import ewald
from treecode.methods.base import KEYWORDS, PRECISIONS, Case, Offer, Sum
from treecode.methods.registry import Choice
from treecode.methods.walk import WalkMethod
from treecode.tree import Tree, build_tree

NAME = "direct"
# Nothing is more accurate: with this all errors are measured.
EXACT = Choice(NAME, precision="float64")


class NoExpansion(NamedTuple):
    """Stands where the treecodes have an expansion."""

    def holds(self, cluster):
        return False

    def approximate(self, kernel, tree, cluster, targets, first, last, out):
        pass

    def terms(self):
        return 0


class DirectSummation(WalkMethod):
    """The sum over all pairs."""

    name = NAME
    parameters: ClassVar = {"precision": KEYWORDS["precision"]}

    def takes(self, kernel: Kernel) -> bool:
        """Tell whether a kernel is one of pairs, or periodic."""
        return isinstance(kernel, PeriodicKernel) or super().takes(kernel)

    def make(self, kernel: Kernel, parameters: Mapping[str, Any], progress: bool = False) -> Sum:
        """Return a sum without points."""
        if isinstance(kernel, PeriodicKernel):
            return ewald.ExactSum(kernel, parameters, progress)
        return super().make(kernel, parameters, progress)

    def seeks(self, given: Mapping[str, Any]) -> bool:
        """Return False: there is nothing more accurate to look for."""
        return False

    def offers(self, case: Case, given: Mapping[str, Any]) -> Iterator[Offer]:
        """Yield sums in doubles and in singles, if their cost is known."""
        if isinstance(case.kernel, PeriodicKernel):
            yield Offer({"precision": PRECISIONS[0]}, 0.0, ewald.exact_seconds(case))
            return
        fitted = case.fitted(self.name)
        if fitted is None:
            return
        pairs = case.sources.shape[1] * case.targets.shape[1]
        for precision in PRECISIONS:
            (rate,) = fitted["seconds"][precision]
            parameters = {"precision": precision}
            yield Offer(parameters, case.rounding[precision], rate * pairs, precision)

    def describe(self, parameters: Mapping[str, Any]) -> str:
        """Return the name, and the precision if it is single."""
        return self.name + " float32" * (parameters.get("precision") == "float32")

    def build(self, points: np.ndarray, leaf_size: int) -> tuple[Tree, np.ndarray]:
        """Make one leaf of all points."""
        return build_tree(points, max(1, points.shape[1]), shrink=False)

    def far_distance2(self, tree: Tree, theta: float) -> np.ndarray:
        """Return the distance from which a cluster is approximated: never."""
        return np.full(len(tree.radius), np.inf)

    def prepare(
        self, kernel: object, tree: Tree, degree: int, wanted: np.ndarray, dtype: type
    ) -> NoExpansion:
        """Return the expansion that is never used."""
        return NoExpansion()

    def update(self, *arguments: Any) -> None:
        """Do nothing: the sum is taken over the points themselves."""


METHOD = DirectSummation()
