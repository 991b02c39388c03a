"""Methods of summation within a boundary: they sum each of its terms."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from treecode.boundaries.base import BoundedKernel, Term
from treecode.methods.base import KEYWORDS, Case, Method, Offer, Parameter, Sum


class Within(Method):
    """A method for a kernel within a boundary; its sums are those of all terms.

    Parameters that a sum finds for its points, and which are not keywords of a plan, are found for
    each term. Those of later terms have its number before the name: ``"1.width"``.

    Parameters
    ----------
    method : Method
    kernel : BoundedKernel
    """

    def __init__(self, method: Method, kernel: BoundedKernel) -> None:
        self.method, self._terms = method, kernel.terms
        self._found = [name for name in method.parameters if name not in KEYWORDS]

    @property
    def name(self) -> str:  # type: ignore[override]
        """That of the method."""
        return self.method.name

    @property
    def parameters(self) -> Mapping[str, Parameter]:  # type: ignore[override]
        """Those of the method, and those that are found for later terms."""
        declared = self.method.parameters
        later = range(1, len(self._terms))
        return {
            **declared,
            **{f"{k}.{name}": declared[name] for k in later for name in self._found},
        }

    def takes(self, kernel: Any) -> bool:
        """Tell whether the method takes the kernels of all terms."""
        return all(self.method.takes(term.kernel) for term in kernel.terms)

    def refuse(self, given: Mapping[str, Any]) -> None:
        """Refuse what the method refuses."""
        self.method.refuse(given)

    def seeks(self, given: Mapping[str, Any]) -> bool:
        """Tell whether the method seeks."""
        return self.method.seeks(given)

    def first(self, given: Mapping[str, Any]) -> dict[str, Any] | None:
        """Return the parameters with which the method begins."""
        return self.method.first(given)

    def offers(self, case: Case, given: Mapping[str, Any]) -> Iterator[Offer]:
        """Yield sums whose seconds are those of all terms; the errors are expected as of one."""
        by_term = (self.method.offers(term, given) for term in case.of_terms())
        for first, *others in zip(*by_term, strict=True):
            yield first._replace(
                parameters=self.merged([offer.parameters for offer in (first, *others)]),
                seconds=first.seconds + sum(offer.seconds for offer in others),
            )

    def merged(self, parameters: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
        """Return the parameters of the sums of all terms as those of one."""
        merged = dict(parameters[0])
        for k, own in enumerate(parameters[1:], start=1):
            merged |= {f"{k}.{name}": own[name] for name in self._found if name in own}
        return merged

    def divided(self, parameters: Mapping[str, Any]) -> list[dict[str, Any]]:
        """Return the parameters of the sum of each term; the opposite of `merged`."""
        common = {name: parameters[name] for name in self.method.parameters if name in parameters}
        divided = [common]
        for k in range(1, len(self._terms)):
            own = {name: value for name, value in common.items() if name not in self._found}
            for name in self._found:
                if f"{k}.{name}" in parameters:
                    own[name] = parameters[f"{k}.{name}"]
            divided.append(own)
        return divided


class BoundedSum:
    """A `methods.base.Sum` within a boundary: the sum of those of its terms.

    Parameters
    ----------
    method : Within
    terms : sequence of Term
    sums : sequence of Sum
        Of each term, without points.
    """

    def __init__(self, method: Within, terms: Sequence[Term], sums: Sequence[Sum]) -> None:
        self._method, self._terms, self._sums = method, terms, sums

    @property
    def parameters(self) -> Mapping[str, Any]:
        """Those of all sums."""
        return self._method.merged([sum_.parameters for sum_ in self._sums])

    @property
    def seconds(self) -> Mapping[str, float]:
        """By stage, of all sums together."""
        stages = [stage for sum_ in self._sums for stage in sum_.seconds]
        return {
            stage: sum(sum_.seconds.get(stage, 0.0) for sum_ in self._sums)
            for stage in dict.fromkeys(stages)
        }

    @property
    def effort(self) -> float:
        """Work of the last sums, in pairs."""
        return sum(sum_.effort for sum_ in self._sums)

    def set_points(self, sources: np.ndarray, targets: np.ndarray | None) -> None:
        """Take points, (3, N) and (3, M), and give each sum its own."""
        self.sources, self.targets = sources, sources if targets is None else targets
        self.source_order = np.arange(sources.shape[1])
        self.target_order = np.arange(self.targets.shape[1])
        self._points = np.ascontiguousarray(sources.T)
        self._there = self._points if targets is None else np.ascontiguousarray(targets.T)
        there = None if targets is None else self._there
        for term, sum_ in zip(self._terms, self._sums, strict=True):
            sum_.set_points(*term.columns_of(self._points, there))

    def execute(self, strengths: np.ndarray) -> np.ndarray:
        """Return the flow, (M, value_size), of strengths (N, strength_size)."""
        flow: Any = 0.0
        for term, sum_ in zip(self._terms, self._sums, strict=True):
            values = sum_.execute(np.ascontiguousarray(term.strengths_of(self._points, strengths)))
            flow = flow + term.flow_of(self._there, values)
        return np.asarray(flow)

    def info(self) -> dict[str, Any]:
        """Return what the first sum says, with pairs and bytes of all."""
        infos = [sum_.info() for sum_ in self._sums]
        of_all = dict(infos[0])
        for name in ("near_pairs", "far_pairs", "bytes", "received_bytes"):
            own = [info[name] for info in infos if name in info]
            if own:
                of_all[name] = None if None in own else sum(own)
        return of_all
