"""The flow in a stored frame of a run: as functions, and as files."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from mrs import check
from mrs.fluid.flows import Flow
from mrs.fluid.mobility import Boundary
from mrs.output import field, run_directory
from mrs.output.stored import QUANTITIES, FieldError, StoredFrame
from mrs.run.resuming import scenario_of

_REACH = -1e60, 1e60  # of coordinates
_APART = 10.0  # times the error by tolerance and rounding, from which a warning is given


class Field(NamedTuple):
    """The files of `write_field`, their time, and the errors of the velocity and of the others."""

    paths: list[Path]
    time: float
    error: FieldError
    errors: dict[str, FieldError]


def frame_velocity(
    directory: str | os.PathLike[str],
    frame: int = -1,
    background: Flow | None = None,
    boundary: Boundary | None = None,
) -> tuple[np.ndarray, Callable[[np.ndarray], np.ndarray]]:
    """Return the points of a stored frame, (N, 3), and the velocity of the fluid as a function.

    Parameters
    ----------
    directory : path
        Of a run, made by a scenario or a script.
    frame : int, optional
        Its number; the last by default.
    background : Flow, optional
        Of the fluid, if it is none of `mrs.flows` with numbers that files can hold.
    boundary : treecode.Boundary, optional
        Of the fluid, if a script made the run; the boundary of a scenario is known.

    Raises
    ------
    IndexError
        If there is no such frame.
    ValueError
        If the files lack arrays on which the velocity depends, as files of earlier versions do.
        The function that is returned raises it if the boundary is unknown.

    Warns
    -----
    UserWarning
        If the background is unknown: the velocity is then the disturbance by the bodies.

    Notes
    -----
    The forces of the frame are in single precision; the sums have the tolerance of the run.

    Examples
    --------
    >>> import mrs
    >>> pusher = mrs.Swimmers([[0, 0, 0]], [[0, 0, 1]], length=1.0, force=1.0, epsilon=0.1)
    >>> output = mrs.Output("outputs/pusher", interval=0.5)
    >>> sim = mrs.Simulation(mrs.Fluid(), [pusher], output=output).run(0.5)
    >>> points, velocity = mrs.frame_velocity("outputs/pusher", frame=0)
    >>> print(velocity([[0.0, 0.0, 10.0]]).round(6))
    [[0.       0.       0.000723]]
    """
    stored = stored_frame(directory, frame, background, boundary)
    return stored.points, stored.velocity


def write_field(
    directory: str | os.PathLike[str],
    frame: int = -1,
    resolution: int = 40,
    destination: str | os.PathLike[str] | None = None,
    plane: tuple[str, float] | None = None,
    also: Sequence[str] = (),
    box: ArrayLike | None = None,
    seeds: ArrayLike | None = None,
) -> Field:
    """Write the velocity on a grid, and streamlines, from a stored frame.

    Parameters
    ----------
    directory : path
        Of a run, made by a scenario or a script. The scenario is read only for a background or a
        boundary that files cannot hold.
    frame : int, optional
        Its number; the last by default.
    resolution : int, optional
        Grid points along the longest side; a fifth as many streamlines start along it.
    destination : path, optional
        Folder to write to, the run directory by default.
    plane : (axis, place), optional
        In place of a box one plane across an axis, such as ("z", 0.5), without streamlines.
    also : sequence of str, optional
        Further arrays: "vorticity", "pressure". The pressure is known in free space.
    box : (2, 3) array_like, optional
        Two opposite corners of the grid; it may be flat. By default it is around the bodies.
    seeds : (m, 3) array_like, optional
        Points that streamlines go through; by default a regular pattern in the box.

    Returns
    -------
    Field
        field.vti and streamlines.vtp; the velocity is called "disturbance" if the background is
        unknown, and all other arrays are those of the disturbance too. The time and the errors are
        in the field data of field.vti.

    Raises
    ------
    IndexError, ValueError
        As for `frame_velocity`, and if the run has no such array, as a run over a wall has no
        pressure.

    Warns
    -----
    UserWarning
        If the background is unknown, if there are no streamlines, or if the velocities that are
        stored with the frame are others.

    Examples
    --------
    >>> import mrs
    >>> pusher = mrs.Swimmers([[0, 0, 0]], [[0, 0, 1]], length=1.0, force=1.0, epsilon=0.1)
    >>> output = mrs.Output("outputs/pusher", interval=0.5)
    >>> sim = mrs.Simulation(mrs.Fluid(), [pusher], output=output).run(0.5)
    >>> field = mrs.write_field("outputs/pusher", resolution=8, plane=("y", 0.0))
    >>> [path.name for path in field.paths]
    ['field.vti']
    """
    check.integer("resolution", resolution, 2, 1000)
    if plane is not None:
        axis, place = plane
        plane = check.one_of("plane[0]", axis, field.AXES), check.number("plane[1]", place, *_REACH)
    corners = None if box is None else _ends("box", box)
    stored = stored_frame(directory, frame)
    if corners is None:
        grid = field.grid_around(stored.points, resolution, plane)
    else:
        grid = field.grid_over(corners.min(axis=0), corners.max(axis=0), resolution, plane)
    flat = 1 in grid.dimensions
    if flat and seeds is not None:
        raise ValueError("seeds must be None for a plane: streamlines leave it")
    flow = _flow(stored, grid.points, also)
    names = ["field.vti"] if flat else ["field.vti", "streamlines.vtp"]
    paths = _paths(directory, destination, names)
    numbers = {"time": stored.time} | {f"error_{k}": v for k, v in flow.error._asdict().items()}
    for name, error in flow.errors.items():
        numbers |= {f"{name}_error_sums": error.sums, f"{name}_error_rounding": error.rounding}
    field.write_grid(paths[0], grid, flow.arrays, numbers)
    if not flat:
        inside = stored.points if corners is None else corners
        pattern = field.seeds_in(inside, max(2, resolution // 5))
        starts = pattern if seeds is None else check.points("seeds", seeds)
        field.streamlines(paths[1], grid, next(iter(flow.arrays.values())), starts)
    return Field(paths, stored.time, flow.error, flow.errors)


def write_line(
    directory: str | os.PathLike[str],
    line: ArrayLike,
    frame: int = -1,
    resolution: int = 40,
    destination: str | os.PathLike[str] | None = None,
    also: Sequence[str] = (),
) -> Field:
    """Write the velocity along a line from a stored frame.

    Parameters
    ----------
    directory : path
        Of a run, made by a scenario or a script.
    line : (2, 3) array_like
        Its two ends.
    frame : int, optional
        Its number; the last by default.
    resolution : int, optional
        Points along the line, both ends included.
    destination : path, optional
        Folder to write to, the run directory by default.
    also : sequence of str, optional
        Further columns: "vorticity", "pressure". The pressure is known in free space.

    Returns
    -------
    Field
        line.csv, with the distance from the first end, the position, and the components of the
        velocity and of the others. The velocity is called "disturbance" if the background is
        unknown.

    Raises
    ------
    IndexError, ValueError
        As for `write_field`.

    Warns
    -----
    UserWarning
        As for `write_field`.

    Examples
    --------
    >>> import mrs
    >>> import numpy as np
    >>> fluid, dust = mrs.Fluid(background=mrs.flows.shear(2.0)), mrs.Tracers([[0, 0, 1]])
    >>> output = mrs.Output("outputs/sheared", interval=0.5)
    >>> sim = mrs.Simulation(fluid, [dust], output=output).run(1.0)
    >>> (file,) = mrs.write_line("outputs/sheared", [(0, 0, 0), (0, 0, 1)], resolution=3).paths
    >>> print(np.genfromtxt(file, delimiter=",", names=True)["velocity_x"])
    [0. 1. 2.]
    """
    start, end = _ends("line", line)
    points = np.linspace(start, end, check.integer("resolution", resolution, 2, 10**6))
    stored = stored_frame(directory, frame)
    flow = _flow(stored, points, also)
    paths = _paths(directory, destination, ["line.csv"])
    field.write_line(paths[0], points, flow.arrays)
    return Field(paths, stored.time, flow.error, flow.errors)


class _Flow(NamedTuple):
    """Arrays by name, the velocity first, its errors, and those of the others."""

    arrays: dict[str, np.ndarray]
    error: FieldError
    errors: dict[str, FieldError]


def _flow(stored: StoredFrame, points: np.ndarray, also: Sequence[str]) -> _Flow:
    """Return the velocity and more at points, (M, 3); warn if it is not that of the run."""
    for name in also:
        check.one_of("also", name, QUANTITIES[1:])
    arrays = {name: stored.values(name, points) for name in ("velocity", *also)}
    errors = {name: stored.error(points, array, name) for name, array in arrays.items()}
    error = errors.pop("velocity")
    if error.at_bodies > _APART * (stored.tolerance + error.rounding):
        warnings.warn(
            f"velocities stored with the frame differ by {error.at_bodies:.1e} from those of its "
            "forces: another viscosity or background held then, the files are of several runs, or "
            "the sums of the run were that far off",
            stacklevel=3,
        )
    called = "disturbance" if stored.unknown else "velocity"
    return _Flow({called: arrays.pop("velocity")} | arrays, error, errors)


def _ends(name: str, value: ArrayLike) -> np.ndarray:
    """Return two points that are apart, (2, 3)."""
    ends = check.points(name, value)
    if len(ends) != 2 or (ends[0] == ends[1]).all():
        raise ValueError(f"{name} must be two points that are apart, got {ends.tolist()}")
    return ends


def _paths(
    directory: str | os.PathLike[str],
    destination: str | os.PathLike[str] | None,
    names: list[str],
) -> list[Path]:
    """Return where files go, in a folder that is there then, and note them as the run's own."""
    folder = Path(directory if destination is None else destination)
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / name for name in names]
    run_directory.note_made(directory, *paths)
    return paths


def stored_frame(
    directory: str | os.PathLike[str],
    frame: int,
    background: Flow | None = None,
    boundary: Boundary | None = None,
) -> StoredFrame:
    """Return a frame, with parts of the fluid from the run's scenario if files cannot hold them.

    The parameters are those of `StoredFrame`, and so are the errors that are raised.

    Warns
    -----
    UserWarning
        If the background is unknown.
    """
    stored = StoredFrame(directory, frame, background, boundary)
    lacks = stored.unknown or stored.unknown_boundary
    if lacks and "scenario" in run_directory.read(directory):
        fluid = scenario_of(directory).simulation().fluid
        return StoredFrame(
            directory, frame, background or fluid.background, boundary or fluid.boundary
        )
    if stored.unknown:
        warnings.warn(
            f"background: the run had a {stored.unknown}, which files cannot hold; velocities are "
            "those of the disturbance by the bodies, to which it must be added",
            stacklevel=3,
        )
    return stored
