"""How far a run is, from its files alone."""

from __future__ import annotations

import os
import warnings
from pathlib import Path
from typing import Any

from mrs.output import checkpoint, log, run_directory
from mrs.output.atomic import DamagedError
from mrs.output.formats import FORMATS
from mrs.output.frame_files import BodyFile
from mrs.run.scenario_files import load_plugins


def info(directory: str | os.PathLike[str]) -> dict[str, Any]:
    """Return the state of a run, also while it goes on.

    Parameters
    ----------
    directory : path

    Returns
    -------
    dict
        The contents of config.toml; "time" and "steps" reached, the latest in any file, and whether
        the run is "finished"; time and steps of the "checkpoint", None before the first, and its
        "backends"; for each of the "files" its frames, points and last time, or its fault under
        "error"; the last row of the "log".

    Raises
    ------
    FileNotFoundError
        If there is no run in the directory.

    Examples
    --------
    >>> import mrs
    >>> fluid, dust = mrs.Fluid(background=mrs.flows.shear(1.0)), mrs.Tracers([[0, 0, 1]])
    >>> output = mrs.Output("outputs/sheared", interval=0.5)
    >>> sim = mrs.Simulation(fluid, [dust], output=output).run(1.0)
    >>> found = mrs.info("outputs/sheared")
    >>> found["time"], found["finished"], found["files"]["tracers.vtkhdf"]["frames"]
    (1.0, True, 3)
    """
    directory = Path(directory)
    content = run_directory.read(directory)
    _load_formats(content)
    by_suffix = {kind.suffix: kind for kind in FORMATS.values()}
    paths = [path for path in sorted(run_directory.noted(directory)) if path.suffix in by_suffix]
    own = [path for path in paths if path.parent == directory and path.exists()]
    files = {path.name: _file_info(by_suffix[path.suffix], path) for path in own}
    row = _log_info(directory / "log.csv")
    saved, backends = _checkpoint_info(directory / run_directory.CHECKPOINT)
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


def _load_formats(content: dict[str, Any]) -> None:
    """Load the plugins of a run, which may have registered formats of its files."""
    try:
        load_plugins(content.get("options", {}))
    except Exception as error:  # whatever happens in a user's file: the rest is told
        warnings.warn(f"files of formats of one's own are not told of: {error}", stacklevel=3)


def _file_info(kind: type[BodyFile], path: Path) -> dict[str, Any]:
    try:
        return kind.summary(path)
    except (OSError, ValueError) as error:  # the other files are reported all the same
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
    evaluation = values["evaluation"]
    sums = evaluation["sums"] + evaluation.get("resistance", {}).get("sums", [])
    return {"time": values["time"], "steps": values["integrator"]["steps"]}, sums
