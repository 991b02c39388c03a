"""Files with a frame, or a row, at each multiple of an interval, each once also over resumes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mrs.output.atomic import DamagedError, WriteError
from mrs.output.topology import Topology
from mrs.output.trackers import Tracker
from mrs.time.interrupts import Interval

if TYPE_CHECKING:
    from mrs.bodies import Body
    from mrs.run.simulation import Simulation


class FrameFile:
    """A file to which a run adds a frame now and then, and which a run that goes on cuts.

    Parameters
    ----------
    path : Path
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    def times(self, sim: Simulation) -> Sequence[float]:
        """Return the times of the frames.

        Parameters
        ----------
        sim : Simulation
            That goes on with the file.

        Raises
        ------
        DamagedError
            If it is damaged, or no file of this scene.
        """
        raise NotImplementedError

    def cut(self, sim: Simulation) -> float | None:
        """Drop the frames later than the state, and return the time of the last one left.

        A file that is missing is begun.

        Parameters
        ----------
        sim : Simulation
            That goes on with the file.
        """
        raise NotImplementedError

    def write(self, sim: Simulation) -> None:
        """Append a frame.

        Parameters
        ----------
        sim : Simulation
            Whose state it shows.
        """
        raise NotImplementedError

    def finish(self) -> None:
        """Called when the run stops."""


class BodyFile(FrameFile):
    """A file of one body, in a format that `FORMATS` knows by its name.

    Parameters
    ----------
    directory : Path
        Of the run.
    body : Body

    Attributes
    ----------
    name : str
        Of the format.
    suffix : str
        Of the file, which is called as its body.

    Examples
    --------
    >>> from pathlib import Path
    >>> import mrs
    >>> @mrs.FORMATS.register
    ... class Heights(mrs.BodyFile):  # a run that goes on needs `times` and `cut` as well
    ...     name, suffix = "heights", ".txt"
    ...
    ...     def cut(self, sim):
    ...         self.path.touch()
    ...
    ...     def write(self, sim):
    ...         with self.path.open("a") as file:
    ...             print(sim.time, sim.frame(self.body)[0][0, 2].round(4), file=file)
    >>> dust = mrs.Tracers([[0.0, 0.0, 1.0]], name="dust")
    >>> fluid = mrs.Fluid(background=mrs.flows.extension(rate=1.0))
    >>> output = mrs.Output("outputs/heights", interval=0.5, formats=["heights"])
    >>> sim = mrs.Simulation(fluid, [dust], output=output).run(1.0)
    >>> print(Path("outputs/heights/dust.txt").read_text().rstrip())
    0.0 1.0
    0.5 0.7788
    1.0 0.6065
    """

    name: str
    suffix: str

    def __init__(self, directory: Path, body: Body) -> None:
        super().__init__(directory / f"{body.name}{self.suffix}")
        self.body = body

    @cached_property
    def topology(self) -> Topology:
        """Points and lines of the body, which are the same in all frames."""
        return Topology(*self.body.topology())

    @classmethod
    def summary(cls, path: Path) -> dict[str, Any]:
        """Return "frames", "points" and the last "time" of such a file, for `mrs info`.

        Parameters
        ----------
        path : Path

        Raises
        ------
        ValueError, OSError
            If it cannot be read.
        """
        raise NotImplementedError


class FrameFiles(Tracker):
    """Writes the start, the multiples of the interval and the end to some files.

    Parameters
    ----------
    files : sequence of FrameFile
    when : Interval
    """

    when: Interval

    def __init__(self, files: Sequence[FrameFile], when: Interval) -> None:
        self.files, self.when = files, when

    def initialize(self, sim: Simulation) -> None:
        wanted = self.when.at_multiple(sim.time) or sim.time >= sim.t_end
        for file in self.files:
            had_one = sim.time in sim.written.get(file.path.name, ())
            if file.cut(sim) != sim.time and (wanted or had_one):
                _append(file, sim)

    def handle(self, sim: Simulation) -> None:
        for file in self.files:
            _append(file, sim)

    def finalize(self, sim: Simulation) -> None:
        for file in self.files:
            with suppress(WriteError):  # a full disk: the room for more frames stays
                file.finish()

    def output_files(self, sim: Simulation) -> list[Path]:
        return [file.path for file in self.files]

    def damaged_files(self, sim: Simulation) -> dict[Path, str]:
        found = {file.path: _fault(file, sim) for file in self.files}
        return {path: fault for path, fault in found.items() if fault}


def _append(file: FrameFile, sim: Simulation) -> None:
    file.write(sim)
    name = file.path.name
    sim.written[name] = [*sim.written.get(name, ())[-1:], sim.time]


def _fault(file: FrameFile, sim: Simulation) -> str:
    """Return why a run cannot go on with a file; empty if it can."""
    noted = sim.written.get(file.path.name, ())
    if not file.path.exists():
        return "is missing" if noted else ""
    try:
        times = file.times(sim)
    except DamagedError as error:
        return error.reason
    last = max((time for time in times if time <= sim.time), default=-math.inf)
    # The frame of the present time is made again.
    lost = [time for time in noted if last < time < sim.time]
    until = "has no frames" if last == -math.inf else f"ends at t = {last:g}"
    return f"{until}, but was written to t = {lost[-1]:g}" if lost else ""
