"""Trackers that report how a run is doing, and where its time went."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from tqdm import tqdm

from mrs.output.atomic import replacing
from mrs.output.trackers import Tracker
from mrs.time.interrupts import Never

if TYPE_CHECKING:
    from mrs.run.simulation import Simulation

_BAR = "{l_bar}{bar}| t={n:.4g}/{total:.4g} [{elapsed}<{remaining}, {rate_fmt}]"


class Progress(Tracker):
    """A bar of simulated time, which starts after the first evaluation: compilation is left out."""

    def initialize(self, sim: Simulation) -> None:
        sim.scene.evaluate(sim.time, sim.state)
        self._bar = tqdm(total=sim.t_end, initial=sim.time, unit="t", disable=None, bar_format=_BAR)

    def handle(self, sim: Simulation) -> None:
        self._bar.update(sim.time - self._bar.n)

    def finalize(self, sim: Simulation) -> None:
        if hasattr(self, "_bar"):
            self._bar.close()


class ProfileTable(Tracker):
    """Prints, at the end, where the time went; and writes profile.csv with the other files."""

    when = Never()

    def finalize(self, sim: Simulation) -> None:
        print(sim.profile)
        if sim.output is not None:
            with replacing(Path(sim.output.directory) / "profile.csv") as temporary:
                temporary.write_text(sim.profile.csv())

    def output_files(self, sim: Simulation) -> list[Path]:
        return [] if sim.output is None else [Path(sim.output.directory) / "profile.csv"]
