"""Trackers watch a run; each is called at the multiples of its interval of simulated time."""

from __future__ import annotations

import math
import time as clock
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from tqdm import tqdm

from mrs import check, rundir
from mrs.output import checkpoint, live, log, paraview, vtkhdf
from mrs.output.atomic import DamagedError, WriteError, replacing, sync
from mrs.stored import fluid_meta

if TYPE_CHECKING:
    from mrs.bodies import Body
    from mrs.simulation import Simulation


@check.spelling
@dataclass(frozen=True)
class Output:
    """Where and how often a run is written.

    Parameters
    ----------
    directory : path
    interval : float
        Simulated time between frames, and between rows of the log.
    checkpoint_seconds : float, optional
        Seconds of real time between checkpoints; one is written at the end in any case.
    overwrite : bool, optional
        Delete an earlier run in the same directory.
    live : bool, optional
        Write a .vtp file a frame and a .pvd as well, for ParaView before 5.12.
    """

    directory: str | Path
    interval: float
    checkpoint_seconds: float = 30.0
    overwrite: bool = False
    live: bool = False

    def __post_init__(self) -> None:
        if not isinstance(self.directory, (str, Path)):
            raise TypeError(f"directory must be a path, got {self.directory!r}")
        check.positive("interval", self.interval)
        check.not_negative("checkpoint_seconds", self.checkpoint_seconds, 1e9)
        check.flag("overwrite", self.overwrite)
        check.flag("live", self.live)


# Of an interval, by which a time may miss a multiple and still count as that multiple: 3 * 0.1 is
# not 0.3, and the end of a run is what the user typed.
_ROUNDING = 1e-9


class Tracker:
    """Called at the multiples of `interval` in simulated time, and at the end of a run.

    With an interval of None it is called after every step.
    """

    interval: float | None = None

    def initialize(self, sim: Simulation) -> None:
        """Begin; `sim.resumed` says whether an earlier run goes on."""

    def count(self, time: float) -> int:
        """Return how many intervals are over at `time`: times are counted, not compared."""
        assert self.interval is not None
        intervals = time / self.interval
        return math.floor(intervals + max(_ROUNDING, 4.0 * np.finfo(float).eps * intervals))

    def next_time(self, time: float) -> float:
        """Return the next time that a step must not pass."""
        return math.inf if self.interval is None else (self.count(time) + 1) * self.interval

    def due(self, before: float, time: float) -> bool:
        """Return whether a step from `before` to `time` ends an interval."""
        return self.interval is None or self.count(time) > self.count(before)

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


def next_stop(trackers: Iterable[Tracker], time: float, t_end: float) -> float:
    """Return the time up to which steps may go: the end, or before it when a tracker is due.

    Times that differ by rounding are one, so that no step is a rounding error long.
    """
    stop = min((tracker.next_time(time) for tracker in trackers), default=math.inf)
    return t_end if t_end - stop <= _ROUNDING * (t_end - time) else stop


class _Frames(Tracker):
    """Writes the start, the multiples of the interval and the end, each once also over resumes."""

    interval: float

    def __init__(self, output: Output) -> None:
        self.directory = Path(output.directory)
        self.interval = float(output.interval)

    def initialize(self, sim: Simulation) -> None:
        wanted = self._at_multiple(sim.time) or sim.time >= sim.t_end
        for path, body in self.paths(sim):
            had_one = sim.time in sim.written.get(path.name, ())
            if self.cut(sim, path, body) != sim.time and (wanted or had_one):
                self._append(sim, path, body)

    def handle(self, sim: Simulation) -> None:
        for path, body in self.paths(sim):
            self._append(sim, path, body)

    def output_files(self, sim: Simulation) -> list[Path]:
        return [path for path, _ in self.paths(sim)]

    def damaged_files(self, sim: Simulation) -> dict[Path, str]:
        found = {path: self._fault(sim, path, body) for path, body in self.paths(sim)}
        return {path: fault for path, fault in found.items() if fault}

    def _fault(self, sim: Simulation, path: Path, body: Body | None) -> str:
        """Return why a run cannot go on with a file; empty if it can."""
        noted = sim.written.get(path.name, ())
        if not path.exists():
            return "is missing" if noted else ""
        try:
            times = self.times(sim, path, body)
        except DamagedError as error:
            return error.reason
        last = max((time for time in times if time <= sim.time), default=-math.inf)
        lost = [time for time in noted if last < time < sim.time]  # that of now is made again
        until = "has no frames" if last == -math.inf else f"ends at t = {last:g}"
        return f"{until}, but was written to t = {lost[-1]:g}" if lost else ""

    def _append(self, sim: Simulation, path: Path, body: Body | None) -> None:
        self.write(sim, path, body)
        sim.written[path.name] = [*sim.written.get(path.name, ())[-1:], sim.time]

    def _at_multiple(self, time: float) -> bool:
        return abs(time - self.count(time) * self.interval) <= _ROUNDING * self.interval

    def paths(self, sim: Simulation) -> list[tuple[Path, Body | None]]:
        """Return the files, and the bodies that they show."""
        raise NotImplementedError

    def times(self, sim: Simulation, path: Path, body: Body | None) -> Sequence[float]:
        """Return the times in a file; raise DamagedError if it is none of this scene."""
        raise NotImplementedError

    def cut(self, sim: Simulation, path: Path, body: Body | None) -> float | None:
        """Drop what is later than the state, and return the time of the last frame left."""
        raise NotImplementedError

    def write(self, sim: Simulation, path: Path, body: Body | None) -> None:
        """Append a frame."""
        raise NotImplementedError


class _BodyFiles(_Frames):
    """A file for each body."""

    suffix: str

    def paths(self, sim: Simulation) -> list[tuple[Path, Body | None]]:
        return [(self.directory / f"{body.name}{self.suffix}", body) for body in sim.bodies]


class Trajectories(_BodyFiles):
    """One transient VTKHDF file a body."""

    suffix = ".vtkhdf"

    def initialize(self, sim: Simulation) -> None:
        paraview.write_macro(self.directory)
        super().initialize(sim)

    def output_files(self, sim: Simulation) -> list[Path]:
        return [*super().output_files(sim), self.directory / paraview.MACRO]

    def times(self, sim: Simulation, path: Path, body: Body | None) -> Sequence[float]:
        assert body is not None
        points = sim.point_count(body)
        topology = vtkhdf.Topology(*body.topology())
        with vtkhdf.Trajectory(path) as found:
            kind = found.meta.get("kind")
            if kind != body.kind:
                raise DamagedError(
                    path, f"is of another scene: its body is {kind}, not {body.kind}"
                )
            if found.size not in (0, points):
                raise DamagedError(
                    path, f"is of another scene: it has {found.size} points, not {points}"
                )
            if not vtkhdf.same_topology(found.topology, topology):
                raise DamagedError(path, "is of another scene: other points are joined by lines")
            return found.times.tolist()

    def cut(self, sim: Simulation, path: Path, body: Body | None) -> float | None:
        assert body is not None
        if path.exists():
            return vtkhdf.cut(path, sim.time)
        fluid = sim.fluid.viscosity, sim.fluid.background, sim.backend.tolerance
        meta = {"kind": body.kind, **rundir.versions(), **_META, **fluid_meta(*fluid)}
        topology = vtkhdf.Topology(*body.topology())
        vtkhdf.create(path, topology, *sim.constant_fields(body), meta)
        return None

    def write(self, sim: Simulation, path: Path, body: Body | None) -> None:
        assert body is not None
        vtkhdf.append(path, sim.time, *sim.frame(body))

    def finalize(self, sim: Simulation) -> None:
        for path, _ in self.paths(sim):
            if path.exists():
                with suppress(WriteError):  # a full disk: the room for more frames stays
                    vtkhdf.trim(path)


class Live(_BodyFiles):
    """One .vtp a body and frame, and a .pvd for each body."""

    suffix = ".pvd"

    def times(self, sim: Simulation, path: Path, body: Body | None) -> Sequence[float]:
        assert body is not None
        return live.times(path, sim.point_count(body))

    def cut(self, sim: Simulation, path: Path, body: Body | None) -> float | None:
        return live.cut(path, sim.time)

    def write(self, sim: Simulation, path: Path, body: Body | None) -> None:
        assert body is not None
        points, *varying = sim.frame(body)
        pairs = zip(sim.constant_fields(body), varying, strict=True)
        arrays = (constant | changing for constant, changing in pairs)
        rundir.note(self.directory, live.next_frame(path))
        live.append(path, sim.time, vtkhdf.Topology(*body.topology()), points, *arrays)


class Log(_Frames):
    """log.csv: how the run is doing."""

    _SAMPLE_EVERY = 10  # rows; a sampled error costs a sum and direct ones at 1000 targets

    def initialize(self, sim: Simulation) -> None:
        self._start = clock.monotonic()
        super().initialize(sim)

    def paths(self, sim: Simulation) -> list[tuple[Path, Body | None]]:
        return [(self.directory / "log.csv", None)]

    def times(self, sim: Simulation, path: Path, body: Body | None) -> Sequence[float]:
        return log.times(path)

    def cut(self, sim: Simulation, path: Path, body: Body | None) -> float | None:
        return log.cut(path, sim.time)

    def write(self, sim: Simulation, path: Path, body: Body | None) -> None:
        now = sim.evaluate(sim.time, sim.state)
        error: float | str = ""
        if self.count(sim.time) % self._SAMPLE_EVERY == 0:
            with sim.profile.stage("error samples"):
                error = sim.mobility.sampled_error(now.points, now.loads)
        row = {
            "step": sim.stepper.steps,
            "t": sim.time,
            "dt": sim.stepper.taken,
            "wall": round(clock.monotonic() - self._start, 3),
            "rejections": sim.stepper.rejections,
            "evaluations": sim.mobility.evaluations,
            "max_speed": float(np.linalg.norm(now.motion[:, :3], axis=1).max(initial=0.0)),
            "elastic_energy": sim.energy(),
            "sampled_error": error,
            "dt_lambda_max": sim.stepper.h_lambda,
            "backends": " ".join(map(str, sim.mobility.choices)),
        }
        log.append(path, row)


class Checkpoints(Tracker):
    """checkpoint.h5, every so many seconds of real time and at the end."""

    def __init__(self, output: Output) -> None:
        self.path = Path(output.directory) / "checkpoint.h5"
        self.seconds = output.checkpoint_seconds

    def initialize(self, sim: Simulation) -> None:
        self._last = clock.monotonic()
        self._saved: float | None = None
        if not sim.resumed:
            self._save(sim)

    def output_files(self, sim: Simulation) -> list[Path]:
        return [self.path, checkpoint.previous(self.path)]

    def handle(self, sim: Simulation) -> None:
        if clock.monotonic() - self._last >= self.seconds:
            self._save(sim)

    def finalize(self, sim: Simulation) -> None:
        if self._saved != sim.time:
            self._save(sim)

    def _save(self, sim: Simulation) -> None:
        for name in sim.written:  # a power cut must not keep the checkpoint, and not their frames
            with suppress(FileNotFoundError):
                sync(self.path.parent / name)
        checkpoint.save(self.path, *sim.snapshot())
        self._saved = sim.time
        self._last = clock.monotonic()


class Progress(Tracker):
    """A bar of simulated time, which starts after the first evaluation: compilation is left out."""

    def initialize(self, sim: Simulation) -> None:
        sim.evaluate(sim.time, sim.state)
        self._bar = tqdm(total=sim.t_end, initial=sim.time, unit="t", disable=None, bar_format=_BAR)

    def handle(self, sim: Simulation) -> None:
        self._bar.update(sim.time - self._bar.n)

    def finalize(self, sim: Simulation) -> None:
        if hasattr(self, "_bar"):
            self._bar.close()


class ProfileTable(Tracker):
    """Prints, at the end, where the time went; and writes profile.csv with the other files."""

    def finalize(self, sim: Simulation) -> None:
        print(sim.profile)
        if sim.output is not None:
            with replacing(Path(sim.output.directory) / "profile.csv") as temporary:
                temporary.write_text(sim.profile.csv())

    def output_files(self, sim: Simulation) -> list[Path]:
        return [] if sim.output is None else [Path(sim.output.directory) / "profile.csv"]


_BAR = "{l_bar}{bar}| t={n:.4g}/{total:.4g} [{elapsed}<{remaining}, {rate_fmt}]"
_META = {
    "force": "per node, on the fluid",
    "torque": "per node, on the fluid",
    "units": "those of the input",
}


def standard_trackers(output: Output | None) -> list[Tracker]:
    """Return those that write a run directory; the first checkpoint comes before any work."""
    if output is None:
        return []
    frames: list[Tracker] = [Trajectories(output), Log(output)]
    return [Checkpoints(output), *frames, *([Live(output)] if output.live else [])]
