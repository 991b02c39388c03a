"""What is integrated: a system, how it looks in local coordinates, and how steps fail."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from mrs import check
from mrs.time.integrators.base import Linearized, NotStiff
from mrs.time.state import State


class System(Protocol):
    """The system to be integrated: a scene."""

    error_scale: np.ndarray
    """Unit of errors, (P + Q, 1); 0 where nothing has a length, and motion is the measure."""
    perturbation: np.ndarray
    """A small displacement of each coordinate, (P + Q, 1); 0 likewise."""
    is_stiff: bool = False
    """Whether an implicit method is worth its while."""

    def rates(self, time: float, state: State, near: State | None = None) -> np.ndarray:
        """Return velocities and angular velocities, (P + Q, 3).

        With `near`, from which the state differs little, it may be one that `refusal` refuses.
        """

    def refusal(self, time: float, state: State) -> check.NotFiniteValueError | None:
        """Return why a state cannot be; None if it can, as by default."""
        return None

    def linearized(self, time: float, state: State) -> Any:
        """Return an approximate Jacobian of the rates; None if there is none, as by default.

        Its method `at` turns it to another state, as a `mrs.time.integrators.Linearized`.
        """
        return None


class Watched:
    """A system that looks for something, such as a signal, before each evaluation.

    Parameters
    ----------
    system : System
    look : function
        What it raises ends the step.
    """

    def __init__(self, system: System, look: Callable[[], None]) -> None:
        self._system, self._look = system, look
        self.error_scale, self.perturbation = system.error_scale, system.perturbation
        self.is_stiff = system.is_stiff

    def rates(self, time: float, state: State, near: State | None = None) -> np.ndarray:
        """Return velocities and angular velocities, (P + Q, 3)."""
        self._look()
        return self._system.rates(time, state, near)

    def refusal(self, time: float, state: State) -> check.NotFiniteValueError | None:
        """Return why a state cannot be; None if it can."""
        return self._system.refusal(time, state)

    def linearized(self, time: float, state: State) -> Any:
        """Return an approximate Jacobian of the rates; None if there is none."""
        return self._system.linearized(time, state)


class NotFiniteError(ArithmeticError):
    """The state is not finite, or would not be after the smallest step."""

    def __init__(self, row: int) -> None:
        super().__init__(row)
        self.row = row


class StepSizeError(ArithmeticError):
    """No step, however small, keeps the error within the tolerance."""


class ConvergenceError(ArithmeticError):
    """The equations of an implicit step were not solved."""


class Local:
    """A system in local coordinates about a state, and what went wrong there.

    Attributes
    ----------
    lost : list of int
        The row that ceased to be finite first, which takes all others with it.
    blamed : list of NotFiniteValueError
        Of a user's function that was led too far, or of a point that left the fluid.
    """

    def __init__(self, system: System, time: float, state: State) -> None:
        self.system, self._time, self._state = system, time, state
        self.lost: list[int] = []
        self.blamed: list[check.NotFiniteValueError] = []
        self._rates: np.ndarray | None = None

    def rates(self) -> np.ndarray:
        """Return the rates at the state itself."""
        if self._rates is None:
            rates = self.system.rates(self._time, self._state)
            _require_finite(rates)
            self._rates = rates
        return self._rates

    def f(self, t: float, z: np.ndarray) -> np.ndarray:
        """Return dz/dt; not finite where it cannot be."""
        try:
            rates = self.system.rates(t, self._state.moved(z))
            values = self._state.local_rates(z, rates)
        except check.NotFiniteValueError as error:
            self.blamed.append(error)
            values = np.full_like(z, np.nan)
        self.lost.extend(_not_finite(values)[: 1 - len(self.lost)])
        return values

    def beside(self, z: np.ndarray) -> np.ndarray:
        """Return dz/dt near the state."""
        rates = self.system.rates(self._time, self._state.moved(z), self._state)
        return self._state.local_rates(z, rates)

    def linearized(self, time: float, state: State) -> Linearized:
        """Return the Jacobian as it was at a time and in a state, turned to this one."""
        found = self.system.linearized(time, state)
        return NotStiff() if found is None else found.at(self._state)

    def forget(self) -> None:
        """Begin a new try."""
        self.lost.clear()
        self.blamed.clear()

    def causes(self, new: np.ndarray) -> list[Exception]:
        """Return why a try failed that led to coordinates `new`."""
        self.lost.extend(_not_finite(new)[: 1 - len(self.lost)])
        return [*self.blamed, *map(NotFiniteError, self.lost)]


def _not_finite(values: np.ndarray) -> list[int]:
    return np.flatnonzero(~np.isfinite(values).all(axis=1)).tolist()


def _require_finite(values: np.ndarray) -> None:
    lost = _not_finite(values)
    if lost:
        raise NotFiniteError(lost[0])
