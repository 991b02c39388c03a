"""One .vtp file a frame and a list of them: for ParaView before 5.12, and for looking on."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from numpy.typing import ArrayLike

from mrs.output.atomic import DamagedError, telling
from mrs.output.topology import Topology
from mrs.output.vtp import polydata, read_pvd, write_pvd, write_xml


def append(
    path: str | os.PathLike[str],
    time: float,
    topology: Topology,
    points: ArrayLike,
    point_data: Mapping[str, ArrayLike] | None = None,
    cell_data: Mapping[str, ArrayLike] | None = None,
) -> None:
    """Write a frame, and then the list with its name.

    Parameters
    ----------
    path : path
        Of the list, for example ``rods.pvd``. Frames are ``rods/000000.vtp`` and so on beside it.
    time : float
    topology : Topology
    points : (n, 3) array_like
    point_data : dict of (n,) or (n, k) array_like, optional
    cell_data : dict of (cells,) or (cells, k) array_like, optional
        A row for each vertex, then for each line.
    """
    path = Path(path)
    files = read_pvd(path)
    frame = _frame_after(path, files)
    with telling(frame):
        frame.parent.mkdir(parents=True, exist_ok=True)
    write_xml(frame, polydata(topology, points, point_data, cell_data))
    write_pvd(path, [*files, (time, frame.relative_to(path.parent).as_posix())])


def next_frame(path: Path) -> Path:
    """Return the place of the next frame: after all frames that are listed, or were in a lost list.

    Parameters
    ----------
    path : Path
        Of the list, or the place where one will be.
    """
    return _frame_after(path, read_pvd(path))


def _frame_after(path: Path, files: list[tuple[float, str]]) -> Path:
    listed = [name for _, name in files[-1:]]
    frames = listed or (path.parent / path.stem).glob("[0-9]*.vtp")
    number = max((int(Path(frame).stem) + 1 for frame in frames), default=0)
    return path.parent / path.stem / f"{number:06d}.vtp"


def times(path: Path, points: int) -> list[float]:
    """Return the times of the frames.

    Parameters
    ----------
    path : Path
        Of the list.
    points : int
        How many a frame must have.

    Raises
    ------
    DamagedError
        If the list is damaged, or if a frame in it is missing, cut short or of another body.
    """
    files = read_pvd(path)
    for _, name in files:
        frame = path.parent / name
        if not frame.is_file():
            raise DamagedError(path, f"lists {name}, which is missing")
        found = _points(frame)
        if found is None:
            raise DamagedError(path, f"lists {name}, which is cut short or damaged")
        if found != points:
            raise DamagedError(
                path, f"is of another scene: {name} has {found} points, not {points}"
            )
    return [time for time, _ in files]


def _points(frame: Path) -> int | None:
    """Return how many points a frame has; None if it does not end as it should."""
    with frame.open("rb") as file:
        number = re.search(rb'NumberOfPoints="(\d+)"', file.read(4096))
        file.seek(-min(frame.stat().st_size, 64), os.SEEK_END)
        whole = file.read().rstrip().endswith(b"</VTKFile>")
    return int(number[1]) if number and whole else None


def cut(path: str | os.PathLike[str], time: float) -> float | None:
    """Drop the frames later than `time`.

    Parameters
    ----------
    path : path
        Of the list, or the place where one will be.
    time : float
        Of the state that the run goes on from.

    Returns
    -------
    float or None
        Time of the last frame left.
    """
    path = Path(path)
    files = read_pvd(path)
    left = [(t, name) for t, name in files if t <= time]
    if len(left) < len(files):
        write_pvd(path, left)
        for t, name in files:
            if t > time:
                (path.parent / name).unlink(missing_ok=True)
    return left[-1][0] if left else None


def summary(path: Path) -> dict[str, Any]:
    """Return how many "frames" a list has, their "points", and the "time" of the last one.

    Parameters
    ----------
    path : Path
        Of the list.

    Raises
    ------
    DamagedError
        If the list is damaged.
    """
    files = read_pvd(path)
    if not files:
        return {"frames": 0, "points": 0, "time": None}
    time, name = files[-1]
    return {"frames": len(files), "points": _points(path.parent / name), "time": time}
