"""Files that later processes use: compiled code, and operators of the fast multipole method.

The folder is ``NUMBA_CACHE_DIR`` if that is set, else one of the user's. The name of a file is a
hash of all that it depends on: the sources of this package and of a user's kernel, the versions of
the compilers. No name tells whether its version will ever run again. So every use of a file sets
its time, and when the files of one kind take more than a number of bytes, those are deleted that
have not been used for longest.
"""

from __future__ import annotations

import contextlib
import os
import warnings
from collections.abc import Callable, Iterable
from datetime import datetime
from pathlib import Path
from typing import Any, BinaryIO, Literal, NamedTuple
from uuid import uuid4

import numba
import platformdirs

__all__ = ["Kept", "clear", "contents", "folder"]

COMPILED_BYTES = 2**29  # some forty versions of the package, each with the kernels of the tests
OPERATORS = "operators"  # the name of their folder
_VERSION = "[0-9a-f]" * 16  # the names of folders of compiled code
_ENDINGS = (".nbc", ".nbi", ".npz", ".part")  # .nbi of earlier versions, .part of killed processes
_CONFIG: Any = numba.config


class Kept(NamedTuple):
    """What one folder of the cache holds.

    Examples
    --------
    >>> import treecode as tc
    >>> for kept in tc.cache.contents():  # nothing is printed if nothing is kept
    ...     print(f"{kept.kind}: {kept.bytes / 1e6:.0f} MB, last used {kept.used:%x}")
    """

    path: Path
    kind: Literal["compiled code", "operators"]
    bytes: int
    used: datetime
    """When any of its files was used last."""


def folder() -> Path | None:
    """Return where files are kept; None where there is no place for them.

    That is ``NUMBA_CACHE_DIR`` if it is set, else a folder of the user's.

    Examples
    --------
    >>> import treecode as tc
    >>> tc.cache.folder().is_absolute()
    True
    """
    try:
        root = _CONFIG.CACHE_DIR or platformdirs.user_cache_dir("treecode", appauthor=False)
    except RuntimeError:  # a user without a home
        return None
    return None if str(root).startswith("~") else Path(root)  # from older platformdirs


def contents() -> list[Kept]:
    """Return what is kept, a folder each, the last used first.

    Folders of compiled code are of one version of the package each, or of a kernel of the user's.
    What other programs keep in the same place is not counted.

    Examples
    --------
    >>> import treecode as tc
    >>> sum(kept.bytes for kept in tc.cache.contents()) < 6e9  # older files are deleted
    True
    """
    kept = []
    for path in _folders():
        found = [file.stat() for file in _files(path)]
        if found:
            size, used = sum(f.st_size for f in found), max(f.st_mtime for f in found)
            kind: Any = OPERATORS if path.name == OPERATORS else "compiled code"
            kept.append(Kept(path, kind, size, datetime.fromtimestamp(used)))
    return sorted(kept, key=lambda entry: entry.used, reverse=True)


def clear() -> int:
    """Delete all that is kept, nothing of other programs; return how many bytes that was.

    The next sum of each kind compiles again, and the fast multipole method builds its operators
    again. A process that runs goes on with what it has loaded.

    Examples
    --------
    >>> import treecode as tc
    >>> freed = tc.cache.clear()
    >>> tc.cache.contents()
    []
    """
    total = sum(entry.bytes for entry in contents())
    for path in _folders():
        for file in _files(path):
            _delete(file)
    return total


def write(path: Path, content: Callable[[BinaryIO], object]) -> None:
    """Let `content` fill a file, whole or not at all; where that fails say so, and go on."""
    temporary = path.with_name(f"{path.name}.{uuid4().hex}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            with temporary.open("xb") as file:
                content(file)
            temporary.replace(path)
        finally:
            temporary.unlink(missing_ok=True)
    except OSError as error:
        warn(error.strerror or str(error))


_warned: set[Path | None] = set()


def warn(reason: str) -> None:
    """Say, once for each folder, that nothing is kept there."""
    where = folder()
    if where not in _warned:
        _warned.add(where)
        warnings.warn(
            f"cannot keep compiled code in {where or 'a cache folder'} ({reason}): every process "
            "compiles it again; set NUMBA_CACHE_DIR to a folder that can be written",
            RuntimeWarning,
            stacklevel=2,
        )


def mark_used(file: Path) -> None:
    """Note that a file is of use: the others go first."""
    with contextlib.suppress(OSError):  # of another owner, perhaps
        os.utime(file)


def prune_compiled() -> None:
    """Delete compiled code that has not been used for longest, if there is too much."""
    files = (file for path in _folders() if path.name != OPERATORS for file in _files(path))
    delete_oldest(files, COMPILED_BYTES)


def delete_oldest(files: Iterable[Path], most: int) -> None:
    """Delete the files that have not been used for longest; the others take at most `most` bytes.

    The last used one stays, whatever it takes.
    """
    with contextlib.suppress(OSError):  # another process may delete some as well
        found = [(file, file.stat()) for file in files]
        total = 0
        for file, stat in sorted(found, key=lambda one: one[1].st_mtime, reverse=True):
            if total and total + stat.st_size > most:
                _delete(file)
            total += stat.st_size


def _folders() -> list[Path]:
    root = folder()
    if root is None or not root.is_dir():
        return []
    return [path for path in (*root.glob(_VERSION), root / OPERATORS) if path.is_dir()]


def _files(path: Path) -> list[Path]:
    return [file for file in path.rglob("*") if file.suffix in _ENDINGS]


def _delete(file: Path) -> None:
    """Delete a file, and the folders that it leaves empty."""
    file.unlink(missing_ok=True)
    for path in file.parents[:2]:  # earlier versions had a folder in between
        if path == folder():
            break
        with contextlib.suppress(OSError):  # not empty
            path.rmdir()
