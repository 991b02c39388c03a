"""Step sizes: fixed, from stability, or from the error; rejections; values that are not finite."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, Protocol

import numpy as np

from mrs import check
from mrs.time.integrators import METHODS, Problem
from mrs.time.integrators.spectral import MARGIN, spectral_radius
from mrs.time.state import Arrays, State, below

_SAFETY = 0.8  # of step sizes against the error and the stability limit
_LARGEST_MOVE = 0.1  # in one step of a method without an error estimate: lengths of bodies, radians
_WARNING = 1.02  # as `MARGIN`, where too early a warning is as bad as one too late
_RENEW = 50  # steps, after which the spectral radius is estimated again
_SMALLEST = 1e-10  # a step that has shrunk by this against its interval is given up
_SMALL = 1e-6  # perturbation where nothing has a length, beside coordinates and ways to go
_ROUNDING = 64.0 * np.finfo(float).eps  # of coordinates, in a step
_MEMORY = "memory/"  # before the names of arrays that a method remembers
_LONGER = 1e-6  # of a step asked for, by which it may be longer: late times are rounded coarsely


@check.spelling
@dataclass(frozen=True)
class Integrator:
    """How time is stepped.

    Parameters
    ----------
    name : str
        "rkc2", "euler", "heun", "rk4", "bs32", or one that was registered
    dt : float or "auto", optional
        A fixed step; or "auto": from the error with methods that estimate theirs ("rkc2", "bs32"),
        with the others from the stability limit and so that nothing moves by more than a tenth of
        its length.
    tolerance : float, optional
        Error of one step allowed with "auto": of positions relative to the length of their body,
        of points in a scene without any length relative to their way in the step, of triads in
        radians.

    Examples
    --------
    >>> import mrs
    >>> import numpy as np
    >>> rotation = mrs.flows.QuadraticFlow(gradient=[[0, -1, 0], [1, 0, 0], [0, 0, 0]])
    >>> fluid, dust = mrs.Fluid(background=rotation), mrs.Tracers([[1.0, 0.0, 0.0]])
    >>> sim = mrs.Simulation(fluid, [dust], integrator=mrs.Integrator("rk4", dt=0.1))
    >>> print(sim.run(np.pi / 4).state.positions.round(4))
    [[0.7071 0.7071 0.    ]]
    """

    __pydantic_config__: ClassVar[dict[str, str]] = {"extra": "forbid"}

    name: str = "rkc2"
    dt: float | Literal["auto"] = "auto"
    tolerance: float = 1e-4

    def __post_init__(self) -> None:
        check.one_of("name", self.name, METHODS)
        if isinstance(self.dt, str) and self.dt != "auto":
            raise ValueError(f"dt must be 'auto' or a positive number, got {self.dt!r}")
        if self.dt != "auto":
            check.positive("dt", self.dt)
        check.number("tolerance", self.tolerance, 0.0, 1.0)


class System(Protocol):
    """The system to be integrated: a scene."""

    error_scale: np.ndarray
    """Unit of errors, (P + Q, 1); 0 where nothing has a length, and motion is the measure."""
    perturbation: np.ndarray
    """A small displacement of each coordinate, (P + Q, 1); 0 likewise."""

    def rates(self, time: float, state: State, near: State | None = None) -> np.ndarray:
        """Return velocities and angular velocities, (P + Q, 3).

        With `near`, from which the state differs little, it may be one that `refusal` refuses.
        """

    def refusal(self, time: float, state: State) -> check.NotFiniteValueError | None:
        """Return why a state cannot be; None if it can, as by default."""
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

    def rates(self, time: float, state: State, near: State | None = None) -> np.ndarray:
        """Return velocities and angular velocities, (P + Q, 3)."""
        self._look()
        return self._system.rates(time, state, near)

    def refusal(self, time: float, state: State) -> check.NotFiniteValueError | None:
        """Return why a state cannot be; None if it can."""
        return self._system.refusal(time, state)


class NotFiniteError(ArithmeticError):
    """The state is not finite, or would not be after the smallest step."""

    def __init__(self, row: int) -> None:
        super().__init__(row)
        self.row = row


class StepSizeError(ArithmeticError):
    """No step, however small, keeps the error within the tolerance."""


class Stepper:
    """Advances a state, one accepted step at a time.

    Parameters
    ----------
    integrator : Integrator
    longest : float, optional
        Up to which steps resolve the noise that is added after them; "auto" stays below.
    """

    def __init__(self, integrator: Integrator, longest: float = math.inf) -> None:
        self.tolerance = integrator.tolerance
        self.method = METHODS[integrator.name]
        self.fixed = None if isinstance(integrator.dt, str) else float(integrator.dt)
        self.adaptive = self.fixed is None and self.method.error_order is not None
        self.longest = longest
        if self.fixed is not None and self.fixed > longest:
            warnings.warn(
                f"dt: {self.fixed:g} is longer than {longest:.3g}, up to which steps resolve the "
                "noise of the bodies; use a smaller dt or dt='auto'",
                stacklevel=4,
            )
        self.h: float | None = None
        self.taken: float = 0.0
        self.radius = 0.0
        self.vector: np.ndarray | None = None
        self.memory: Arrays | None = None
        self.steps: int = 0
        self.rejections: int = 0
        self._renew_at = 0
        self._warned = False

    @property
    def h_lambda(self) -> float:
        """The last step times the spectral radius."""
        return self.taken * self.radius

    def history(self) -> tuple[Arrays, dict[str, Any]]:
        """Return all values besides the state on which the next step depends."""
        arrays = {} if self.vector is None else {"vector": self.vector}
        arrays |= {_MEMORY + name: array for name, array in (self.memory or {}).items()}
        names = ("h", "taken", "radius", "steps", "rejections", "_renew_at")
        return arrays, {name.lstrip("_"): getattr(self, name) for name in names}

    def restore(self, arrays: Arrays, values: dict[str, Any]) -> None:
        """Take up a history."""
        self.vector = arrays.get("vector")
        self.memory = below(arrays, _MEMORY) or None
        self.h, self.taken, self.radius = values["h"], values["taken"], values["radius"]
        self.steps, self.rejections = values["steps"], values["rejections"]
        self._renew_at = values["renew_at"]

    def restore_counts(self, values: dict[str, Any]) -> None:
        """Take up of a history how many steps there were, and choose the next one anew."""
        self.steps, self.rejections = values["steps"], values["rejections"]
        self._renew_at = self.steps

    def step(self, system: System, time: float, state: State, stop: float) -> tuple[float, State]:
        """Return time and state after one accepted step, not beyond `stop`.

        Raises
        ------
        NotFiniteError
            With the first row of the coordinates that is not finite.
        """
        rates = system.rates(time, state)
        _require_finite(rates)
        z = state.coordinates()
        if self.memory is None:
            self.memory = self.method.init(z)

        lost: list[int] = []  # the row that ceased to be finite first takes all others with it
        blamed: list[check.NotFiniteValueError] = []  # a user's function that was led too far

        def rates_beside(z: np.ndarray) -> np.ndarray:
            return state.local_rates(z, system.rates(time, state.moved(z), state))

        def f(t: float, z: np.ndarray) -> np.ndarray:
            try:
                values = state.local_rates(z, system.rates(t, state.moved(z)))
            except check.NotFiniteValueError as error:
                blamed.append(error)
                values = np.full_like(z, np.nan)
            lost.extend(_not_finite(values)[: 1 - len(lost)])
            return values

        interval = stop - time
        retried = False
        while True:
            if retried or self.steps >= self._renew_at:
                small = system.perturbation
                if not small.all():
                    small = _filled(small, _SMALL * z, _SMALL * interval * rates)
                self._estimate_radius(rates_beside, z, rates, small)
            h = self._size(interval, rates, system.error_scale)
            self.taken = h
            lost.clear()
            blamed.clear()
            problem = Problem(f, rates, self.radius)
            new, error, memory = self.method.step(problem, time, z, h, self.memory)
            unit = system.error_scale
            if not unit.all():
                rounding = _ROUNDING / self.tolerance * z  # is no error, even if nothing moves
                unit = _filled(unit, new - z, h * rates, rounding)
            ratio = self._error_ratio(new, error, unit)
            if ratio <= 1.0:
                refused = system.refusal(time + h, state.moved(new))
                if refused is None:
                    break
                ratio = math.inf
                blamed.append(refused)
            lost.extend(_not_finite(new)[: 1 - len(lost)])
            self._reject(h, ratio, interval, [*blamed, *map(NotFiniteError, lost)])
            retried = True
        self.steps += 1
        self.memory = memory or {}
        if self.adaptive:
            # One shortened to end on time says nothing against the longer one that was wanted.
            self.h = self._next(h, ratio, h if retried else max(5.0 * h, self.h or 0.0))
        reached = stop if h == interval else time + h
        return reached, state.moved(new)

    def _size(self, interval: float, rates: np.ndarray, scale: np.ndarray) -> float:
        """Return the step to try: whole steps fill the interval evenly, none is left tiny."""
        limit = (
            self.method.stability_interval() / (MARGIN * self.radius) if self.radius else math.inf
        )
        if self.fixed is not None:
            self.h = self.fixed
            self._warn(limit * MARGIN / _WARNING)
        elif not self.adaptive:
            self.h = min(_SAFETY * limit, self._time_to_move(_LARGEST_MOVE, rates, scale))
        elif self.h is None:
            first = 0.1 * math.sqrt(self.tolerance)
            self.h = min(interval, self._time_to_move(first, rates, scale))
        wanted = min(self.h, _SAFETY * limit if self.adaptive else math.inf)
        if self.fixed is None:  # not zero, however fast the motion
            wanted = max(min(wanted, self.longest), 0.01 * _SMALLEST * interval)
        return interval / max(1, math.ceil(interval / wanted * (1.0 - _LONGER)))

    def _time_to_move(self, distance: float, rates: np.ndarray, scale: np.ndarray) -> float:
        """Return when something has moved by `distance` lengths.

        Without a length it is the one over which velocities change, speed over spectral radius.
        """
        known = scale[:, 0] > 0.0
        speeds = np.abs(rates[known] / scale[known]).max(initial=0.0)
        speed = max(float(speeds), 0.0 if known.all() else self.radius)
        return distance / speed if speed > 0.0 else math.inf

    def _warn(self, limit: float) -> None:
        assert self.fixed is not None
        if self.fixed > limit and not self._warned:
            self._warned = True
            warnings.warn(
                f"dt: {self.fixed:g} is beyond the stability limit {limit:.3g} of "
                f"{self.method.name!r} here (largest eigenvalue {self.radius:.3g} per time); use a "
                "smaller dt, dt='auto' or the integrator 'rkc2'",
                stacklevel=2,
            )

    def _error_ratio(self, new: np.ndarray, error: np.ndarray | None, scale: np.ndarray) -> float:
        """Return the largest error of the step in units of the tolerance; inf if not finite."""
        if not np.isfinite(new).all():
            return math.inf
        if not self.adaptive or error is None:
            return 0.0
        ratio = float(np.abs(error / scale).max(initial=0.0)) / self.tolerance
        return ratio if math.isfinite(ratio) else math.inf

    def _reject(self, h: float, ratio: float, interval: float, causes: list[Exception]) -> None:
        """Shorten the step; where that is of no use raise the first of the causes."""
        if not self.adaptive:
            raise causes[0]
        self.rejections += 1
        self.h = self._next(h, ratio, h)
        if self.h < _SMALLEST * interval:
            raise causes[0] if causes else StepSizeError(h)

    def _next(self, h: float, ratio: float, largest: float) -> float:
        """Return the next step to try, of size `largest` at most (elementary controller)."""
        assert self.method.error_order is not None
        power = -1.0 / (self.method.error_order + 1)
        best = h * _SAFETY * ratio**power if ratio > 0.0 else math.inf
        return min(max(best, 0.1 * h), largest)

    def _estimate_radius(
        self, f: Callable, z: np.ndarray, rates: np.ndarray, scale: np.ndarray
    ) -> None:
        self.radius, self.vector = spectral_radius(f, z, rates, scale, self.vector)
        self._renew_at = self.steps + _RENEW


def _filled(scale: np.ndarray, *displacements: np.ndarray) -> np.ndarray:
    """Return `scale`, and where it is 0 the largest of the displacements there."""
    without = scale[:, 0] == 0.0
    largest = max(float(np.abs(moved[without]).max()) for moved in displacements)
    return np.where(scale == 0.0, largest or 1.0, scale)  # nothing moves: any unit will do


def _not_finite(values: np.ndarray) -> list[int]:
    return np.flatnonzero(~np.isfinite(values).all(axis=1)).tolist()


def _require_finite(values: np.ndarray) -> None:
    lost = _not_finite(values)
    if lost:
        raise NotFiniteError(lost[0])
