"""Trajectories as files of other programs, one a frame."""

from __future__ import annotations

import io
import os
import re
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree

import numpy as np

from mrs.output import run_directory
from mrs.output.atomic import replacing
from mrs.output.frames import Frames, trajectory_paths
from mrs.output.topology import Topology
from mrs.output.trajectory import Trajectory
from mrs.output.vtp import polydata, write_pvd, write_xml

if TYPE_CHECKING:
    import meshio

# Those that hold all arrays and that a program besides meshio opens: docs/decisions/0044.
FORMATS = ("vtp", "vtu", "xdmf", "vtk", "med")
_WITH_LIST = ("vtp", "vtu")


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
        with a .pvd, which lists the files and their times; "xdmf" has the time in each file.
    destination : path, optional
        Folder to write to, ``directory/format`` by default. Frames there of an earlier export, in
        the same format and of bodies of the same name, are deleted.
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
    files: list[Path] = []
    lists: list[Path] = []
    for path in paths:
        with Trajectory(path) as body:
            made, listed = _export_body(Path(directory), body, wanted, destination, suffix)
        files += made
        lists += listed
    return files + lists


def _export_body(
    directory: Path, body: Trajectory, wanted: list[int] | None, destination: Path, suffix: str
) -> tuple[list[Path], list[Path]]:
    """Write frames of one body; return their files, and the .pvd that lists them if it has one."""
    name, known = body.path.stem, Frames([body])
    numbers = known.numbers if wanted is None else [known.number(i) for i in wanted]
    files = {i: destination / f"{name}_{i:06d}.{suffix}" for i in numbers}
    lists = [destination / f"{name}.pvd"] if suffix in _WITH_LIST else []
    run_directory.note_made(directory, *files.values(), *lists)
    for i, file in files.items():
        _write(body, i, file)
    ours = re.compile(rf"{re.escape(name)}_\d{{6,}}\.{suffix}")
    for old in set(destination.iterdir()).difference(files.values()):
        if ours.fullmatch(old.name):
            old.unlink()
    for path in lists:
        write_pvd(path, [(known.times[i], file.name) for i, file in files.items()])
    return [*files.values()], lists


def _write(trajectory: Trajectory, i: int, file: Path) -> None:
    """Write a frame in the format of the suffix."""
    frame = trajectory.points(i), trajectory.point_data(i), trajectory.cell_data(i)
    if file.suffix == ".vtp":
        write_xml(file, polydata(trajectory.topology, *frame))
        return
    with replacing(file) as temporary:
        if file.suffix == ".xdmf":
            _write_xdmf(temporary, trajectory.topology, *frame, time=trajectory.times[i])
        elif file.suffix == ".med":  # by HDF5, which crashes on a full disk
            content = io.BytesIO()
            _mesh(trajectory.topology, *frame).write(content, "med")
            temporary.write_bytes(content.getvalue())
        else:
            _mesh(trajectory.topology, *frame).write(temporary)


def _write_xdmf(
    path: Path,
    topology: Topology,
    points: np.ndarray,
    *data: dict[str, np.ndarray],
    time: float,
) -> None:
    """Write one file, not two; with all digits; and with the time, without which VTK refuses it."""
    exact = [{name: _widest(array) for name, array in arrays.items()} for arrays in data]
    _mesh(topology, _widest(points), *exact).write(path, data_format="XML")
    tree = ElementTree.parse(path)
    grid = tree.find("Domain/Grid")
    assert grid is not None
    ElementTree.SubElement(grid, "Time", Value=repr(float(time)))
    tree.write(path)


def _widest(array: np.ndarray) -> np.ndarray:
    return array.astype(np.float64 if array.dtype.kind == "f" else np.int64)


def _mesh(
    topology: Topology,
    points: np.ndarray,
    point_data: dict[str, np.ndarray],
    cell_data: dict[str, np.ndarray],
) -> meshio.Mesh:
    """Return a frame of segments, or of vertices if there are no lines."""
    import meshio

    vertices, lines = topology
    if lines:
        block = ("line", np.concatenate([np.stack([n[:-1], n[1:]], axis=1) for n in lines]))
        rows = np.repeat(len(vertices) + np.arange(len(lines)), [len(n) - 1 for n in lines])
    else:
        block, rows = ("vertex", vertices[:, None]), np.arange(len(vertices))
    cells = {name: [array[rows]] for name, array in cell_data.items()}
    return meshio.Mesh(points, [block], point_data, cells)
