"""Files that appear whole or not at all."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


class WriteError(OSError):
    """A file could not be written; the message names it and a remedy."""


class DamagedError(ValueError):
    """A file that is cut short, damaged, or of another kind than it should be.

    Attributes
    ----------
    reason : str
        The fault: the message without the file's name, and without the remedy.
    """

    def __init__(self, path: Path, reason: str, remedy: str = "") -> None:
        super().__init__(f"{path} {reason}{remedy}")
        self.reason = reason


@contextmanager
def telling(path: Path) -> Iterator[None]:
    """Name the file if a write fails, and a remedy if the disk is full.

    Parameters
    ----------
    path : Path
        Of the file that is written inside.

    Raises
    ------
    WriteError
        In place of an OSError that names no file, or of a full disk.
    """
    try:
        yield
    except WriteError:
        raise
    except OSError as error:
        full = error.errno in _FULL
        if not full and (error.errno is None or error.filename is not None):
            raise
        kept = (
            "; what it held before is kept: free some space, then `mrs resume` a run, or try again"
        )
        told = WriteError(f"{path} could not be written: {error.strerror}" + kept * full)
        told.errno = error.errno
        raise told from error


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give a temporary name to write to; the file takes the place of `path` if nothing is raised.

    Parameters
    ----------
    path : Path
        Of the file to be. The temporary name beside it has the same suffix.
    """
    temporary = temporary_name(path)
    try:
        with telling(path):
            yield temporary
            sync(temporary)
        temporary.replace(path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
    sync_folder(path.parent)


def temporary_name(path: Path) -> Path:
    """Return the name of a file until it is whole; a run that is killed leaves it behind.

    Parameters
    ----------
    path : Path
        Of the whole file.
    """
    return path.with_name(f".{path.stem}.partial{path.suffix}")


def sync(path: Path) -> None:
    """Wait until the contents of a file are on the disk.

    Parameters
    ----------
    path : Path
    """
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def sync_folder(path: Path) -> None:
    """Wait until the names in a folder are on the disk, where the system has such a call.

    Parameters
    ----------
    path : Path
        Of the folder.
    """
    if os.name == "posix":
        sync(path)
