"""A run on disk, opened for reading."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from mrs import check
from mrs.output import run_directory
from mrs.output.frames import Frames, trajectories, trajectory_paths
from mrs.output.log_table import LogTable
from mrs.output.stored import StoredFrame
from mrs.output.stored_body import StoredBody
from mrs.run.info import info
from mrs.run.velocity import stored_frame
from treecode.shown import Shown

if TYPE_CHECKING:
    import pyvista as pv
    import xarray as xr

    from mrs.output.inline import Picture

_LOG = "log.csv"


class Run(Shown):
    """A run on disk, which may still go on: the frames that it had when it was opened.

    It stands for its directory wherever a path is wanted: ``mrs.observables.tracks(run, "dust")``,
    ``mrs.write_field(run)``, ``Path(run)``.

    Parameters
    ----------
    directory : path
        Of the run.

    Attributes
    ----------
    directory : Path
    times : (frames,) float ndarray
        Of the frames that all bodies have.
    bodies : tuple of str
        Names of the bodies: ``run["cilia"]`` is one, a `StoredBody`.

    Raises
    ------
    FileNotFoundError
        If the directory holds no run.
    DamagedError
        If a trajectory is damaged; the message names a remedy.

    Notes
    -----
    Files are opened for each reading, and no reader stops a run. If the frames are no longer in
    a file, because the run was begun anew or goes on from an earlier time, reading them raises an
    error until `refresh` is called.

    Examples
    --------
    >>> import mrs
    >>> sim = mrs.Simulation(
    ...     mrs.Fluid(background=mrs.flows.shear(1.0)),
    ...     [mrs.Tracers([[0.0, 0.0, 1.0]], name="dust")],
    ...     output=mrs.Output("outputs/sheared", interval=0.5),
    ... )
    >>> sim = sim.run(1.0)
    >>> run = mrs.open_run("outputs/sheared")
    >>> run.bodies, run.times.tolist()
    (('dust',), [0.0, 0.5, 1.0])
    >>> print(run["dust"].positions[:, 0, 0].round(6))  # x of the first tracer in all frames
    [0.  0.5 1. ]
    """

    def __init__(self, directory: str | os.PathLike[str]) -> None:
        self.directory = Path(directory)
        self.refresh()

    def refresh(self) -> Run:
        """Look for new frames, and return itself; what was taken before stays as it was."""
        try:
            trajectory_paths(self.directory)
        except FileNotFoundError:
            run_directory.read(self.directory)  # a run that has only begun, or has other formats
            self._bodies: dict[str, StoredBody] = {}
            self._numbers: list[int] = []
            self.times = np.empty(0)
        else:
            self._look()
        self.bodies = tuple(self._bodies)
        return self

    def _look(self) -> None:
        with trajectories(self.directory) as files:
            common = Frames(files)
            self._numbers = common.numbers
            self.times = np.array([common.times[number] for number in common.numbers])
            places = np.array([common.places(number) for number in common.numbers], int)
            places = places.reshape(-1, len(files))
            self._bodies = {
                file.path.stem: StoredBody(file, places[:, i]) for i, file in enumerate(files)
            }

    def __fspath__(self) -> str:
        return str(self.directory)

    def __getitem__(self, body: str) -> StoredBody:
        return self._bodies[check.key("body", body, self.bodies)]

    @property
    def config(self) -> dict[str, Any]:
        """The contents of config.toml: scenario and options, end of the run, versions."""
        return run_directory.read(self.directory)

    @property
    def info(self) -> dict[str, Any]:
        """How far the run is by now: `mrs.info`."""
        return info(self.directory)

    @property
    def log(self) -> LogTable:
        """The columns of log.csv by now, by name."""
        return LogTable(self.directory / _LOG)

    def velocity(self, points: ArrayLike, frame: int = -1) -> np.ndarray:
        """Return the velocity of the fluid in a frame, (N, 3); zero behind a wall.

        Parameters
        ----------
        points : (N, 3) array_like
        frame : int, optional
            Index in `times`; the last by default.

        Raises
        ------
        IndexError, ValueError
            As for `mrs.frame_velocity`, which takes a background or a boundary that files cannot
            hold.
        """
        return self._stored(frame).velocity(check.points("points", points))

    def vorticity(self, points: ArrayLike, frame: int = -1) -> np.ndarray:
        """Return the curl of the velocity in a frame, (N, 3); zero behind a wall.

        Parameters
        ----------
        points : (N, 3) array_like
        frame : int, optional
            Index in `times`; the last by default.

        Raises
        ------
        IndexError, ValueError
            As for `velocity`, and if the background has no vorticity.
        """
        return self._stored(frame).vorticity(check.points("points", points))

    def pressure(self, points: ArrayLike, frame: int = -1) -> np.ndarray:
        """Return the pressure of the fluid in a frame, (N,), in free space.

        That of the bodies vanishes far away, that of the background at the origin.

        Parameters
        ----------
        points : (N, 3) array_like
        frame : int, optional
            Index in `times`; the last by default.

        Raises
        ------
        IndexError, ValueError
            As for `velocity`, and if the run has a wall or a periodic box, or if the background
            has no pressure.
        """
        return self._stored(frame).pressure(check.points("points", points))

    def _stored(self, frame: int) -> StoredFrame:
        return stored_frame(self, self._numbers[self._index(frame)])

    def mesh(self, frame: int = -1) -> pv.MultiBlock:
        """Return a frame of all bodies, with all arrays, as pyvista has it.

        Parameters
        ----------
        frame : int, optional
            Index in `times`; the last by default.
        """
        import pyvista as pv

        index = self._index(frame)
        return pv.MultiBlock({name: body.mesh(index) for name, body in self._bodies.items()})

    def show(self, frame: int = -1, **options: Any) -> Picture:
        """Return a picture of a frame, which a notebook shows.

        Parameters
        ----------
        frame : int, optional
            Index in `times`; the last by default.
        **options
            Those of `mrs.output.render.render` for a picture, such as `color_by` and `camera`.
        """
        from mrs.output.inline import picture_of

        return picture_of(self, frame=self._numbers[self._index(frame)], **options)

    def to_xarray(self) -> xr.DataTree:
        """Return a tree with a Dataset for each body; arrays stay in the files until they are used.

        Raises
        ------
        ImportError
            If xarray is not installed.
        """
        from mrs.output.labelled import tree

        return tree(self._bodies, self.times)

    def _index(self, frame: int) -> int:
        try:
            return range(len(self.times))[frame]
        except IndexError:
            count = len(self.times)
            raise IndexError(
                f"frame: {self.directory} has {count} frames, none number {frame}"
            ) from None

    def shown(self) -> dict[str, Any]:
        frames = f"{len(self.times)}"
        if len(self.times):
            frames += f", t = {self.times[0]:g} to {self.times[-1]:g}"
        return {"directory": self.directory, "frames": frames, "bodies": " ".join(self.bodies)}


def open_run(directory: str | os.PathLike[str]) -> Run:
    """Open a run for reading, also while it goes on.

    Parameters
    ----------
    directory : path
        Of the run. Of files that `mrs export` wrote in folders below it, nothing is read: other
        programs do, and pyvista.

    Returns
    -------
    Run

    Raises
    ------
    FileNotFoundError
        If the directory holds no run.
    DamagedError
        If a trajectory is damaged; the message names a remedy.

    Examples
    --------
    >>> import mrs
    >>> fluid, dust = mrs.Fluid(background=mrs.flows.shear(1.0)), mrs.Tracers([[0, 0, 1]])
    >>> output = mrs.Output("outputs/sheared", interval=0.5)
    >>> sim = mrs.Simulation(fluid, [dust], output=output).run(1.0)
    >>> mrs.open_run("outputs/sheared").times.tolist()
    [0.0, 0.5, 1.0]
    """
    return Run(directory)
