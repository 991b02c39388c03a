"""HDF5 files by reads and writes of our own.

HDF5 itself locks a file, refuses a file that the same process has open for reading, and crashes if
a write fails. Here a file is plain bytes: no reader stops a writer. After the first write that
fails, or that ctrl-C interrupts, nothing more is written, as if the process had been killed there.
"""

from __future__ import annotations

import io
import os
from pathlib import Path

import h5py

from mrs.output.atomic import DamagedError

_MODES = {"r": "rb", "r+": "rb+", "w": "wb+"}


class File(h5py.File):
    """An open file, in the oldest format of HDF5.

    Parameters
    ----------
    path : Path
    mode : {"r", "r+", "w"}

    Raises
    ------
    FileNotFoundError
        If there is no such file to read.
    DamagedError
        If it is cut short, or no HDF5 file.
    OSError, KeyboardInterrupt
        From `sync` and `close`: the error that stopped the first write that failed.
    """

    def __init__(self, path: Path, mode: str) -> None:
        self._bytes = _Bytes(path, _MODES[mode])
        try:
            super().__init__(self._bytes, mode, libver="earliest")
        except (OSError, RuntimeError) as error:
            self._bytes.close()
            self._raise_failure()
            reason = f"is cut short, damaged or no HDF5 file ({error})"
            raise DamagedError(path, reason) from None

    def sync(self) -> None:
        """Wait until all that was written is on the disk."""
        self.flush()
        self._raise_failure()
        os.fsync(self._bytes.fileno())

    def close(self) -> None:
        """Close the file."""
        try:
            super().close()
        finally:
            self._bytes.close()
            self._raise_failure()

    def _raise_failure(self) -> None:
        if self._bytes.failure is not None:
            raise self._bytes.failure


class _Bytes(io.FileIO):
    """The bytes that HDF5 reads and writes; `failure` alone tells that a write has failed."""

    failure: BaseException | None = None

    def write(self, data: memoryview) -> int:  # type: ignore[override]
        if self.failure is None:
            try:
                rest = data
                while len(rest):  # a nearly full disk takes a part
                    rest = rest[super().write(rest) :]
            except BaseException as error:  # ctrl-C as well
                self.failure = error
        return len(data)

    def truncate(self, size: int | None = None) -> int:
        if self.failure is None:
            try:
                return super().truncate(size)
            except BaseException as error:  # ctrl-C as well
                self.failure = error
        return 0
