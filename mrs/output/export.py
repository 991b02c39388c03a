"""Trajectories as files of other programs, one a frame."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mrs.output.vtkhdf import Trajectory
from mrs.output.vtp import polydata, write_pvd, write_vtp

if TYPE_CHECKING:
    import meshio

# Of all that meshio writes, what reads back equal: with arrays, and points and cells only.
_WITH_ARRAYS = ("vtu", "xdmf", "vtk", "avs", "hmf", "med")
_WITHOUT_ARRAYS = ("ply", "bdf", "nas", "mdpa", "vol")
_WITH_LIST = ("vtp", "vtu")

FORMATS = ("vtp", *_WITH_ARRAYS, *_WITHOUT_ARRAYS)


def export(
    directory: str | os.PathLike[str],
    format: str,  # noqa: A002
    destination: str | os.PathLike[str] | None = None,
    frames: Iterable[int] | None = None,
) -> list[Path]:
    """Write frames of all trajectories of a run, ``<body>_000012.<format>`` for frame 12.

    Files in the same folder of frames that a body does not have, which a longer run has left there,
    are deleted.

    Parameters
    ----------
    directory : path
        Of the run.
    format : str
        One of `FORMATS`. "vtp" holds lines as they are, written by pyvista; all others come from
        meshio, where a line is a row of segments with the line's data each. "vtp" and "vtu" come
        with a .pvd, which lists the files and their times. "ply", "bdf", "nas", "mdpa" and "vol"
        have points and segments only.
    destination : path, optional
        Folder to write to, ``directory/format`` by default.
    frames : iterable of int, optional
        All by default; negative ones count from the end.

    Returns
    -------
    list of Path
        The files of frames, then the .pvd files.

    Raises
    ------
    ValueError
        If the format is unknown.
    FileNotFoundError
        If there are no trajectories.
    IndexError
        If there is no such frame.
    """
    suffix = format.removeprefix(".")
    if suffix not in FORMATS:
        raise ValueError(f"format must be one of {', '.join(FORMATS)}, got {format!r}")
    destination = Path(directory) / suffix if destination is None else Path(destination)
    paths = trajectory_paths(directory)
    destination.mkdir(parents=True, exist_ok=True)
    wanted = None if frames is None else list(frames)
    files, lists = [], []
    for path in paths:
        with Trajectory(path) as trajectory:
            written = _export(trajectory, suffix, destination, wanted)
        files += [file for _, file in written]
        if suffix in _WITH_LIST:
            lists.append(destination / f"{path.stem}.pvd")
            write_pvd(lists[-1], [(time, file.name) for time, file in written])
    return files + lists


def trajectory_paths(directory: str | os.PathLike[str]) -> list[Path]:
    """Return the trajectories of a run.

    Parameters
    ----------
    directory : path

    Raises
    ------
    FileNotFoundError
        If there are none.
    """
    paths = sorted(Path(directory).glob("[!.]*.vtkhdf"))
    if not paths:
        raise FileNotFoundError(f"no trajectories (*.vtkhdf) in {directory}")
    return paths


def _export(
    trajectory: Trajectory, suffix: str, destination: Path, frames: list[int] | None
) -> list[tuple[float, Path]]:
    every = range(len(trajectory))
    written = []
    for i in every if frames is None else [every[i] for i in frames]:
        file = destination / f"{trajectory.path.stem}_{i:06d}.{suffix}"
        if suffix == "vtp":
            frame = (trajectory.points(i), trajectory.point_data(i), trajectory.cell_data(i))
            write_vtp(file, polydata(trajectory.topology, *frame))
        else:
            options = {"data_format": "XML"} if suffix == "xdmf" else {}  # one file, not two
            _mesh(trajectory, i, suffix in _WITH_ARRAYS).write(file, **options)
        written.append((float(trajectory.times[i]), file))
    for file in destination.glob(f"{trajectory.path.stem}_*.{suffix}"):
        number = file.stem.removeprefix(f"{trajectory.path.stem}_")
        if len(number) >= 6 and number.isdecimal() and int(number) >= len(trajectory):
            file.unlink()
    return written


def _mesh(trajectory: Trajectory, i: int, arrays: bool) -> meshio.Mesh:
    """Return a frame of segments, or of vertices if there are no lines."""
    import meshio

    vertices, lines = trajectory.topology
    if lines:
        block = ("line", np.concatenate([np.stack([n[:-1], n[1:]], axis=1) for n in lines]))
        rows = np.repeat(len(vertices) + np.arange(len(lines)), [len(n) - 1 for n in lines])
    else:
        block, rows = ("vertex", vertices[:, None]), np.arange(len(vertices))
    data: dict[str, Any] = {}
    if arrays:
        data["point_data"] = trajectory.point_data(i)
        data["cell_data"] = {k: [a[rows]] for k, a in trajectory.cell_data(i).items()}
    return meshio.Mesh(trajectory.points(i), [block], **data)
