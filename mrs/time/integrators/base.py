"""The contract of a method of time stepping."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np

from mrs.time.state import Arrays, State

RightHandSide = Callable[[float, np.ndarray], np.ndarray]


class Linearized(Protocol):
    """An approximate Jacobian A of the rates."""

    def solve(self, g: float, right: np.ndarray) -> np.ndarray:
        """Return x with (1 - g A) x = right, (P + Q, 3)."""

    def product(self, x: np.ndarray) -> np.ndarray:
        """Return the better approximation J x, (P + Q, 3), which takes a sum."""


class NotStiff:
    """The Jacobian zero, of systems that tell nothing about theirs."""

    def solve(self, g: float, right: np.ndarray) -> np.ndarray:
        """Return the right side."""
        return right

    def product(self, x: np.ndarray) -> np.ndarray:
        """Return zero."""
        return np.zeros_like(x)


class Problem:
    """The equation dz/dt = f(t, z) that a step solves, and values at its start.

    Parameters
    ----------
    f : callable
    rates : callable
        Returns f(t, z) at the start, and keeps it.
    spectral_radius : float
        Of df/dz at the start, an estimate from below; 0 before the first one.
    state : State
        At the start.
    linearized : callable
        Of a time and a state: returns the Jacobian as it was there, turned to the start.
    unit : (P + Q, 1) ndarray
        Allowed error of each coordinate.
    """

    def __init__(
        self,
        f: RightHandSide,
        rates: Callable[[], np.ndarray],
        spectral_radius: float = 0.0,
        state: State | None = None,
        linearized: Callable[[float, State], Linearized] | None = None,
        unit: Any = 1.0,
    ) -> None:
        self.f, self._rates, self.spectral_radius = f, rates, spectral_radius
        self._state, self._linearized, self.unit = state, linearized, unit

    @property
    def rates(self) -> np.ndarray:
        """f(t, z) at the start."""
        return self._rates()

    @property
    def state(self) -> State:
        """At the start."""
        assert self._state is not None
        return self._state

    def linearized(self, time: float, state: State) -> Linearized:
        """Return the Jacobian as it was at a time and in a state, turned to the start."""
        return NotStiff() if self._linearized is None else self._linearized(time, state)

    def size(self, change: np.ndarray) -> float:
        """Return the largest change of a coordinate, in allowed errors."""
        return float((np.abs(change) / self.unit).max(initial=0.0))


class Step(NamedTuple):
    """The result of a step."""

    z: np.ndarray
    """The coordinates at its end."""
    error: np.ndarray | None = None
    """An estimate of their error, from methods that have one."""
    memory: Arrays | None = None
    """Arrays that the method needs in the next step; None if it needs none."""
    converged: bool = True
    """Whether the equations of an implicit step were solved."""
    again: Arrays | None = None
    """The arrays for another try, if the step is rejected; None if those that were given."""
    growth: float | None = None
    """How much longer the next step may be, from methods that choose it themselves."""
    error_order: int | None = None
    """Order of the solution that the error belongs to, where it is not always the same."""


@runtime_checkable
class Dense(Protocol):
    """A method that has states between those of its steps, by the arrays it remembers."""

    def newest(self, memory: Arrays, t: float, state: State) -> tuple[float, State] | None:
        """Return time and state after the last step; None if it did not pass the given state."""

    def at(self, memory: Arrays, t: float) -> State:
        """Return the state at a time within the last step."""


class Method(Protocol):
    """A method for dz/dt = f(t, z), of which rows are positions and rotation vectors.

    A step starts at rotation vectors of zero, because the triads at its start are the reference.
    A multistep method remembers rates or states, which are the same in all reference frames, not
    coordinates.
    """

    @property
    def name(self) -> str:
        """The name in `Integrator` and in TOML files."""

    @property
    def order(self) -> int:
        """Of the method."""

    @property
    def error_order(self) -> int | None:
        """Order of the solution that the error estimate belongs to; None without an estimate."""

    def stability_interval(self) -> float:
        """Return the largest h times lambda that is stable, for real negative eigenvalues.

        Of a method for which it is infinite no spectral radius is estimated.
        """

    def init(self, z: np.ndarray) -> Arrays:
        """Return the `memory` of the first step: no arrays for a one-step method.

        The arrays are part of a checkpoint.
        """

    def step(self, problem: Problem, t: float, z: np.ndarray, h: float, memory: Arrays) -> Step:
        """Return the step of size `h` from z at t; the arrays of `memory` must not be changed."""
