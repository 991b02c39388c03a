"""The flow in a stored frame of a run: as functions, and as files."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

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
) -> Field:
    """Write the velocity on a grid around the bodies, and streamlines, from a stored frame.

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
    """
    check.integer("resolution", resolution, 2, 1000)
    if plane is not None:
        axis, place = plane
        plane = check.one_of("plane[0]", axis, field.AXES), check.number("plane[1]", place, *_REACH)
    for name in also:
        check.one_of("also", name, QUANTITIES[1:])
    stored = stored_frame(directory, frame)
    grid = field.grid_around(stored.points, resolution, plane)
    arrays = {name: stored.values(name, grid.points) for name in ("velocity", *also)}
    errors = {name: stored.error(grid.points, array, name) for name, array in arrays.items()}
    error, velocity = errors.pop("velocity"), arrays.pop("velocity")
    if error.at_bodies > _APART * (stored.tolerance + error.rounding):
        warnings.warn(
            f"velocities stored with the frame differ by {error.at_bodies:.1e} from those of its "
            "forces: another viscosity or background held then, the files are of several runs, or "
            "the sums of the run were that far off",
            stacklevel=2,
        )
    folder = Path(directory if destination is None else destination)
    folder.mkdir(parents=True, exist_ok=True)
    names = ["field.vti"] if plane else ["field.vti", "streamlines.vtp"]
    paths = [folder / name for name in names]
    run_directory.note_made(directory, *paths)
    name = "disturbance" if stored.unknown else "velocity"
    numbers = {"time": stored.time} | {f"error_{k}": v for k, v in error._asdict().items()}
    for other, its in errors.items():
        numbers |= {f"{other}_error_sums": its.sums, f"{other}_error_rounding": its.rounding}
    field.write_grid(paths[0], grid, {name: velocity} | arrays, numbers)
    if plane is None:
        seeds = field.seeds_in(stored.points, max(2, resolution // 5))
        field.streamlines(paths[1], grid, velocity, seeds)
    return Field(paths, stored.time, error, errors)


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
