"""Runs in directories: begin, go on, look at."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mrs import check, rundir
from mrs.flows import Flow
from mrs.output import checkpoint, field, log, vtkhdf
from mrs.output.atomic import DamagedError
from mrs.scenario import Scenario, ScenarioError, make
from mrs.simulation import Simulation
from mrs.stored import FieldError, StoredFrame
from mrs.trackers import Tracker

Velocity = Callable[[np.ndarray], np.ndarray]
_APART = 10.0  # times what tolerance and rounding explain


def read_input(path: str | Path) -> tuple[str, dict[str, Any]]:
    """Return scenario and options of a TOML file: one of one's own, or the config.toml of a run.

    Raises
    ------
    ScenarioError
        If it is not TOML, or has keys besides `scenario`, `options`, and what a run adds.
    """
    content = rundir.load_toml(path)
    unknown = set(content) - {"scenario", "options", "run", "versions"}
    if unknown or "scenario" not in content:
        what = f"unknown {', '.join(sorted(unknown))}" if unknown else "no scenario"
        raise ScenarioError(
            f"{path}: {what}; a run made from a scenario, and an input file, have "
            '`scenario = "name"` and a table [options]'
        )
    scenario, options = content["scenario"], content.get("options", {})
    if not isinstance(scenario, str) or not isinstance(options, dict):
        raise ScenarioError(f"{path}: scenario must be a text and options a table")
    return scenario, options


def scenario_of(directory: str | Path) -> Scenario:
    """Return the scenario of a run.

    Raises
    ------
    ScenarioError
        If the run was made by a script.
    """
    if "scenario" not in rundir.read(directory):
        raise ScenarioError(
            f"{directory}: made by a script; build the same simulation there, and go on with "
            "mrs.restart(sim).run(t_end)"
        )
    return make(*read_input(Path(directory) / rundir.CONFIG))


def resume(
    directory: str | Path,
    t_end: float | None = None,
    trackers: Iterable[Tracker] = (),
    *,
    changes: bool = False,
    **options: Any,
) -> Simulation:
    """Go on with a run from its last checkpoint.

    Parameters
    ----------
    directory : path
    t_end : float, optional
        A new end; that of the run by default.
    trackers : sequence of Tracker, optional
        Besides those that write the run.
    changes : bool, optional
        Whether options in config.toml that change the physics may differ from what was run.
    **options
        As for `Simulation.run`: `max_walltime`, `renew_files`.

    Returns
    -------
    Simulation
        At its end.

    Raises
    ------
    FileNotFoundError
        If there is no run in the directory.
    ScenarioError
        If the run was made by a script and not from a scenario: build the same simulation there,
        and go on with ``restart(sim).run(t_end)``.
    """
    sim = restart(scenario_of(directory).simulation(directory), changes=changes)
    sim.trackers.extend(trackers)
    noted = rundir.read(directory)["run"]["t_end"]
    return sim.run(noted if t_end is None else t_end, **options)


def restart(sim: Simulation, *, changes: bool = False) -> Simulation:
    """Return `sim` in the state of the last checkpoint in its run directory, ready for `run`.

    Parameters
    ----------
    sim : Simulation
        Built as for the run, with its output directory.
    changes : bool, optional
        Whether fluid, bodies and steric repulsion may differ from those of the run. What differs
        is said in any case; another backend, integrator or output is taken up.

    Raises
    ------
    FileNotFoundError
        If there is no checkpoint.
    ValueError
        If `sim` has no output directory, or is another scene; see `Simulation.restore`.
    """
    if sim.output is None:
        raise ValueError("sim must have an output directory to go on from")
    directory = Path(sim.output.directory)
    sim.restore(*checkpoint.load(directory / rundir.CHECKPOINT), changes=changes)
    return sim


def info(directory: str | Path) -> dict[str, Any]:
    """Return what is known of a run, also while it goes on.

    Parameters
    ----------
    directory : path

    Returns
    -------
    dict
        What config.toml has; "time" and "steps" reached, the latest that any file knows, and
        whether the run is "finished"; time and steps of the "checkpoint", None before the first,
        and its "backends"; for each of the "files" its frames, points and last time, or what is
        wrong with it, under "error"; the last row of the "log".

    Raises
    ------
    FileNotFoundError
        If there is no run in the directory.
    """
    directory = Path(directory)
    content = rundir.read(directory)
    files = {path.name: _file_info(path) for path in sorted(directory.glob("[!.]*.vtkhdf"))}
    row = _log_info(directory / "log.csv")
    saved, backends = _checkpoint_info(directory / rundir.CHECKPOINT)
    known = [(row.get("t"), row.get("step"))]
    if saved is not None:
        known.append((saved.get("time"), saved.get("steps")))
    moments = [both for both in known if all(isinstance(n, (int, float)) for n in both)]
    time, steps = max(moments, default=(0.0, 0))
    times: list[float] = [file.get("time") or 0.0 for file in files.values()]
    time = max(time or 0.0, *times, 0.0)
    return content | {
        "time": time,
        "steps": steps,
        "finished": time >= content["run"]["t_end"],
        "checkpoint": saved,
        "backends": backends,
        "files": files,
        "log": row,
    }


def _file_info(path: Path) -> dict[str, Any]:
    try:
        with vtkhdf.Trajectory(path) as file:
            last = float(file.times[-1]) if len(file) else None
            return {"frames": len(file), "points": file.size, "time": last}
    except (OSError, ValueError) as error:  # the others are told of all the same
        return {"error": str(error).removeprefix(f"{path} ")}


def _log_info(path: Path) -> dict[str, Any]:
    try:
        return log.last(path)
    except DamagedError as error:
        return {"error": error.reason}


def _checkpoint_info(path: Path) -> tuple[dict[str, Any] | None, Any]:
    try:
        _, values = checkpoint.load(path)
    except FileNotFoundError:
        return None, []
    except ValueError as error:
        return {"error": str(error)}, []
    return {"time": values["time"], "steps": values["integrator"]["steps"]}, values["backends"]


class Field(NamedTuple):
    """What `write_field` wrote, of when, and how far it may be off."""

    paths: list[Path]
    time: float
    error: FieldError


def frame_velocity(
    directory: str | Path, frame: int = -1, background: Flow | None = None
) -> tuple[np.ndarray, Velocity]:
    """Return the points of a stored frame, (N, 3), and the velocity of the fluid as a function.

    Parameters
    ----------
    directory : path
        Of a run, whatever made it.
    frame : int, optional
        Its number; the last by default.
    background : Flow, optional
        Of the fluid, if it is none of `mrs.flows` with numbers that files can hold.

    Raises
    ------
    IndexError
        If there is no such frame.
    ValueError
        If the files lack what the velocity depends on, as those of earlier versions.

    Warns
    -----
    UserWarning
        If the background is unknown: the velocity is that of the disturbance by the bodies then.

    Notes
    -----
    Forces are those of the frame, in single precision; the sums have the tolerance of the run.
    """
    stored = _stored(directory, frame, background)
    return stored.points, stored.velocity


def write_field(
    directory: str | Path,
    frame: int = -1,
    resolution: int = 40,
    destination: str | Path | None = None,
) -> Field:
    """Write the velocity on a grid around the bodies, and streamlines, from a stored frame.

    Parameters
    ----------
    directory : path
        Of a run, whatever made it; nothing of the scenario or the script is needed.
    frame : int, optional
        Its number; the last by default.
    resolution : int, optional
        Grid points along the longest side; a fifth as many streamlines start along it.
    destination : path, optional
        Folder to write to, the run directory by default.

    Returns
    -------
    Field
        field.vti and streamlines.vtp; the array is called "disturbance" if the background is
        unknown, else "velocity". The time and the errors are in the field data of field.vti.

    Raises
    ------
    IndexError, ValueError
        As for `frame_velocity`.

    Warns
    -----
    UserWarning
        If the background is unknown, if there are no streamlines, or if the velocities that are
        stored with the frame are others.
    """
    check.integer("resolution", resolution, 2, 1000)
    stored = _stored(directory, frame)
    grid = field.grid_around(stored.points, resolution=resolution)
    values = stored.velocity(grid.points)
    error = stored.error(grid.points, values)
    if error.at_bodies > _APART * (stored.tolerance + error.rounding):
        warnings.warn(
            f"velocities stored with the frame differ by {error.at_bodies:.1e} from those of its "
            "forces: another viscosity or background held then, the files are of several runs, or "
            "the sums of the run were that far off",
            stacklevel=2,
        )
    folder = Path(directory if destination is None else destination)
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / name for name in ("field.vti", "streamlines.vtp")]
    rundir.note_made(directory, *paths)
    name = "disturbance" if stored.unknown else "velocity"
    numbers = {"time": stored.time} | {f"error_{k}": v for k, v in error._asdict().items()}
    field.write_field(paths[0], grid, {name: values}, numbers)
    seeds = field.seeds_in(stored.points, max(2, resolution // 5))
    field.streamlines(paths[1], grid, values, seeds)
    return Field(paths, stored.time, error)


def _stored(directory: str | Path, frame: int, background: Flow | None = None) -> StoredFrame:
    """Return a frame, with the background of the run's scenario if files cannot hold it."""
    stored = StoredFrame(directory, frame, background)
    if stored.unknown and "scenario" in rundir.read(directory):
        background = scenario_of(directory).simulation().fluid.background
        return StoredFrame(directory, frame, background)
    if stored.unknown:
        warnings.warn(
            f"background: the run had a {stored.unknown}, which files cannot hold; velocities are "
            "those of the disturbance by the bodies, to which it must be added",
            stacklevel=3,
        )
    return stored
