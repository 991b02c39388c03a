"""The common part of both treecodes: their parameters, and their offers for a tolerance."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, ClassVar, NamedTuple

import numpy as np

from treecode import check
from treecode.methods.base import KEYWORDS, PRECISIONS, Case, Offer
from treecode.methods.walk import WalkMethod
from treecode.traversal import acceptance
from treecode.tree import Tree

THETAS = 0.5, 0.6, 0.7, 0.8
LEAF_SIZES = 250, 500, 1000, 2000

_COUNTED = 40_000  # sources among which pairs are counted
_WALKERS = 64  # targets for which they are


class Treecode(WalkMethod):
    """A method by expansions of clusters that are far.

    Attributes
    ----------
    degrees : range
        The degrees that are offered for a tolerance.
    """

    parameters: ClassVar = {
        name: KEYWORDS[name] for name in ("theta", "degree", "leaf_size", "precision")
    }
    degrees: ClassVar[range]

    def terms(self, degree: Any) -> Any:
        """Return the terms of an expansion; of an array of degrees an array."""
        raise NotImplementedError

    def refuse(self, given: Mapping[str, Any]) -> None:
        """Refuse a degree or a precision beside a tolerance."""
        if self.seeks(given):
            chosen = {name: given.get(name) for name in ("degree", "precision")}
            check.absent("with tol, which chooses it", **chosen)

    def first(self, given: Mapping[str, Any]) -> dict[str, Any] | None:
        """Return the parameters to begin with; None beside a tolerance."""
        return None if self.seeks(given) else self.complete(given)

    def describe(self, parameters: Mapping[str, Any]) -> str:
        """Return the name with theta, degree, and the precision if it is single."""
        single = " float32" * (parameters.get("precision") == "float32")
        return f"{self.name}({parameters['theta']:g}/{parameters['degree']}{single})"

    def cut_off(self, fitted: Mapping[str, Any], theta: float, degree: Any) -> Any:
        """Return the fitted error of expansions, in units of the error of the probe."""
        offset, slope = (np.interp(theta, THETAS, fitted[name]) for name in ("offset", "slope"))
        return 10.0 ** (offset + slope * degree)

    def offers(self, case: Case, given: Mapping[str, Any]) -> list[Offer]:
        """Return sums of all angles, leaves, degrees and precisions, if their costs are known."""
        fitted = case.fitted(self.name)
        if fitted is None:
            return []
        if self.name not in case.memory:
            case.memory[self.name] = list(self._offers(case, given, fitted))
        offers: list[Offer] = case.memory[self.name]
        return offers

    def _offers(
        self, case: Case, given: Mapping[str, Any], fitted: Mapping[str, Any]
    ) -> Iterator[Offer]:
        """Yield sums, with pairs counted for some targets in a tree of some of the sources."""
        leaf_sizes = (given["leaf_size"],) if "leaf_size" in given else LEAF_SIZES
        sources, count = case.sources.shape[1], case.targets.shape[1]
        every = -(-sources // _COUNTED)
        sample = case.sources[:, ::every].copy()
        tree, _ = self.build(sample, max(1, leaf_sizes[0] // every))
        walkers = case.targets[:, np.random.default_rng(0).permutation(count)[:_WALKERS]]
        more = count / walkers.shape[1]
        degrees = np.array(self.degrees)
        terms = self.terms(degrees)
        for theta in (given["theta"],) if "theta" in given else THETAS:
            cut_off = case.scale * self.cut_off(fitted, theta, degrees)
            meetings = meet(tree, walkers, theta)
            for leaf_size in leaf_sizes:
                near, accepted = count_pairs(meetings, leaf_size / every, terms / every)
                work = [
                    more * every * near,
                    more * accepted * terms,
                    more * accepted,
                    sources * terms,
                    sources + count,
                ]
                for precision in PRECISIONS:
                    rates = fitted["seconds"][precision]
                    seconds = sum(r * amount for r, amount in zip(rates, work, strict=True))
                    errors = cut_off + case.rounding[precision]
                    for degree, error, time in zip(degrees.tolist(), errors, seconds, strict=True):
                        parameters = {
                            "theta": theta,
                            "degree": degree,
                            "leaf_size": leaf_size,
                            "precision": precision,
                        }
                        yield Offer(parameters, error, time, precision)


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
        opened = ~far & ~last
        count = tree.children[cluster[opened]]
        number = np.arange(count.sum()) - np.repeat(count.cumsum() - count, count)
        who, above = np.repeat(who[opened], count), np.repeat(size[opened], count)
        cluster = np.repeat(tree.child[cluster[opened]], count) + number
    return Meetings(*map(np.concatenate, zip(*levels, strict=True)))


def count_pairs(
    meetings: Meetings, leaf_size: float, terms: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return pairs near and expansions evaluated, for leaves and terms of an expansion."""
    in_tree = meetings.above > leaf_size
    leaf = in_tree & ~meetings.far & (meetings.last | (meetings.size <= leaf_size))
    far = np.sort(meetings.size[in_tree & meetings.far])
    summed = np.searchsorted(far, terms, side="right")  # where points are fewer than terms
    near = meetings.size[leaf].sum() + np.append(0, far.cumsum())[summed]
    return near, len(far) - summed
