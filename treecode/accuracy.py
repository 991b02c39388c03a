"""What a tolerance promises: errors relative to the norm of each part of the values.

A part is the values of one unit at the targets of one group, so that neither large velocities
hide angular velocities, nor many targets among the sources a few far away.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from treecode.kernels.base import Kernel
from treecode.ranks import OneRank

_LEAST = 50  # targets drawn of a group, where there are many groups
_FEWEST = 3  # watched of a group: one is left out


class Error(NamedTuple):
    """A relative error at drawn targets.

    Attributes
    ----------
    norm : float
        K eq. (8.1), over all columns; the largest of those of groups.
    by_unit : float
        The largest of those of parts.
    bound : float
        `by_unit` where the error of the draw is two standard deviations.
    """

    norm: float
    by_unit: float
    bound: float


class Parts(NamedTuple):
    """Which values are measured together.

    Attributes
    ----------
    units : (value_size, U) float64
        1 where a component has a unit, else 0.
    groups : (M,) int64
        The group of each target, from 0 on.
    group_count : int
    ranks : OneRank
        Those that have other targets of the groups; the values here are those of this rank.
    """

    units: np.ndarray
    groups: np.ndarray
    group_count: int
    ranks: OneRank = OneRank()

    @classmethod
    def of(
        cls,
        kernel: Kernel,
        targets: int,
        groups: np.ndarray | None = None,
        ranks: OneRank | None = None,
    ) -> Parts:
        """Return the parts of a kernel's values, for groups with any numbers; one by default.

        Targets that are spread over `ranks` are one group.
        """
        lengths = np.array(kernel.value_lengths)
        units = (lengths[:, None] == np.unique(lengths)).astype(float)
        if groups is None or not targets:
            return cls(units, np.zeros(targets, np.int64), 1, ranks or OneRank())
        numbers, inverse = np.unique(groups, return_inverse=True)
        return cls(units, inverse, len(numbers))

    def members(self) -> list[np.ndarray]:
        """Return the targets of each group."""
        order = np.argsort(self.groups, kind="stable")
        ends = np.bincount(self.groups, minlength=self.group_count).cumsum()
        return np.split(order, ends[:-1])

    def add_up(self, squares: np.ndarray, rows: Any = slice(None)) -> np.ndarray:
        """Return sums over groups, (G, U), of squares (n, U) at some targets."""
        if self.group_count == 1:
            return self.ranks.add_up(squares.sum(axis=0)[None])
        groups = self.groups[rows]
        columns = [np.bincount(groups, column, self.group_count) for column in squares.T]
        return np.stack(columns, axis=1)

    def squares(self, values: np.ndarray, rows: Any = slice(None)) -> np.ndarray:
        """Return the squares of the norms of parts, (G, U), of values at some targets."""
        if self.group_count == 1:
            return self.ranks.add_up(np.einsum("ij,ij->j", values, values)[None] @ self.units)
        return self.add_up(values**2 @ self.units, rows)

    def difference(
        self, values: np.ndarray, exact: np.ndarray, rows: Any = slice(None)
    ) -> np.ndarray:
        """Return relative differences, (G, U), of values at some targets."""
        peak = self._peak(exact)
        squares = self.squares((values - exact) / peak, rows)
        return ratio(squares, self.squares(exact / peak, rows))

    def draw(self, number: int, least: int) -> np.ndarray:
        """Return about `number` targets, drawn evenly, `least` at least of each group."""
        rng = np.random.default_rng(0)
        each = max(number // self.group_count, least)
        return np.concatenate([rng.permutation(some)[:each] for some in self.members()])

    def watch(self, number: int) -> np.ndarray:
        """Return some targets that depend on the groups alone, one of each in turn."""
        rows = self.draw(number, _FEWEST)
        groups = self.groups[rows]
        turn = np.arange(len(rows)) - np.searchsorted(groups, groups)  # rows are sorted by group
        return rows[np.argsort(turn, kind="stable")]

    def seem_within(
        self, tol: float, values: np.ndarray, exact: np.ndarray, rows: np.ndarray
    ) -> bool:
        """Tell from exact values at watched targets whether a tolerance may be kept.

        The largest error of a group is left out, since a few targets may carry the norm: what is
        beyond the tolerance here is so nearly everywhere.
        """
        peak = self._peak(exact)
        if 1e-100 < peak < 1e100:  # squares of all are in range, and need no copy
            peak = 1.0
        squares = ((values[rows] - exact) / peak) ** 2 @ self.units
        groups = self.groups[rows]
        worst = np.zeros((self.group_count, self.units.shape[1]))
        np.maximum.at(worst, groups, squares)
        worst = np.max(self.ranks.exchange(worst), axis=0)
        drawn = self._count(groups)
        more = self._count(self.groups) / np.maximum(drawn - 1, 1)
        error = more * (self.add_up(squares, rows) - worst) * (drawn >= _FEWEST)
        norm = self.squares(values if peak == 1.0 else values / peak)
        return not (error > tol**2 * norm).any()

    def sampled_error(
        self,
        values: np.ndarray,
        exact_at: Callable[[np.ndarray], np.ndarray],
        samples: int,
        seed: int = 0,
    ) -> Error:
        """Return the error of values, (M, value_size).

        Half of the targets are drawn evenly and half in proportion to the squares of their
        values, so that neither many small errors nor a few large values are missed.

        Parameters
        ----------
        values : (M, value_size) float64
        exact_at : function
            Returns exact values at some targets.
        samples : int
            Targets to draw; more if there are so many groups that few would be left for each.
        seed : int, optional
        """
        if not all(self.ranks.exchange(bool(np.isfinite(values).all()))):
            return Error(math.inf, math.inf, math.inf)
        peak = self._peak(values)
        power = (values / peak) ** 2 @ self.units
        rows, weight = self._draw_by(power, -(-samples // self.ranks.size), seed)
        exact = exact_at(rows) / peak
        squares = weight[:, None] * ((values[rows] / peak - exact) ** 2 @ self.units)
        plain = self.add_up(weight[:, None] * (exact**2 @ self.units), rows)
        control = self.add_up(power) + plain - self.add_up(weight[:, None] * power[rows], rows)
        norm = np.where(control > 0.5 * plain, control, plain)  # of values far off it is nothing
        drawn = self._count(self.groups[rows])
        some = drawn < self._count(self.groups)
        error = self.add_up(squares, rows)
        centred = squares - (error / np.maximum(drawn, 1))[self.groups[rows]]
        deviation = np.sqrt(self.add_up(centred**2, rows)) * some
        return Error(
            float(ratio(error.sum(axis=1), norm.sum(axis=1)).max(initial=0.0)),
            float(ratio(error, norm).max(initial=0.0)),
            float(ratio(error + 2.0 * deviation, norm).max(initial=0.0)),
        )

    def _peak(self, values: np.ndarray) -> float:
        return max(self.ranks.exchange(largest(values)))

    def _count(self, groups: np.ndarray) -> np.ndarray:
        """Return how many targets there are of each group, (G, 1)."""
        return self.ranks.add_up(np.bincount(groups, minlength=self.group_count)[:, None])

    def _draw_by(self, power: np.ndarray, samples: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
        """Return targets, all of a group if they are few, and how many others each stands for."""
        rng = np.random.default_rng(seed)
        each = max(samples // self.group_count, min(samples, _LEAST))
        drawn, weights = [], []
        for some in self.members():
            if each >= len(some):
                drawn.append(some)
                weights.append(np.ones(len(some)))
                continue
            total = power[some].sum(axis=0)
            share = power[some] / np.where(total > 0.0, total, 1.0)
            share = 1.0 / len(some) + share.mean(axis=1)
            share /= share.sum()
            chosen = rng.choice(len(some), each, p=share)
            drawn.append(some[chosen])
            weights.append(1.0 / (each * share[chosen]))
        return np.concatenate(drawn), np.concatenate(weights)


def ratio(squares: Any, norm: Any) -> Any:
    """Return the root of a quotient; nothing of nothing is nothing."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.sqrt(np.where(squares == 0.0, 0.0, squares / norm))


def largest(values: np.ndarray) -> float:
    """Return the largest magnitude, 1 if all are zero: squares of the rest stay in range."""
    return float(np.abs(values).max(initial=0.0)) or 1.0


def relative_error(values: np.ndarray, exact: np.ndarray) -> float:
    """Return the relative error in the Euclidean norm over all rows and columns, K eq. (8.1).

    Examples
    --------
    >>> import numpy as np
    >>> import treecode as tc
    >>> print(tc.relative_error(np.array([[3.0, 4.0, 0.1]]), np.array([[3.0, 4.0, 0.0]])))
    0.02
    """
    scale = float(np.linalg.norm(exact))
    error = float(np.linalg.norm(values - exact))
    return error / scale if scale > 0.0 else error
