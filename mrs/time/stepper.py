"""Step sizes: fixed, from stability, or from the error; rejections; the choice of a method."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np

from mrs import check
from mrs.time.integrators import METHODS, Problem, Step
from mrs.time.integrators.base import Dense
from mrs.time.integrators.spectral import MARGIN, spectral_radius
from mrs.time.state import Arrays, State, below
from mrs.time.system import ConvergenceError, Local, StepSizeError, System

_SAFETY = 0.8  # of step sizes against the error and the stability limit
_LARGEST_MOVE = 0.1  # in one step of a method without an error estimate: lengths of bodies, radians
_WARNING = 1.02  # as `MARGIN`, where too early a warning is as bad as one too late
_RENEW = 50  # steps, after which the spectral radius is estimated again
_SMALLEST = 1e-10  # a step that has shrunk by this against its interval is given up
_SMALL = 1e-6  # perturbation where nothing has a length, beside coordinates and ways to go
_ROUNDING = 64.0 * np.finfo(float).eps  # of coordinates, in a step
_MEMORY = "memory/"  # before the names of arrays that a method remembers
AUTO = "auto"
_IMPLICIT, _STIFF, _NOT_STIFF = "bdf", "rkc2", "bs32"  # that "auto" chooses from
_FAILED = 3.0  # tries, after which another method is taken
_FORGIVEN = 0.5  # of them, for each step that succeeds
# Of the stepper, with the state of the method all on which the next step depends.
_REMEMBERED = (
    "h",
    "taken",
    "radius",
    "steps",
    "rejections",
    "_renew_at",
    "_explicit_until",
    "_failures",
)
_LONGER = 1e-6  # of a step asked for, by which it may be longer: late times are rounded coarsely


@check.spelling
@dataclass(frozen=True)
class Integrator:
    """How time is stepped.

    Parameters
    ----------
    name : str
        "auto", "bdf", "rkc2", "bs32", "euler", "heun", "rk4", or one that was registered. "auto"
        takes "bdf" for stiff bodies, and "rkc2" for a while where that fails. Else it takes "bs32",
        and "rkc2" where stability would shorten its steps.
    dt : float or "auto", optional
        A fixed step; or "auto": from the error with methods that estimate theirs ("bdf", "rkc2",
        "bs32"), with the others from the stability limit and so that nothing moves by more than a
        tenth of its length.
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

    name: str = AUTO
    dt: float | Literal["auto"] = "auto"
    tolerance: float = 1e-4

    def __post_init__(self) -> None:
        check.one_of("name", self.name, Integrator.names())
        if isinstance(self.dt, str) and self.dt != "auto":
            raise ValueError(f"dt must be 'auto' or a positive number, got {self.dt!r}")
        if self.dt != "auto":
            check.positive("dt", self.dt)
        check.number("tolerance", self.tolerance, 0.0, 1.0)
        if self.name == AUTO and self.dt != "auto":
            raise ValueError(f"dt must be 'auto' with the integrator {AUTO!r}, got {self.dt!r}")

    @staticmethod
    def names() -> tuple[str, ...]:
        """Return the allowed values of `name`."""
        return AUTO, *METHODS


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
        self._chooses = integrator.name == AUTO
        self.method = METHODS[_NOT_STIFF if self._chooses else integrator.name]
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
        self._explicit_until = 0
        self._failures = 0.0
        self._warned = False

    @property
    def h_lambda(self) -> float:
        """The last step times the spectral radius."""
        return self.taken * self.radius

    def history(self) -> tuple[Arrays, dict[str, Any]]:
        """Return all values besides the state on which the next step depends."""
        arrays = {} if self.vector is None else {"vector": self.vector}
        arrays |= {_MEMORY + name: array for name, array in (self.memory or {}).items()}
        values = {name.lstrip("_"): getattr(self, name) for name in _REMEMBERED}
        return arrays, values | {"method": self.method.name}

    def restore(self, arrays: Arrays, values: dict[str, Any]) -> None:
        """Take up a history."""
        self.vector = arrays.get("vector")
        self.memory = below(arrays, _MEMORY) or None
        self.method = METHODS[values["method"]]
        for name in _REMEMBERED:
            setattr(self, name, values[name.lstrip("_")])

    def restore_counts(self, values: dict[str, Any]) -> None:
        """Take up of a history how many steps there were, and choose the next one anew."""
        self.steps, self.rejections = values["steps"], values["rejections"]
        self._renew_at = self._explicit_until = self.steps

    def step(
        self, system: System, time: float, state: State, stop: float, end: float | None = None
    ) -> tuple[float, State]:
        """Return time and state after one accepted step, not beyond `stop`.

        Parameters
        ----------
        system : System
        time : float
        state : State
        stop : float
        end : float, optional
            Up to which a method with dense output may step beyond `stop`. The state returned is
            then between two of its states, and the next call goes on from the later one.

        Raises
        ------
        NotFiniteError
            With the first row of the coordinates that is not finite.
        """
        if self._chooses:
            self._choose_implicit(system)
        dense = self.method if isinstance(self.method, Dense) else None
        if dense and self.memory:
            ahead = dense.newest(self.memory, time, state)
            if ahead is not None:
                if stop <= ahead[0]:
                    return stop, dense.at(self.memory, stop)
                time, state = ahead
        reached, state = self._step(system, time, state, end if dense and end else stop)
        if reached <= stop:
            return reached, state
        assert dense is not None
        assert self.memory is not None
        return stop, dense.at(self.memory, stop)

    def _step(self, system: System, time: float, state: State, stop: float) -> tuple[float, State]:
        """Return time and state after one accepted step, with which a step of the method ends."""
        local = Local(system, time, state)
        z = state.coordinates()
        interval = stop - time
        tries = 0
        while True:
            if self._limited and (tries or self.steps >= self._renew_at):
                self._estimate_radius(local, z, interval)
            if self._chooses:
                self._choose_explicit()
            if self.memory is None:
                self.memory = self.method.init(z)
            h = self._size(interval, local, system.error_scale)
            self.taken = h
            local.forget()
            allowed = self.tolerance * system.error_scale
            if not allowed.all():
                allowed = _filled(allowed, self.tolerance * h * local.rates(), _ROUNDING * z)
            problem = Problem(local.f, local.rates, self.radius, state, local.linearized, allowed)
            taken = self.method.step(problem, time, z, h, self.memory)
            new = taken.z
            unit = system.error_scale
            if not unit.all():
                rounding = _ROUNDING / self.tolerance * z  # is no error, even if nothing moves
                unit = _filled(unit, new - z, h * local.rates(), rounding)
            ratio = self._error_ratio(new, taken.error, unit) if taken.converged else math.inf
            if ratio <= 1.0:
                refused = system.refusal(time + h, state.moved(new))
                if refused is None:
                    break
                ratio = math.inf
                local.blamed.append(refused)
            causes = local.causes(new)
            if not taken.converged:
                causes.append(ConvergenceError(h))
            self._reject(h, ratio, interval, taken, causes)
            tries += 1
            self._failures += not math.isfinite(ratio)
            if self._chooses and self._failures >= _FAILED:
                self._give_up_implicit()
        self.steps += 1
        self._failures = max(0.0, self._failures - _FORGIVEN)
        self.memory = taken.memory or {}
        if self.adaptive:
            # One shortened to end on time says nothing against the longer one that was wanted.
            self.h = self._next(h, ratio, taken, h if tries else max(5.0 * h, self.h or 0.0))
        reached = stop if h == interval else time + h
        return reached, state.moved(new)

    def _choose_implicit(self, system: System) -> None:
        """Take the implicit method for stiff bodies, unless it has just failed."""
        implicit = self.method.name == _IMPLICIT
        if system.is_stiff and not implicit and self.steps >= self._explicit_until:
            self._use(_IMPLICIT)

    def _choose_explicit(self) -> None:
        """Take the explicit method of which accuracy, not stability, limits the step."""
        accurate, stable = METHODS[_NOT_STIFF], METHODS[_STIFF]
        if self.h is None or not self.radius or self.method.name == _IMPLICIT:
            return
        longest = _SAFETY * accurate.stability_interval() / (MARGIN * self.radius)
        if self.method is accurate and self.h > longest:
            self._use(stable.name)
        elif self.method is stable and self.h < 0.5 * longest:
            self._use(accurate.name)

    def _give_up_implicit(self) -> None:
        """Go on with an explicit method for a while, where corrections do not converge."""
        if self.method.name == _IMPLICIT:
            self._use(_STIFF)
            self.h, self._renew_at, self._failures = None, self.steps, 0.0
            self._explicit_until = self.steps + _RENEW

    def _use(self, name: str) -> None:
        """Step by another method from now on."""
        self.method, self.memory = METHODS[name], None

    @property
    def _limited(self) -> bool:
        """Whether there is a limit of stability."""
        return math.isfinite(self.method.stability_interval())

    def _size(self, interval: float, local: Local, scale: np.ndarray) -> float:
        """Return the step to try: whole steps fill the interval evenly, none is left tiny."""
        limit = (
            self.method.stability_interval() / (MARGIN * self.radius) if self.radius else math.inf
        )
        if self.fixed is not None:
            self.h = self.fixed
            self._warn(limit * MARGIN / _WARNING)
        elif not self.adaptive:
            self.h = min(_SAFETY * limit, self._time_to_move(_LARGEST_MOVE, local.rates(), scale))
        elif self.h is None:
            first = 0.1 * math.sqrt(self.tolerance)
            self.h = min(interval, self._time_to_move(first, local.rates(), scale))
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

    def _reject(
        self, h: float, ratio: float, interval: float, taken: Step, causes: list[Exception]
    ) -> None:
        """Shorten the step; where that is of no use raise the first of the causes."""
        if not self.adaptive:
            raise causes[0]
        self.rejections += 1
        self.memory = taken.again or self.memory
        growth = None if taken.converged else taken.growth
        self.h = self._next(h, ratio, taken._replace(growth=growth), h)
        if self.h < _SMALLEST * interval:
            raise causes[0] if causes else StepSizeError(h)

    def _next(self, h: float, ratio: float, taken: Step, largest: float) -> float:
        """Return the next step to try, of size `largest` at most (elementary controller)."""
        order = taken.error_order or self.method.error_order
        assert order is not None
        power = -1.0 / (order + 1)
        best = h * _SAFETY * ratio**power if ratio > 0.0 else math.inf
        if taken.growth is not None:
            best = h * taken.growth
        return min(max(best, 0.1 * h), largest)

    def _estimate_radius(self, local: Local, z: np.ndarray, interval: float) -> None:
        rates, small = local.rates(), local.system.perturbation
        if not small.all():
            small = _filled(small, _SMALL * z, _SMALL * interval * rates)
        self.radius, self.vector = spectral_radius(local.beside, z, rates, small, self.vector)
        self._renew_at = self.steps + _RENEW


def _filled(scale: np.ndarray, *displacements: np.ndarray) -> np.ndarray:
    """Return `scale`, and where it is 0 the largest of the displacements there."""
    without = scale[:, 0] == 0.0
    largest = max(float(np.abs(moved[without]).max()) for moved in displacements)
    return np.where(scale == 0.0, largest or 1.0, scale)  # nothing moves: any unit will do
