"""Trajectories read back: the frames of one body."""

from __future__ import annotations

import os
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from mrs.output.atomic import DamagedError
from mrs.output.hdf5 import File
from mrs.output.vtkhdf_layout import (
    ROWS,
    Layout,
    constant_of,
    layout_of,
    root_of,
    times_of,
    topology_of,
)

_REMEDY = (
    "; put back a copy, or let `mrs resume DIRECTORY --renew-files` begin the file anew from the "
    "last checkpoint"
)


class Trajectory:
    """Reader of the frames that a file had when it was opened.

    Parameters
    ----------
    path : path
        A file from `mrs.output.vtkhdf.create`.

    Attributes
    ----------
    path : Path
    topology : Topology
    size : int
        Number of points; 0 before the first frame.
    times : (frames,) float64 ndarray
    meta : dict
        As given to `create`.
    varying : dict
        Shape in one frame, and type, of the arrays that vary, by name in the file, such as
        "PointData/force".

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    DamagedError
        If it is cut short or no trajectory; the message names a remedy.

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
                self._root = root_of(self._file, self.path)
                self.topology = topology_of(self._root)
                self.times = times_of(self._root)
                self.size = int(self._root["Points"].attrs[ROWS]) if len(self.times) else 0
                self.varying: Layout = layout_of(self._root)
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

    @property
    def constant(self) -> dict[str, np.ndarray]:
        """The arrays that do not vary, by name in the file."""
        return constant_of(self._root)

    def points(self, i: int) -> np.ndarray:
        """Return the positions in a frame, (n, 3).

        Parameters
        ----------
        i : int
            Number of the frame; negative ones count from the end.

        Raises
        ------
        IndexError
            If there is no such frame.
        """
        return self._read("Points", self._index(i))

    def point_data(self, i: int) -> dict[str, np.ndarray]:
        """Return the arrays at points in a frame, constant ones among them, by name.

        Parameters
        ----------
        i : int
            As for `points`.
        """
        return self._read_group("PointData", i)

    def cell_data(self, i: int) -> dict[str, np.ndarray]:
        """Return the arrays at cells in a frame, constant ones among them, by name.

        Parameters
        ----------
        i : int
            As for `points`.
        """
        return self._read_group("CellData", i)

    def _index(self, i: int) -> int:
        try:
            return range(len(self))[i]
        except IndexError:
            raise IndexError(f"{self.path} has {len(self)} frames, none number {i}") from None

    def _read(self, name: str, i: int) -> np.ndarray:
        array = self._root[name]
        rows = array.attrs.get(ROWS)
        return array[:] if rows is None else array[i * rows : (i + 1) * rows]

    def _read_group(self, group: str, i: int) -> dict[str, np.ndarray]:
        i = self._index(i)
        return {name: self._read(f"{group}/{name}", i) for name in self._root[group]}


def _plain(value: Any) -> Any:
    """Return a number, string or list as Python has it."""
    return value.tolist() if isinstance(value, (np.ndarray, np.generic)) else value
