"""One .vtp file a frame and a list of them: for ParaView before 5.12, and for looking on."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

from numpy.typing import ArrayLike

from mrs.output.atomic import replacing
from mrs.output.vtkhdf import Topology
from mrs.output.vtp import polydata, read_pvd, write_pvd


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
    name = f"{path.stem}/{len(files):06d}.vtp"
    folder = path.parent / path.stem
    folder.mkdir(parents=True, exist_ok=True)
    with replacing(path.parent / name) as temporary:
        polydata(topology, points, point_data, cell_data).save(temporary)
    write_pvd(path, [*files, (time, name)])


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
