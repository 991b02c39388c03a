"""A body in the frames of a run, from its file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from mrs import check
from mrs.output.series import Part, Series, Source
from mrs.output.stored import stored_lattices
from mrs.output.trajectory import Trajectory
from mrs.output.vtkhdf_layout import DATA
from mrs.output.vtp import polydata
from treecode.shown import Shown

if TYPE_CHECKING:
    import pyvista as pv

_XYZ = "xyz"


class StoredBody(Shown):
    """A body in some frames of its file.

    Arrays at points have the axes "line" and "node" if all points are on lines of equal lengths:
    nodes of rods, body and flagellum of swimmers. Else they have the axis "point". Arrays at cells
    have the axis "line" or "cell": lines, or vertices and then lines.

    Parameters
    ----------
    file : Trajectory
    places : (frames,) array_like of int
        Of the frames in the file.

    Attributes
    ----------
    name, kind : str
    topology : Topology
        Vertices and lines, for example of rods of different lengths.
    fields : tuple of str
        Names of the arrays.
    """

    def __init__(self, file: Trajectory, places: ArrayLike) -> None:
        self.path: Path = file.path
        self.name: str = file.path.stem
        self.kind: str = str(file.meta.get("kind"))
        self.topology = file.topology
        self._source = Source(file.path, file.times, file.size)
        self._places = np.array(places, int)
        self._lattices = stored_lattices(file.meta, file.times)
        self._varying, self._constant = file.varying, file.constant
        names = [name.partition("/")[2] for name in (*self._varying, *self._constant)]
        self.fields = tuple(sorted(set(names) - {""}))  # "Points" is no field
        self._lines = _equal_lines(file.topology.lines, file.size)

    @property
    def positions(self) -> Series:
        """Positions, (frames, lines, nodes, 3) or (frames, points, 3), not wrapped into a cell."""
        moved = self._lattices if "PointData/image" in self._varying else None
        return self._series("Points", moved)

    @property
    def wrapped_positions(self) -> Series:
        """Likewise, as they are in the file: of a periodic run within the cell."""
        return self._series("Points")

    def __getitem__(self, name: str) -> Series | np.ndarray:
        """Return an array by its name; one at points, if there is one at cells as well.

        Those that do not change have no axis of frames, and are numpy's.
        """
        full = self._full(name)
        if full in self._varying:
            return self._series(full)
        values = self._constant[full]
        return values[self._rows(full, len(values))]

    def dims(self, name: str) -> tuple[str, ...]:
        """Return the names of the axes of an array."""
        full = self._full(name)
        if full in self._varying:
            return self._series(full).dims
        values = self._constant[full]
        return self._dims(full, values.shape[1:])

    def mesh(self, frame: int = -1) -> pv.PolyData:
        """Return a frame with all its arrays, as pyvista has it; positions as in the file."""
        place = int(self._places[frame])
        with self._source.opened(), Trajectory(self.path) as file:
            data = file.point_data(place), file.cell_data(place)
            return polydata(file.topology, file.points(place), *data)

    def _full(self, name: str) -> str:
        check.key("field", name, self.fields)
        full = (f"{group}/{name}" for group in DATA)
        return next(one for one in full if one in self._varying or one in self._constant)

    def _series(self, full: str, lattices: np.ndarray | None = None) -> Series:
        if not self._source.size:
            raise ValueError(f"{self.path} has no frame yet")
        (size, *columns), dtype = self._varying[full]
        part = Part(full, self._rows(full, size), tuple(columns), lattices)
        dims = ("time", *self._dims(full, part.columns))
        return Series(self._source, self._places, part, dtype, dims)

    def _rows(self, full: str, size: int) -> np.ndarray:
        """Return the rows of an array in the shape of lines, if it has that."""
        if self._lines is None or full.startswith("CellData"):
            return np.arange(size)
        return self._lines

    def _dims(self, full: str, columns: tuple[int, ...]) -> tuple[str, ...]:
        if not full.startswith("CellData"):
            rows = ("point",) if self._lines is None else ("line", "node")
        else:
            rows = ("cell",) if len(self.topology.vertices) else ("line",)
        own = (_XYZ,) if columns == (3,) else (f"{full.partition('/')[2]}_column",)
        return (*rows, *(own if columns else ()))

    def shown(self) -> dict[str, Any]:
        kinds = {"name": self.name, "kind": self.kind, "frames": len(self._places)}
        shape = () if self._lines is None else self._lines.shape
        size = {"lines": shape[0], "nodes": shape[1]} if shape else {"points": self._source.size}
        return kinds | size | {"fields": " ".join(self.fields)}


def _equal_lines(lines: Sequence[np.ndarray], points: int) -> np.ndarray | None:
    """Return lines as an array, (lines, nodes), if they are equally long and have all points."""
    open_lines = [line[:-1] if line[0] == line[-1] else line for line in lines]
    if not open_lines or len({len(line) for line in open_lines}) > 1:
        return None
    array = np.array(open_lines)
    return array if np.array_equal(np.sort(array, axis=None), np.arange(points)) else None
