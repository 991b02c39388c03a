"""Writing trajectories: moving points with fixed lines in one VTKHDF file that ParaView opens.

A frame is written as bytes into free room of the file; then the number of frames is raised. No
structure of the file changes meanwhile. A reader therefore finds all complete frames, whenever it
opens the file and whenever the writer was killed. A full file is copied to one with twice the room,
which then takes its place; `trim` gives back the room that is left.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import ArrayLike

from mrs.output.atomic import replacing, telling
from mrs.output.hdf5 import File
from mrs.output.topology import Topology
from mrs.output.vtkhdf_layout import (
    CELLS,
    DATA,
    Layout,
    cells_of,
    layout_of,
    make_room,
    room_of,
    root_of,
    set_steps,
    times_of,
    write_topology,
)

_FIRST_ROOM = 16
_PRECISION = "precision"  # an attribute, of which VTK does not know


def create(
    path: str | os.PathLike[str],
    topology: Topology,
    point_data: Mapping[str, ArrayLike] | None = None,
    cell_data: Mapping[str, ArrayLike] | None = None,
    meta: Mapping[str, Any] | None = None,
    precision: str = "float32",
) -> None:
    """Write a new file without frames.

    Parameters
    ----------
    path : path
        Must not exist.
    topology : Topology
        The same for all frames.
    point_data : dict of (n,) or (n, k) array_like, optional
        Arrays that do not change, stored once.
    cell_data : dict of (cells,) or (cells, k) array_like, optional
        Likewise, a row for each vertex, then for each line.
    meta : dict of str, numbers or lists of them, optional
        For example ``{"kind": "rods", "force": "per length", "length unit": "m"}``.
    precision : {"float32", "float64"}, optional
        Of all arrays of floats but the points.

    Raises
    ------
    FileExistsError
        If there is such a file.
    ValueError, TypeError
        If an array has a wrong name, shape or type; the message names it.
    """
    path = Path(path)
    if path.exists():
        raise FileExistsError(f"{path} exists already")
    constant = {
        **_named("PointData", point_data, precision),
        **_named("CellData", cell_data, precision, topology.cells),
    }
    with replacing(path) as temporary, File(temporary, "w") as file:
        root = file.create_group("VTKHDF")
        root.attrs["Version"] = np.array([2, 2])
        root.attrs[_PRECISION] = precision
        root.attrs["Type"] = np.bytes_("PolyData")  # the reader wants a fixed-length string
        for name in DATA:
            root.create_group(name)
        write_topology(root, topology)
        for name, array in constant.items():
            root[name] = array
        root.create_group("Steps").attrs["NSteps"] = np.int64(0)
        file.create_group("meta").attrs.update(meta or {})


def append(
    path: str | os.PathLike[str],
    time: float,
    points: ArrayLike,
    point_data: Mapping[str, ArrayLike] | None = None,
    cell_data: Mapping[str, ArrayLike] | None = None,
) -> None:
    """Add a frame; when this returns it is in the file, and before that nothing of it can be seen.

    Points and the time are stored as float64, other arrays of floats as `create` was told. In
    single precision a body that is small beside its distance from the origin could not be seen.

    Parameters
    ----------
    path : path
        A file from `create`.
    time : float
        Later than the time of the last frame.
    points : (n, 3) array_like
        Positions.
    point_data : dict of (n,) or (n, k) array_like, optional
        Arrays that vary. The first frame settles names and shapes.
    cell_data : dict of (cells,) or (cells, k) array_like, optional
        Likewise.

    Raises
    ------
    ValueError, TypeError
        If an array has a wrong name, shape or type, or is missing; if the time is not later. The
        file is unchanged.
    """
    path = Path(path)
    with telling(path), File(path, "r+") as file:
        root = root_of(file, path)
        times, room = times_of(root), room_of(root)
        steps = len(times)
        precision = str(root.attrs.get(_PRECISION, "float32"))
        frame = _frame(cells_of(root), precision, points, point_data, cell_data)
        layout = {name: (array.shape, array.dtype) for name, array in frame.items()}
        if room:
            _check_layout(layout_of(root), layout)
        else:
            _check_constant(root, layout, len(frame["Points"]))
        if not time > max(times, default=-np.inf):
            raise ValueError(f"time must be later than that of the last frame, got {time!r}")
        if 0 < steps < room:
            _write(file, time, frame)
            return
    _rewrite(path, layout, max(_FIRST_ROOM, 2 * steps), (time, frame))


def cut(path: str | os.PathLike[str], time: float) -> float | None:
    """Drop the frames later than `time`; the next frames are written over them.

    Parameters
    ----------
    path : path
        A file from `create`.
    time : float
        Of the state that the run goes on from.

    Returns
    -------
    float or None
        Time of the last frame left.
    """
    path = Path(path)
    with telling(path), File(path, "r+") as file:
        root = root_of(file, path)
        times = times_of(root)
        left = times[times <= time]
        if len(left) < len(times):
            root["Steps/Values"].resize(len(left), axis=0)
            file.flush()
        set_steps(root, len(left))
    return float(left[-1]) if len(left) else None


def trim(path: str | os.PathLike[str]) -> None:
    """Return the room kept for frames to come to the disk: for the end of a run.

    Parameters
    ----------
    path : path
        A file from `create`.
    """
    path = Path(path)
    with File(path, "r") as file:
        root = root_of(file, path)
        steps, room, layout = len(times_of(root)), room_of(root), layout_of(root)
    if 0 < steps < room:
        _rewrite(path, layout, steps)


def _write(file: File, time: float, frame: Mapping[str, np.ndarray]) -> None:
    """Write a frame into the room after the others.

    `NSteps` is written before `Values` gets longer: VTK copies all of `Values` into an array of
    `NSteps` numbers. A run killed between the two leaves a whole frame without its time.
    """
    root = file["VTKHDF"]
    values = root["Steps/Values"]
    steps = len(values)
    for name, array in frame.items():
        root[name][steps * len(array) : (steps + 1) * len(array)] = array
    file.sync()  # else a power cut may keep the mark, not the frame
    set_steps(root, steps + 1)
    file.flush()
    values.resize(steps + 1, axis=0)
    values[steps] = time
    file.flush()


def _named(
    group: str, arrays: Mapping[str, Any] | None, precision: str, rows: int | None = None
) -> dict[str, np.ndarray]:
    """Return the arrays as they are stored, under their names in the file."""
    result: dict[str, np.ndarray] = {}
    for name, values in (arrays or {}).items():
        if not name or "/" in name or "." in name:
            raise ValueError(f"array names must be without '/' and '.', got {name!r}")
        array = np.asarray(values)
        if array.ndim not in (1, 2) or rows not in (None, len(array)):
            raise ValueError(
                f"{group} {name!r} must have shape (n,) or (n, k) with n = {rows}, "
                f"got {array.shape}"
            )
        result[f"{group}/{name}"] = array.astype(_stored_type(name, array, precision))
    return result


def _stored_type(name: str, array: np.ndarray, precision: str) -> np.dtype:
    types = {"f": precision, "i": "int64", "u": "int64", "b": "uint8"}
    if array.dtype.kind not in types:
        raise TypeError(f"{name!r} must hold real numbers, got dtype {array.dtype}")
    return np.dtype(types[array.dtype.kind])


def _frame(
    cells: int,
    precision: str,
    points: ArrayLike,
    point_data: Mapping[str, ArrayLike] | None,
    cell_data: Mapping[str, ArrayLike] | None,
) -> dict[str, np.ndarray]:
    """Return all that a frame adds, under the names in the file."""
    points = np.asarray(points)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"points must have shape (n, 3), got {points.shape}")
    return {
        "Points": points.astype(np.float64),
        **_named("PointData", point_data, precision, len(points)),
        **_named("CellData", cell_data, precision, cells),
    }


def _check_constant(root: h5py.Group, layout: Layout, points: int) -> None:
    """Refuse a first frame that does not fit the topology and the arrays given to `create`."""
    both = sorted(name for name in layout if name in root)
    if both:
        raise ValueError(f"constant since create, and cannot vary: {', '.join(both)}")
    for name, array in root["PointData"].items():
        if len(array) != points:
            raise ValueError(f"{points} points, but {name!r} was created with {len(array)}")
    largest = max(root[name]["Connectivity"][:].max(initial=-1) for name in CELLS)
    if largest >= points:
        raise ValueError(f"{points} points, but the topology has a point {largest}")


def _check_layout(expected: Layout, layout: Layout) -> None:
    """Refuse a frame that is not like the first."""
    missing, unknown = set(expected) - set(layout), set(layout) - set(expected)
    if missing or unknown:
        raise ValueError(
            "a frame must have the arrays of the first; "
            f"missing: {sorted(missing) or 'none'}, unknown: {sorted(unknown) or 'none'}"
        )
    for name, (shape, dtype) in layout.items():
        if (shape, dtype) != expected[name]:
            first = " of ".join(map(str, expected[name]))
            raise ValueError(
                f"{name} must be as in the first frame, {first}, got {shape} of {dtype}"
            )


def _rewrite(
    path: Path,
    layout: Layout,
    room: int,
    added: tuple[float, Mapping[str, np.ndarray]] | None = None,
) -> None:
    """Let a copy with room for `room` frames take the place of a file, with a frame added."""
    with replacing(path) as temporary, File(path, "r") as old, File(temporary, "w") as new:
        old.copy("meta", new)
        source, target = old["VTKHDF"], new.create_group("VTKHDF")
        target.attrs.update(source.attrs)
        target["NumberOfPoints"] = np.array([layout["Points"][0][0]])
        for name in CELLS:
            source.copy(name, target)
        for group in DATA:
            target.create_group(group)
            for name in source[group]:
                if f"{group}/{name}" not in layout:
                    source.copy(f"{group}/{name}", target[group])
        times = times_of(source)
        make_room(target, layout, room, times)
        for name, ((rows, *_), _) in layout.items():
            for i in range(len(times)):
                frame = slice(i * rows, (i + 1) * rows)
                target[name][frame] = source[name][frame]
        if added is not None:
            _write(new, *added)
