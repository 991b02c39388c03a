"""Backward differentiation of variable order and step, for stiff systems: one sum a step or two.

Hairer & Wanner, Solving Ordinary Differential Equations II, chapter V; step control and the
estimates of neighbouring orders as in L. F. Shampine & M. W. Reichelt, SIAM J. Sci. Comput. 18, 1
(1997).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mrs import krylov
from mrs.time.integrators.base import Linearized, Problem, Step
from mrs.time.state import Arrays, State

_HIGHEST = 4  # order
_CORRECTIONS = 4  # in one step at most
_SHARE = 0.2  # of the tolerance for the error of a step: those of neighbours have one sign
_ENOUGH = 0.2 * _SHARE  # error that corrections may leave, in tolerances
_DIVERGENT = 2.0  # ratio of two corrections from which there is no hope
_LEAST_RATE, _LARGEST_RATE = 1e-3, 0.9  # of ratios that are taken for the rate of convergence
_MEASURED = 5  # steps after which the ratio of two corrections is measured again
_OLD, _SLOW = 2.0, 0.2  # a Jacobian is renewed when this ratio has grown so much, and beyond that
_KRYLOV = 20  # steps with iterations over sums, where corrections alone do not converge
_SHORTER = 0.5  # a step is tried, before these iterations are
_RIGHT, _ITERATIONS = 0.1, 8  # relative residual of these iterations, and how many at most
_CHANGED = 1.7  # of g = h / d0, from which the equations are factorised again
_SAFETY, _GROWTH = 0.85, 2.0
_WORTH = 1.2  # growth of a step below which it stays as it is
_BIAS = 1.1  # advantage that another order must have


@dataclass(frozen=True)
class _Memory:
    """All that one step hands to the next.

    Attributes
    ----------
    times : (k,) ndarray
        Of past states, the newest first.
    positions, quaternions : (k, P, 3) and (k, Q, 4) ndarray
    order, since, used : int
        Order of the next step, steps taken with it, and order of the last step.
    built_time, built_positions, built_quaternions
        Where the Jacobian was approximated.
    factored : float
        The g of the factorised equations.
    rate, best : float
        Ratio of two corrections, and how it was when a Jacobian was new; 0 if it is unknown.
    age : int
        Steps since the ratio was measured.
    krylov : int
        Steps to be taken with iterations over sums.
    failed : int
        Tries since the last step in which corrections did not converge.
    """

    times: np.ndarray
    positions: np.ndarray
    quaternions: np.ndarray
    order: int
    since: int
    used: int
    built_time: float
    built_positions: np.ndarray
    built_quaternions: np.ndarray
    factored: float
    rate: float
    best: float
    age: int
    krylov: int
    failed: int

    @classmethod
    def begun(cls, t: float, state: State) -> _Memory:
        """Return the memory of a first step."""
        places, triads = state
        return cls(
            np.array([t]), places[None], triads[None], 1, 0, 1, t, *state, 0.0, 0.0, 0.0, 0, 0, 0
        )

    @property
    def built(self) -> State:
        """Where the Jacobian was approximated."""
        return State(self.built_positions, self.built_quaternions)

    @property
    def newest(self) -> State:
        """After the last step."""
        return State(self.positions[0], self.quaternions[0])

    def at(self, t: float) -> State:
        """Return the state at a time within the last step, by the polynomial of its order."""
        if t == self.times[0]:
            return self.newest
        order = min(self.used, len(self.times) - 1)
        local = self.coordinates(self.newest)
        return self.newest.moved(_extrapolated(t, self.times, local, order))

    def coordinates(self, state: State) -> np.ndarray:
        """Return the past states in local coordinates about another, (k, P + Q, 3)."""
        pairs = zip(self.positions, self.quaternions, strict=True)
        return np.array([state.coordinates_of(State(*past)) for past in pairs])

    def arrays(self) -> Arrays:
        """Return it as arrays."""
        return {name: np.asarray(value) for name, value in vars(self).items()}


def _renewed(past: _Memory, t: float, state: State) -> _Memory:
    """Return the memory with a Jacobian that is to be approximated here."""
    places, triads = state
    return replace(
        past,
        built_time=t,
        built_positions=places,
        built_quaternions=triads,
        factored=0.0,
        rate=past.best,
    )


def _unpacked(memory: Arrays) -> _Memory:
    """Return what `_Memory.arrays` made arrays of."""
    values: dict[str, Any] = {k: v.item() if v.ndim == 0 else v for k, v in memory.items()}
    return _Memory(**values)


def _remembered(memory: Arrays, t: float, state: State) -> _Memory:
    """Return the memory of the last step, if the state is the one that it led to."""
    if memory:
        last = _unpacked(memory)
        if last.times[0] == t and last.newest.equals(state):
            return last
    return _Memory.begun(t, state)


class BackwardDifferentiation:
    """Variable-step, variable-order BDF, of orders 1 to 4, with an approximate Jacobian.

    A step begins with a prediction z0, the extrapolation of past states. Each correction
    ``z <- z - (1 - g A)^-1 r(z) / d0`` takes one evaluation, with the residual
    ``r(z) = sum_j d_j z_j - h f(z)`` and ``g = h / d0``. How fast corrections become smaller tells
    how good the approximation A of the Jacobian is: it is renewed when they do not, and as few are
    made as the tolerance needs.
    """

    name = "bdf"
    order = _HIGHEST
    error_order = _HIGHEST

    def stability_interval(self) -> float:
        """Return infinity: there is no limit for real negative eigenvalues."""
        return math.inf

    def init(self, z: np.ndarray) -> Arrays:
        """Return nothing: there is no past."""
        return {}

    def newest(self, memory: Arrays, t: float, state: State) -> tuple[float, State] | None:
        """Return time and state after the last step; None if it did not pass the given state."""
        last = _unpacked(memory)
        if last.times[0] <= t or not last.times[1:2].min(initial=np.inf) < t:
            return None
        if not last.at(t).equals(state):
            return None
        return float(last.times[0]), last.newest

    def at(self, memory: Arrays, t: float) -> State:
        """Return the state at a time within the last step."""
        return _unpacked(memory).at(t)

    def step(self, problem: Problem, t: float, z: np.ndarray, h: float, memory: Arrays) -> Step:
        """Return the step, its error estimate and the wish for the next step."""
        past = _remembered(memory, t, problem.state)
        solved = self._solved(problem, t, h, past)
        if solved is None:  # with a new Jacobian too
            again = replace(past, failed=past.failed + 1, rate=0.0)
            return Step(z, converged=False, again=again.arrays(), growth=_SHORTER)
        return self._judged(problem, t + h, *solved)

    def _solved(
        self, problem: Problem, t: float, h: float, past: _Memory
    ) -> tuple[np.ndarray, _Memory, np.ndarray] | None:
        """Return the corrected state, the memory, and past states in local coordinates."""
        history = past.coordinates(problem.state)
        ahead = t + h
        order = past.order
        d = _weights(ahead, past.times[:order]) * h
        if len(past.times) > order:
            predicted = _extrapolated(ahead, past.times, history, order)
        else:
            predicted = history[0] + h * problem.rates
        known, g = _combined(d[1:], history[:order]), h / d[0]
        there = problem.state.moved(predicted)
        fresh = past.rate > max(_SLOW, _OLD * past.best)
        if fresh:
            past = _renewed(past, ahead, there)

        def residual(z: np.ndarray) -> np.ndarray:
            return z + (known - h * problem.f(ahead, z)) / d[0]

        first = residual(predicted)
        while np.isfinite(first).all():
            jacobian = problem.linearized(past.built_time, past.built)
            if not past.factored or not 1.0 / _CHANGED < g / past.factored < _CHANGED:
                past = replace(past, factored=g)
            solve = _Solve(jacobian, past.factored, g, problem if past.krylov else None)
            done = _corrected(problem, solve, residual, predicted, first, past, fresh)
            if done is not None:
                return *done, history
            if not fresh:
                fresh, past = True, replace(_renewed(past, ahead, there), rate=0.0)
            elif past.failed and not past.krylov:
                past = replace(past, krylov=_KRYLOV, rate=0.0)
            else:
                break
        return None

    def _judged(
        self,
        problem: Problem,
        ahead: float,
        new: np.ndarray,
        past: _Memory,
        history: np.ndarray,
    ) -> Step:
        """Return the step, with the order and the size that the next one should have."""
        order, best, since = past.order, past.order, past.since + 1
        errors = _errors(ahead, new, past, history)
        if errors:
            error = errors[order]
            growth = {k: _growth(problem.size(e) / _SHARE, k) for k, e in errors.items()}
            other = max(growth, key=lambda k: growth[k])
            if since > order and growth[other] > _BIAS * growth[order]:
                best, since = other, 0
            wanted = growth[best]
        else:  # of the first step, which the rates predict
            h = ahead - past.times[0]
            error = 0.5 * (new - history[0] - h * problem.rates)
            wanted = _growth(problem.size(error) / _SHARE, order)
        if 1.0 <= wanted < _WORTH or past.failed:
            wanted = min(wanted, 1.0)
        memory = _advanced(past, ahead, problem.state.moved(new), best, since)
        return Step(
            new,
            error / _SHARE,
            memory.arrays(),
            again=past.arrays(),
            growth=min(wanted, _GROWTH),
            error_order=order,
        )


def _errors(
    ahead: float, new: np.ndarray, past: _Memory, history: np.ndarray
) -> dict[int, np.ndarray]:
    """Return estimates of the error of a step of the same order, and of orders next to it."""
    times, errors = past.times, {}
    for k in range(max(1, past.order - 1), min(_HIGHEST, past.order + 1, len(times) - 1) + 1):
        missed = new - _extrapolated(ahead, times, history, k)
        errors[k] = (ahead - times[0]) / (ahead - times[k]) * missed
    return errors


def _advanced(past: _Memory, ahead: float, state: State, order: int, since: int) -> _Memory:
    """Return the memory after a step to a time and a state."""

    def added(new: np.ndarray | float, old: np.ndarray) -> np.ndarray:
        return np.concatenate([np.asarray(new)[None], old])[: _HIGHEST + 1]

    return replace(
        past,
        times=added(ahead, past.times),
        positions=added(state.positions, past.positions),
        quaternions=added(state.quaternions, past.quaternions),
        order=order,
        since=since,
        used=past.order,
        krylov=max(0, past.krylov - 1),
        failed=0,
    )


class _Solve:
    """Solutions of (1 - g A) x = r by equations that were factorised for another g nearby.

    With a problem, of (1 - g J) x = r, by iterations with products of J, a sum each.
    """

    def __init__(
        self, jacobian: Linearized, factored: float, g: float, problem: Problem | None
    ) -> None:
        self._jacobian, self._factored, self._g, self._problem = jacobian, factored, g, problem
        self._scale = 2.0 / (1.0 + g / factored)

    def __call__(self, right: np.ndarray) -> np.ndarray:
        return self._directly(right) if self._problem is None else self._iterated(right)

    def _directly(self, right: np.ndarray) -> np.ndarray:
        return self._scale * self._jacobian.solve(self._factored, right)

    def _iterated(self, right: np.ndarray) -> np.ndarray:
        assert self._problem is not None

        def applied(x: np.ndarray) -> np.ndarray:
            return self._directly(x - self._g * self._jacobian.product(x))

        right = self._directly(right)
        return krylov.solved(applied, right, self._problem.unit, _RIGHT, _ITERATIONS)


def _corrected(
    problem: Problem,
    solve: _Solve,
    residual: Callable[[np.ndarray], np.ndarray],
    predicted: np.ndarray,
    first: np.ndarray,
    past: _Memory,
    fresh: bool,
) -> tuple[np.ndarray, _Memory] | None:
    """Return the corrected prediction; None if corrections do not become smaller fast enough."""
    rate, age = past.rate, past.age + 1
    correction = -solve(first)
    z, size = predicted + correction, problem.size(correction)
    if not math.isfinite(size):
        return None
    for number in range(1, _CORRECTIONS + 1):
        trusted = rate > 0.0 and (age < _MEASURED or number > 1)
        left = size * rate / (1.0 - rate)
        if trusted and left <= _ENOUGH:
            return z, replace(past, rate=rate, age=age)
        # The first correction may leave a stiff constraint, to which the second leads back.
        if number > 2 and left * rate ** (_CORRECTIONS - number) > _ENOUGH:
            return None
        correction = -solve(residual(z))
        before, size = size, problem.size(correction)
        if not size <= _DIVERGENT * before:
            return None
        z, age = z + correction, 0
        measured = size / before if before > 0.0 else 0.0
        rate = min(max(measured, 0.3 * rate, _LEAST_RATE), _LARGEST_RATE)
        if fresh:
            past = replace(past, best=rate)
    return None


def _growth(size: float, order: int) -> float:
    """Return how much longer a step may be whose error is `size` tolerances."""
    return _SAFETY * size ** (-1.0 / (order + 1)) if size > 0.0 else _GROWTH


def _weights(ahead: float, times: np.ndarray) -> np.ndarray:
    """Return the weights that give the derivative at `ahead` of values there and at `times`."""
    places = np.append(ahead, times) - ahead
    scale = np.abs(places).max()
    powers = np.vander(places / scale, increasing=True).T
    return np.linalg.solve(powers, np.eye(len(places))[1]) / scale


def _extrapolated(ahead: float, times: np.ndarray, values: np.ndarray, order: int) -> np.ndarray:
    """Return the polynomial through order + 1 values, at `ahead`."""
    points = times[: order + 1]
    weights = [
        np.prod([(ahead - other) / (point - other) for other in points if other != point])
        for point in points
    ]
    return _combined(weights, values[: order + 1])


def _combined(weights: Iterable[float], values: np.ndarray) -> np.ndarray:
    """Return the sum of arrays with weights."""
    return sum((w * v for w, v in zip(weights, values, strict=True)), np.zeros(values.shape[1:]))
