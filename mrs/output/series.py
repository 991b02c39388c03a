"""Arrays of a body in the frames of a run, read from its file as far as they are asked for."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
from numpy.typing import DTypeLike

from mrs.output.hdf5 import File
from mrs.output.vtkhdf_layout import ROWS, root_of, times_of
from treecode.shown import Shown


class ChangedError(RuntimeError):
    """A file no longer has the frames that it had when a run was opened."""


class Source(NamedTuple):
    """Frames of a file. It is opened for each reading, so that it may grow and be replaced."""

    path: Path
    times: np.ndarray
    """(T,), of the first frames of the file, which must be there at each reading."""
    size: int
    """Points in a frame."""

    @contextmanager
    def opened(self) -> Iterator[h5py.Group]:
        """Open the file; give the group that VTK reads.

        Raises
        ------
        ChangedError
            If the file has other frames now.
        """
        with File(self.path, "r") as file:
            root = root_of(file, self.path)
            times = times_of(root)[: len(self.times)]
            size = root["Points"].attrs[ROWS] if len(times) else 0
            if not np.array_equal(times, self.times) or size != self.size:
                raise ChangedError(
                    f"{self.path} has other frames than when it was opened: the run was begun "
                    "anew, or goes on from an earlier time; call refresh() of the run"
                )
            yield root


class Part(NamedTuple):
    """Which numbers of a frame an array consists of."""

    name: str
    """Of the array in the file, such as "PointData/force"."""
    rows: np.ndarray
    """Of the array in one frame, in the shape in which they are wanted."""
    columns: tuple[int, ...]
    """Shape of a row: (), or (k,)."""
    lattices: np.ndarray | None = None
    """(T, 3, 3), of each frame of the file: multiples of these vectors, in the array "image", are
    added."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape in one frame."""
        return self.rows.shape + self.columns

    def elements(self) -> np.ndarray:
        """Return the place of each number among all those of a frame."""
        width = int(np.prod(self.columns))
        return (self.rows[..., None] * width + np.arange(width)).reshape(self.shape)

    def block(self, root: h5py.Group, place: int, rows: slice) -> np.ndarray:
        """Return rows of the frame at a place of the file."""
        values = _rows(root[self.name], place, rows)
        if self.lattices is None:
            return values
        return values + _rows(root["PointData/image"], place, rows) @ self.lattices[place]


def _rows(array: h5py.Dataset, place: int, rows: slice) -> np.ndarray:
    start = place * int(array.attrs[ROWS])
    return array[start + rows.start : start + rows.stop]


class Series(Shown):
    """An array over all frames that stays in its file: what an index asks for is read.

    Indices are those of numpy, the first one that of the frame; a list of frames selects frames by
    itself, and is not matched with lists for other axes. ``np.asarray(series)`` reads all, an
    iteration one frame after the other. Of each frame the rows from the first to the last wanted
    are read.

    Parameters
    ----------
    source : Source
    places : (frames,) int ndarray
        Of the frames in the file.
    part : Part
    dtype : dtype
    dims : tuple of str
        Names of the axes.

    Attributes
    ----------
    shape : tuple of int
        (frames, ...).
    """

    def __init__(
        self,
        source: Source,
        places: np.ndarray,
        part: Part,
        dtype: DTypeLike,
        dims: tuple[str, ...],
    ) -> None:
        self._source, self._places, self._part = source, places, part
        self.dtype = np.dtype(dtype)
        self.dims = dims
        self.shape = (len(places), *part.shape)

    @property
    def ndim(self) -> int:
        """Number of axes."""
        return len(self.shape)

    @property
    def size(self) -> int:
        """Number of all numbers."""
        return int(np.prod(self.shape))

    @property
    def nbytes(self) -> int:
        """Bytes that all numbers would take in memory."""
        return self.size * self.dtype.itemsize

    def __len__(self) -> int:
        return self.shape[0]

    def __iter__(self) -> Iterator[np.ndarray]:
        return (self[i] for i in range(len(self)))

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> np.ndarray:
        if copy is False:
            raise ValueError("copy must not be False: the numbers are read from a file")
        return self[...].astype(dtype or self.dtype, copy=False)

    def __getitem__(self, index: Any) -> Any:
        frame, *rest = _split(index, self.ndim)
        places, wanted = self._places[frame], np.asarray(self._elements[tuple(rest)])
        result = np.empty((np.size(places), *wanted.shape), self.dtype)
        if result.size:
            width = int(np.prod(self._part.columns))
            rows = slice(int(wanted.min()) // width, int(wanted.max()) // width + 1)
            taken = wanted - rows.start * width
            with self._source.opened() as root:
                for i, place in enumerate(np.ravel(places)):
                    result[i] = self._part.block(root, int(place), rows).reshape(-1)[taken]
        return result.reshape(np.shape(places) + wanted.shape)[()]  # a number, not an array of one

    @cached_property
    def _elements(self) -> np.ndarray:
        return self._part.elements()

    def shown(self) -> dict[str, Any]:
        axes = zip(self.dims, self.shape, strict=True)
        return {
            "file": self._source.path,
            "array": self._part.name.rpartition("/")[2],
            "shape": " ".join(f"{name}:{size}" for name, size in axes),
            "dtype": self.dtype,
        }


def _split(index: Any, ndim: int) -> tuple[Any, ...]:
    """Return an index as one for the frame, and those for the other axes."""
    indices = index if isinstance(index, tuple) else (index,)
    if not indices:
        return (slice(None),)
    if indices[0] is Ellipsis:
        others = sum(one is not None for one in indices[1:])
        return indices[1:] if others == ndim else (slice(None), *indices)
    return indices
