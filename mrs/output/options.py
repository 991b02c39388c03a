"""Where and how often a run is written, and the trackers that do it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mrs import check
from mrs.output import paraview, run_directory
from mrs.output.checkpoint import Checkpoints
from mrs.output.formats import FORMATS
from mrs.output.frame_files import FrameFiles
from mrs.output.log import COLUMNS, LogFile
from mrs.output.trackers import Tracker
from mrs.time.interrupts import Interval

if TYPE_CHECKING:
    from mrs.run.simulation import Simulation


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
    formats : sequence of str, optional
        Of the trajectories: "vtkhdf"; "pvd", a .vtp file a frame and a list of them, for ParaView
        before 5.12; or one that was registered. Pictures, exports and fields are made of "vtkhdf".
    columns : dict of functions, optional
        Columns of log.csv besides those that it has, by name. A function takes the simulation, and
        returns a number or a text. If it has `labels`, it returns as many, each for a column
        NAME[LABEL]. If it has a method `require`, that is given the simulation before a run, and
        raises ValueError if it cannot be measured. Those of `mrs.observables` have both.
    precision : {"float32", "float64"}, optional
        Of forces, velocities and all other arrays in "vtkhdf" files that are begun; positions are
        doubles in any case. A file that a resumed run goes on with keeps its own.

    Examples
    --------
    >>> import mrs
    >>> columns = {"x": lambda sim: sim.state.positions[0, 0]}
    >>> sim = mrs.Simulation(
    ...     mrs.Fluid(background=mrs.flows.shear(1.0)),
    ...     [mrs.Tracers([[0.0, 0.0, 1.0]], name="dust")],
    ...     output=mrs.Output("outputs/sheared", interval=0.5, columns=columns),
    ... )
    >>> sim = sim.run(1.0)
    >>> print(mrs.open_run("outputs/sheared").log["x"].round(6))
    [0.  0.5 1. ]
    """

    directory: str | Path
    interval: float
    checkpoint_seconds: float = 30.0
    overwrite: bool = False
    formats: Sequence[str] = ("vtkhdf",)
    columns: Mapping[str, Callable[[Simulation], Any]] = field(default_factory=dict)
    precision: str = "float32"

    def __post_init__(self) -> None:
        if not isinstance(self.directory, (str, Path)):
            raise TypeError(f"directory must be a path, got {self.directory!r}")
        check.positive("interval", self.interval)
        check.not_negative("checkpoint_seconds", self.checkpoint_seconds, 1e9)
        check.flag("overwrite", self.overwrite)
        check.one_of("precision", self.precision, ("float32", "float64"))
        if isinstance(self.formats, str):
            raise TypeError(f"formats must be a list of texts, got {self.formats!r}")
        for i, name in enumerate(self.formats):
            check.one_of(f"formats[{i}]", name, FORMATS)
        if len(set(self.formats)) < len(self.formats):
            raise ValueError(f"formats must be different ones, got {self.formats!r}")
        if not isinstance(self.columns, Mapping):
            raise TypeError(f"columns must be a dict of functions by name, got {self.columns!r}")
        for name, function in self.columns.items():
            if not isinstance(name, str) or name in COLUMNS:
                raise ValueError(
                    f"columns must have names other than {', '.join(COLUMNS)}, got {name!r}"
                )
            check.function(f"columns[{name!r}]", function, "the simulation")

    def trackers(self, sim: Simulation) -> list[Tracker]:
        """Return the trackers that write a run; the first checkpoint comes before any work.

        Parameters
        ----------
        sim : Simulation

        Raises
        ------
        ValueError
            If a column cannot be measured in it.
        """
        for name, column in self.columns.items():
            try:
                getattr(column, "require", lambda _: None)(sim)
            except ValueError as error:
                raise ValueError(f"columns[{name!r}]: {error}") from None
        directory, when = Path(self.directory), Interval(float(self.interval))
        files = [FORMATS[name](directory, body) for name in self.formats for body in sim.bodies]
        log = LogFile(directory / "log.csv", when, self.columns, sim.scene.resistance is not None)
        return [
            Checkpoints(directory / run_directory.CHECKPOINT, self.checkpoint_seconds),
            paraview.Macro(directory),
            FrameFiles([*files, log], when),
        ]
