"""Trajectories: moving points with fixed lines in one VTKHDF file that ParaView opens.

The layout is that of VTK's specification for PolyData over time. Every array that varies is one
block with room for frames to come, so that a frame is bytes written into that room, and then the
number of frames. No structure of the file changes meanwhile: whoever opens the file, whenever the
writer was killed, finds all frames that were complete. A full file is copied to one with twice the
room, which then takes its place; `trim` returns what is left of the room.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
from numpy.typing import ArrayLike

from mrs.output.atomic import DamagedError, replacing, telling
from mrs.output.hdf5 import File

_CELLS = ("Vertices", "Lines", "Polygons", "Strips")
_DATA = ("PointData", "CellData", "FieldData")
_FIRST_ROOM = 16
_REMEDY = (
    "; put back a copy, or let `mrs resume DIRECTORY --renew-files` begin the file anew from the "
    "last checkpoint"
)

_Layout = dict[str, tuple[tuple[int, ...], np.dtype]]  # shape in one frame, and type, by name


class Topology(NamedTuple):
    """Which points are drawn as such, and which are joined by lines.

    Cells are numbered vertices first, then lines.

    Attributes
    ----------
    vertices : (V,) int ndarray
        Points that are a cell each.
    lines : list of int ndarray
        The points along each line. A closed line ends at its first point.
    """

    vertices: np.ndarray
    lines: list[np.ndarray]

    @property
    def cells(self) -> int:
        """Number of vertices and lines."""
        return len(self.vertices) + len(self.lines)


def same_topology(one: Topology, other: Topology) -> bool:
    """Return whether the same points are drawn, and joined, in both."""
    return (
        np.array_equal(one.vertices, other.vertices)
        and len(one.lines) == len(other.lines)
        and all(map(np.array_equal, one.lines, other.lines))
    )


def create(
    path: str | os.PathLike[str],
    topology: Topology,
    point_data: Mapping[str, ArrayLike] | None = None,
    cell_data: Mapping[str, ArrayLike] | None = None,
    meta: Mapping[str, Any] | None = None,
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
        **_named("PointData", point_data),
        **_named("CellData", cell_data, topology.cells),
    }
    with replacing(path) as temporary, File(temporary, "w") as file:
        root = file.create_group("VTKHDF")
        root.attrs["Version"] = np.array([2, 2])
        root.attrs["Type"] = np.bytes_("PolyData")  # the reader wants a fixed-length string
        for name in _DATA:
            root.create_group(name)
        for name in _CELLS:
            _write_cells(root.create_group(name), _cells_of(topology, name))
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
    field_data: Mapping[str, float] | None = None,
) -> None:
    """Add a frame; when this returns it is in the file, and before that nothing of it can be seen.

    Points, field data and the time are stored as float64, other arrays of floats as float32: what
    is small beside its distance from the origin would not be seen in single precision.

    Parameters
    ----------
    path : path
        A file from `create`.
    time : float
        Later than that of the last frame.
    points : (n, 3) array_like
        Positions.
    point_data : dict of (n,) or (n, k) array_like, optional
        Arrays that vary. The first frame settles names and shapes.
    cell_data : dict of (cells,) or (cells, k) array_like, optional
        Likewise.
    field_data : dict of float, optional
        Numbers that belong to the whole frame.

    Raises
    ------
    ValueError, TypeError
        If an array has a wrong name, shape or type, or is missing; if the time is not later. The
        file is unchanged.
    """
    path = Path(path)
    with telling(path), File(path, "r+") as file:
        root = _root(file, path)
        times, room = _times(root), _room(root)
        steps = len(times)
        frame = _frame(_cells(root), points, point_data, cell_data, field_data)
        layout = {name: (array.shape, array.dtype) for name, array in frame.items()}
        if room:
            _check_layout(_layout(root), layout)
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
        root = _root(file, path)
        times = _times(root)
        left = times[times <= time]
        if len(left) < len(times):
            for array in (root["Steps/Values"], *root["FieldData"].values()):
                array.resize(len(left), axis=0)
            file.flush()
        _set_steps(root, len(left))
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
        root = _root(file, path)
        steps, room, layout = len(_times(root)), _room(root), _layout(root)
    if 0 < steps < room:
        _rewrite(path, layout, steps)


class Trajectory:
    """Reader of the frames that a file had when it was opened.

    Parameters
    ----------
    path : path
        A file from `create`.

    Attributes
    ----------
    path : Path
    topology : Topology
    size : int
        Number of points; 0 before the first frame.
    times : (frames,) float64 ndarray
    meta : dict
        As given to `create`.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    DamagedError
        If it is cut short or no trajectory; the message says what to do.

    Examples
    --------
    >>> with Trajectory("rods.vtkhdf") as rods:  # doctest: +SKIP
    ...     tips = [rods.points(i)[-1] for i in range(len(rods))]
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        try:
            with ExitStack() as stack:
                self._file = stack.enter_context(File(self.path, "r"))
                self._root = _root(self._file, self.path)
                self.topology = _topology(self._root)
                self.times = _times(self._root)
                self.size = int(self._root["Points"].attrs["rows"]) if len(self.times) else 0
                self.meta = {key: _plain(value) for key, value in self._file["meta"].attrs.items()}
                stack.pop_all()  # it stays open
        except (KeyError, OSError, RuntimeError, ValueError) as error:
            if getattr(error, "errno", None) is not None:  # no such file, no permission
                raise
            reason = getattr(error, "reason", f"is damaged ({error})")
            raise DamagedError(self.path, reason, _REMEDY) from None

    def __enter__(self) -> Trajectory:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __len__(self) -> int:
        return len(self.times)

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def points(self, i: int) -> np.ndarray:
        """Return the (n, 3) positions of frame `i`; negative ones count from the end."""
        return self._read("Points", self._index(i))

    def point_data(self, i: int) -> dict[str, np.ndarray]:
        """Return the arrays at points of frame `i`, constant ones among them."""
        return self._read_group("PointData", i)

    def cell_data(self, i: int) -> dict[str, np.ndarray]:
        """Return the arrays at cells of frame `i`, constant ones among them."""
        return self._read_group("CellData", i)

    def field_data(self, i: int) -> dict[str, float]:
        """Return the numbers of frame `i`."""
        return {name: float(a[0]) for name, a in self._read_group("FieldData", i).items()}

    def _index(self, i: int) -> int:
        try:
            return range(len(self))[i]
        except IndexError:
            raise IndexError(f"{self.path} has {len(self)} frames, none number {i}") from None

    def _read(self, name: str, i: int) -> np.ndarray:
        array = self._root[name]
        rows = array.attrs.get("rows")
        return array[:] if rows is None else array[i * rows : (i + 1) * rows]

    def _read_group(self, group: str, i: int) -> dict[str, np.ndarray]:
        i = self._index(i)
        return {name: self._read(f"{group}/{name}", i) for name in self._root[group]}


def _root(file: h5py.File, path: Path) -> h5py.Group:
    if "VTKHDF/Steps" not in file or "meta" not in file:
        raise DamagedError(path, "is not a trajectory written by mrs")
    return file["VTKHDF"]


def _room(root: h5py.Group) -> int:
    """Return how many frames there is room for."""
    return root["Steps/Values"].chunks[0] if "Values" in root["Steps"] else 0


def _times(root: h5py.Group) -> np.ndarray:
    """Return the times of the complete frames."""
    return root["Steps/Values"][:] if _room(root) else np.empty(0)


def _set_steps(root: h5py.Group, steps: int) -> None:
    """Tell VTK how many frames there are: eight bytes written in place."""
    root["Steps"].attrs.modify("NSteps", np.int64(steps))


def _write(file: File, time: float, frame: Mapping[str, np.ndarray]) -> None:
    """Write a frame into the room after the others.

    `NSteps` is written before `Values` gets longer: VTK copies all of `Values` into an array of
    `NSteps` numbers. A run killed between the two leaves a whole frame without its time.
    """
    root = file["VTKHDF"]
    values = root["Steps/Values"]
    steps = len(values)
    for name, array in frame.items():
        if name.startswith("FieldData/"):
            root[name].resize(steps + 1, axis=0)
        root[name][steps * len(array) : (steps + 1) * len(array)] = array
    file.sync()  # else a power cut may keep the mark, not the frame
    _set_steps(root, steps + 1)
    file.flush()
    values.resize(steps + 1, axis=0)
    values[steps] = time
    file.flush()


def _topology(root: h5py.Group) -> Topology:
    lines = root["Lines"]
    ends = lines["Offsets"][1:-1]
    points = lines["Connectivity"][:]
    return Topology(
        root["Vertices/Connectivity"][:],
        np.split(points, ends) if lines["NumberOfCells"][0] else [],
    )


def _cells(root: h5py.Group) -> int:
    return int(sum(root[name]["NumberOfCells"][0] for name in _CELLS))


def _cells_of(topology: Topology, name: str) -> list[np.ndarray]:
    """Return the points of each cell in one of the four classes."""
    if name == "Lines":
        return topology.lines
    return [np.array([point]) for point in topology.vertices] if name == "Vertices" else []


def _write_cells(group: h5py.Group, cells: list[np.ndarray]) -> None:
    offsets = np.cumsum([0, *map(len, cells)], dtype=np.int64)
    group["NumberOfCells"] = np.array([len(cells)])
    group["NumberOfConnectivityIds"] = offsets[-1:]
    group["Offsets"] = offsets
    group["Connectivity"] = np.concatenate([np.empty(0, np.int64), *cells]).astype(np.int64)


def _named(
    group: str, arrays: Mapping[str, Any] | None, rows: int | None = None
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
        stored = np.float64 if group == "FieldData" else _stored_type(name, array)
        result[f"{group}/{name}"] = array.astype(stored)
    return result


def _stored_type(name: str, array: np.ndarray) -> type:
    types = {"f": np.float32, "i": np.int64, "u": np.int64, "b": np.uint8}
    if array.dtype.kind not in types:
        raise TypeError(f"{name!r} must hold real numbers, got dtype {array.dtype}")
    return types[array.dtype.kind]


def _frame(
    cells: int,
    points: ArrayLike,
    point_data: Mapping[str, ArrayLike] | None,
    cell_data: Mapping[str, ArrayLike] | None,
    field_data: Mapping[str, float] | None,
) -> dict[str, np.ndarray]:
    """Return all that a frame adds, under the names in the file."""
    points = np.asarray(points)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"points must have shape (n, 3), got {points.shape}")
    numbers = {name: [float(value)] for name, value in (field_data or {}).items()}
    return {
        "Points": points.astype(np.float64),
        **_named("PointData", point_data, len(points)),
        **_named("CellData", cell_data, cells),
        **_named("FieldData", numbers, 1),
    }


def _check_constant(root: h5py.Group, layout: _Layout, points: int) -> None:
    """Refuse a first frame that does not fit what `create` was given."""
    both = sorted(name for name in layout if name in root)
    if both:
        raise ValueError(f"constant since create, and cannot vary: {', '.join(both)}")
    for name, array in root["PointData"].items():
        if len(array) != points:
            raise ValueError(f"{points} points, but {name!r} was created with {len(array)}")
    largest = max(root[name]["Connectivity"][:].max(initial=-1) for name in _CELLS)
    if largest >= points:
        raise ValueError(f"{points} points, but the topology has a point {largest}")


def _check_layout(expected: _Layout, layout: _Layout) -> None:
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


def _layout(root: h5py.Group) -> _Layout:
    """Return the arrays that a frame adds to; empty before the first frame."""
    names = [f"{group}/{name}" for group in _DATA for name in root[group]]
    arrays = {name: root[name] for name in ("Points", *names) if name in root}
    return {
        name: ((int(array.attrs["rows"]), *array.shape[1:]), array.dtype)
        for name, array in arrays.items()
        if "rows" in array.attrs
    }


def _rewrite(
    path: Path,
    layout: _Layout,
    room: int,
    added: tuple[float, Mapping[str, np.ndarray]] | None = None,
) -> None:
    """Let a copy with room for `room` frames take the place of a file, with a frame added."""
    with replacing(path) as temporary, File(path, "r") as old, File(temporary, "w") as new:
        old.copy("meta", new)
        source, target = old["VTKHDF"], new.create_group("VTKHDF")
        target.attrs.update(source.attrs)
        target["NumberOfPoints"] = np.array([layout["Points"][0][0]])
        for name in _CELLS:
            source.copy(name, target)
        for group in _DATA:
            target.create_group(group)
            for name in source[group]:
                if f"{group}/{name}" not in layout:
                    source.copy(f"{group}/{name}", target[group])
        times = _times(source)
        _make_room(target, layout, room, times)
        for name, ((rows, *_), _) in layout.items():
            for i in range(len(times)):
                frame = slice(i * rows, (i + 1) * rows)
                target[name][frame] = source[name][frame]
        if added is not None:
            _write(new, *added)


def _make_room(root: h5py.Group, layout: _Layout, room: int, times: np.ndarray) -> None:
    """Settle the place of all arrays in the file, and say where the arrays of each frame start.

    Part offsets are zero: older VTK adds them to the offsets of the cells.
    """
    options = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    options.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
    options.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
    for name, ((rows, *columns), dtype) in layout.items():
        if name.startswith("FieldData/"):  # no longer than needed: with one frame VTK reads all
            array = root.create_dataset(name, times.shape, dtype, chunks=(room,), maxshape=(room,))
        else:
            array = root.create_dataset(name, (room * rows, *columns), dtype, dcpl=options)
        array.attrs["rows"] = rows
    steps = root.create_group("Steps")
    steps.attrs["NSteps"] = np.int64(len(times))
    steps.create_dataset("Values", data=times, chunks=(room,), maxshape=(room,))
    steps["NumberOfParts"] = np.ones(room, np.int64)
    steps["PartOffsets"] = np.zeros(room, np.int64)
    steps["CellOffsets"] = np.zeros((room, 4), np.int64)
    steps["ConnectivityIdOffsets"] = np.zeros((room, 4), np.int64)
    steps["PointOffsets"] = np.arange(room) * layout["Points"][0][0]
    for name in (f"{group}/{name}" for group in _DATA for name in root[group]):
        rows = layout[name][0][0] if name in layout else 0
        steps[name.replace("/", "Offsets/")] = np.arange(room) * rows


def _plain(value: Any) -> Any:
    """Return a number, string or list as Python has it."""
    return value.tolist() if isinstance(value, (np.ndarray, np.generic)) else value
