"""Where a trajectory has its arrays: VTK's specification of PolyData over time, with room to grow.

Every array that varies is one block with room for frames to come. How many frames are complete is
said by `Steps/Values`, which has their times.
"""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np

from mrs.output.atomic import DamagedError
from mrs.output.topology import Topology

CELLS = ("Vertices", "Lines", "Polygons", "Strips")
DATA = ("PointData", "CellData")
ROWS = "rows"  # the attribute of an array that varies: its length in one frame

Layout = dict[str, tuple[tuple[int, ...], np.dtype]]
"""Shape in one frame, and type, of the arrays that vary, by name."""


def root_of(file: h5py.File, path: Path) -> h5py.Group:
    """Return the group that VTK reads.

    Parameters
    ----------
    file : h5py.File
    path : Path
        Of the file.

    Raises
    ------
    DamagedError
        If the file is no trajectory.
    """
    if "VTKHDF/Steps" not in file or "meta" not in file:
        raise DamagedError(path, "is not a trajectory written by mrs")
    return file["VTKHDF"]


def room_of(root: h5py.Group) -> int:
    """Return how many frames there is room for.

    Parameters
    ----------
    root : h5py.Group
    """
    return root["Steps/Values"].chunks[0] if "Values" in root["Steps"] else 0


def times_of(root: h5py.Group) -> np.ndarray:
    """Return the times of the complete frames, (frames,).

    Parameters
    ----------
    root : h5py.Group
    """
    return root["Steps/Values"][:] if room_of(root) else np.empty(0)


def layout_of(root: h5py.Group) -> Layout:
    """Return the arrays that a frame adds to; empty before the first frame.

    Parameters
    ----------
    root : h5py.Group
    """
    names = [f"{group}/{name}" for group in DATA for name in root[group]]
    arrays = {name: root[name] for name in ("Points", *names) if name in root}
    return {
        name: ((int(array.attrs[ROWS]), *array.shape[1:]), array.dtype)
        for name, array in arrays.items()
        if ROWS in array.attrs
    }


def constant_of(root: h5py.Group) -> dict[str, np.ndarray]:
    """Return the arrays that are the same in all frames, by name.

    Parameters
    ----------
    root : h5py.Group
    """
    arrays = {f"{group}/{name}": array for group in DATA for name, array in root[group].items()}
    return {name: array[:] for name, array in arrays.items() if ROWS not in array.attrs}


def topology_of(root: h5py.Group) -> Topology:
    """Return the vertices and lines of all frames.

    Parameters
    ----------
    root : h5py.Group
    """
    lines = root["Lines"]
    ends = lines["Offsets"][1:-1]
    points = lines["Connectivity"][:]
    return Topology(
        root["Vertices/Connectivity"][:],
        np.split(points, ends) if lines["NumberOfCells"][0] else [],
    )


def cells_of(root: h5py.Group) -> int:
    """Return the number of cells of a frame.

    Parameters
    ----------
    root : h5py.Group
    """
    return int(sum(root[name]["NumberOfCells"][0] for name in CELLS))


def write_topology(root: h5py.Group, topology: Topology) -> None:
    """Write the cells of all frames.

    Parameters
    ----------
    root : h5py.Group
        Without cells.
    topology : Topology
    """
    cells = {"Vertices": [np.array([i]) for i in topology.vertices], "Lines": topology.lines}
    for name in CELLS:
        own, group = cells.get(name, []), root.create_group(name)
        offsets = np.cumsum([0, *map(len, own)], dtype=np.int64)
        group["NumberOfCells"] = np.array([len(own)])
        group["NumberOfConnectivityIds"] = offsets[-1:]
        group["Offsets"] = offsets
        group["Connectivity"] = np.concatenate([np.empty(0, np.int64), *own]).astype(np.int64)


def make_room(root: h5py.Group, layout: Layout, room: int, times: np.ndarray) -> None:
    """Settle the place of all arrays in the file, and say where the arrays of each frame start.

    Part offsets are zero: older VTK adds them to the offsets of the cells.

    Parameters
    ----------
    root : h5py.Group
        Without arrays that vary.
    layout : Layout
    room : int
        Frames that it is to have room for.
    times : (frames,) float ndarray
        Of the frames that are written next.
    """
    options = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    options.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
    options.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
    for name, ((rows, *columns), dtype) in layout.items():
        array = root.create_dataset(name, (room * rows, *columns), dtype, dcpl=options)
        array.attrs[ROWS] = rows
    steps = root.create_group("Steps")
    steps.attrs["NSteps"] = np.int64(len(times))
    steps.create_dataset("Values", data=times, chunks=(room,), maxshape=(room,))
    steps["NumberOfParts"] = np.ones(room, np.int64)
    steps["PartOffsets"] = np.zeros(room, np.int64)
    steps["CellOffsets"] = np.zeros((room, 4), np.int64)
    steps["ConnectivityIdOffsets"] = np.zeros((room, 4), np.int64)
    steps["PointOffsets"] = np.arange(room) * layout["Points"][0][0]
    for name in (f"{group}/{name}" for group in DATA for name in root[group]):
        rows = layout[name][0][0] if name in layout else 0
        steps[name.replace("/", "Offsets/")] = np.arange(room) * rows


def set_steps(root: h5py.Group, steps: int) -> None:
    """Tell VTK how many frames there are: eight bytes written in place.

    Parameters
    ----------
    root : h5py.Group
    steps : int
    """
    root["Steps"].attrs.modify("NSteps", np.int64(steps))
