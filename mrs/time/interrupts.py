"""Conditions when something happens in a run: by simulated time, by steps, by real time."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mrs import check

if TYPE_CHECKING:
    from mrs.run.simulation import Simulation

# Of an interval, by which a time may miss a multiple and still count as that multiple: 3 * 0.1 is
# not 0.3, which a user may have typed as the end of a run.
_ROUNDING = 1e-9


class Moment(NamedTuple):
    """How far a run is.

    Examples
    --------
    >>> import mrs
    >>> dust = mrs.Tracers([[0.0, 0.0, 1.0]])
    >>> fluid, step = mrs.Fluid(background=mrs.flows.shear(1.0)), mrs.Integrator("euler", dt=0.25)
    >>> sim = mrs.Simulation(fluid, [dust], integrator=step).run(1.0)
    >>> sim.moment.time, sim.moment.steps
    (1.0, 4)
    """

    time: float
    """Simulated time."""
    steps: int
    """Accepted steps since time zero, also over resumes."""
    seconds: float
    """Real time since this run has begun or was resumed."""


class Interrupt:
    """A condition when something happens; it is asked after every step.

    Examples
    --------
    >>> import mrs
    >>> class Far(mrs.Interrupt):
    ...     def due(self, before, sim):
    ...         return sim.state.positions[0, 0] > 2.0
    >>> class Report(mrs.Tracker):
    ...     when = Far()
    ...
    ...     def handle(self, sim):
    ...         print(f"x = {sim.state.positions[0, 0]:.2f}")
    >>> dust = mrs.Tracers([[1.0, 0.0, 0.0]])
    >>> fluid = mrs.Fluid(background=mrs.flows.extension(rate=1.0))
    >>> step = mrs.Integrator("rk4", dt=0.25)
    >>> sim = mrs.Simulation(fluid, [dust], integrator=step, trackers=[Report()]).run(1.0)
    x = 2.12
    x = 2.72
    """

    def next_time(self, time: float) -> float:
        """Return the next simulated time that a step must not pass; infinite by default."""
        return math.inf

    def due(self, before: Moment, sim: Simulation) -> bool:
        """Return whether the step that began at `before`, and ended at ``sim.moment``, meets it."""
        raise NotImplementedError


@dataclass(frozen=True)
class Interval(Interrupt):
    """At the multiples of an interval of simulated time, at which steps end exactly.

    Parameters
    ----------
    interval : float

    Examples
    --------
    >>> import mrs
    >>> every = mrs.Interval(0.25)
    >>> every.next_time(0.6), every.count(0.6)
    (0.75, 2)
    """

    interval: float

    def __post_init__(self) -> None:
        check.positive("interval", self.interval)

    def count(self, time: float) -> int:
        """Return how many intervals are over at `time`: times are counted, not compared."""
        intervals = time / self.interval
        return math.floor(intervals + max(_ROUNDING, 4.0 * np.finfo(float).eps * intervals))

    def at_multiple(self, time: float) -> bool:
        """Return whether `time` is a multiple, but for rounding."""
        return abs(time - self.count(time) * self.interval) <= _ROUNDING * self.interval

    def next_time(self, time: float) -> float:
        """Return the next multiple."""
        return (self.count(time) + 1) * self.interval

    def due(self, before: Moment, sim: Simulation) -> bool:
        """Return whether the step has ended an interval."""
        return self.count(sim.moment.time) > self.count(before.time)


@dataclass(frozen=True)
class Steps(Interrupt):
    """After every `count` steps.

    Parameters
    ----------
    count : int, optional

    Examples
    --------
    >>> import mrs
    >>> class Report(mrs.Tracker):
    ...     when = mrs.Steps(2)
    ...
    ...     def handle(self, sim):
    ...         print(f"t = {sim.time:g}")
    >>> fluid, dust = mrs.Fluid(background=mrs.flows.shear(1.0)), mrs.Tracers([[0, 0, 1]])
    >>> step = mrs.Integrator("euler", dt=0.25)
    >>> sim = mrs.Simulation(fluid, [dust], integrator=step, trackers=[Report()]).run(1.0)
    t = 0.5
    t = 1
    """

    count: int = 1

    def __post_init__(self) -> None:
        check.integer("count", self.count, 1)

    def due(self, before: Moment, sim: Simulation) -> bool:
        """Return whether the step was the last one of `count`."""
        return sim.moment.steps // self.count > before.steps // self.count


@dataclass(frozen=True)
class WallTime(Interrupt):
    """After the first step that ends in another multiple of some seconds of real time.

    Parameters
    ----------
    seconds : float
        0 is after every step.

    Examples
    --------
    >>> import mrs
    >>> class Watch(mrs.Tracker):
    ...     when = mrs.WallTime(3600.0)  # each hour
    ...
    ...     def handle(self, sim):
    ...         print(f"t = {sim.time:g}")  # at the end in any case
    >>> fluid, dust = mrs.Fluid(background=mrs.flows.shear(1.0)), mrs.Tracers([[0, 0, 1]])
    >>> sim = mrs.Simulation(fluid, [dust], trackers=[Watch()]).run(1.0)
    t = 1
    """

    seconds: float

    def __post_init__(self) -> None:
        check.not_negative("seconds", self.seconds, 1e9)

    def due(self, before: Moment, sim: Simulation) -> bool:
        """Return whether a multiple has passed during the step."""
        if self.seconds == 0.0:
            return True
        return sim.moment.seconds // self.seconds > before.seconds // self.seconds


class Never(Interrupt):
    """Only at the end of the run.

    Examples
    --------
    >>> import mrs
    >>> class Last(mrs.Tracker):
    ...     when = mrs.Never()
    ...
    ...     def handle(self, sim):
    ...         print(f"the end, t = {sim.time:g}")
    >>> dust = mrs.Tracers([[0.0, 0.0, 1.0]])
    >>> sim = mrs.Simulation(mrs.Fluid(background=mrs.flows.shear(1.0)), [dust], trackers=[Last()])
    >>> sim = sim.run(2.0)
    the end, t = 2
    """

    def due(self, before: Moment, sim: Simulation) -> bool:
        """Return False."""
        return False


def next_stop(interrupts: Iterable[Interrupt], time: float, t_end: float) -> float:
    """Return the time up to which steps may go: the end, or before it when one is due.

    Times that differ by rounding are one, so that no step is a rounding error long.
    """
    stop = min((interrupt.next_time(time) for interrupt in interrupts), default=math.inf)
    return t_end if t_end - stop <= _ROUNDING * (t_end - time) else stop
