"""Trackers watch a run: each is called when its interrupt is due, and at the end of the run."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from mrs.time.interrupts import Interrupt, Steps

if TYPE_CHECKING:
    from mrs.run.simulation import Simulation


class Tracker:
    """Something that is done during a run.

    Attributes
    ----------
    when : Interrupt
        When `handle` is called: after every step by default.

    Examples
    --------
    >>> import mrs
    >>> class Report(mrs.Tracker):
    ...     when = mrs.Interval(0.5)
    ...
    ...     def handle(self, sim):
    ...         print(f"t = {sim.time:g}, x = {sim.state.positions[0, 0]:.3f}")
    >>> fluid, dust = mrs.Fluid(background=mrs.flows.shear(1.0)), mrs.Tracers([[0, 0, 1]])
    >>> sim = mrs.Simulation(fluid, [dust], trackers=[Report()]).run(1.0)
    t = 0.5, x = 0.500
    t = 1, x = 1.000
    """

    when: Interrupt = Steps()

    def initialize(self, sim: Simulation) -> None:
        """Begin.

        Parameters
        ----------
        sim : Simulation
            `resumed` says whether an earlier run goes on.
        """

    def handle(self, sim: Simulation) -> None:
        """Called when due, and at the end of the run."""

    def finalize(self, sim: Simulation) -> None:
        """Called when the run stops, also after an error or ctrl-C."""

    def output_files(self, sim: Simulation) -> list[Path]:
        """Return the files that it writes in the run directory: `overwrite` deletes these."""
        return []

    def damaged_files(self, sim: Simulation) -> dict[Path, str]:
        """Return the files that a run cannot go on with from the present time, and why."""
        return {}
