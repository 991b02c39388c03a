"""Operators are built once: kept in memory, and on disk for other processes."""

from __future__ import annotations

import contextlib
import os
import threading
from collections import OrderedDict
from pathlib import Path
from typing import Any

import numpy as np

from treecode._fingerprint import fingerprint
from treecode._jit import cache_folder, free_at_fork, kernel_key, write_cache
from treecode.fmm.operators import Level, build_level
from treecode.kernels.base import Kernel

MEMORY_BYTES = 2**31
DISK_BYTES = 2**32

_memory: OrderedDict[Any, Level] = OrderedDict()
_lock = threading.Lock()
free_at_fork(_lock)


def folder() -> Path | None:
    """Return where operators are kept; None if nowhere."""
    base = cache_folder()
    return base and base / "operators"


def get_level(
    kernel: Kernel, half: float, tolerance: float, degree: int | None, dtype: type
) -> Level:
    """Return the operators of a level, from memory, from disk, or built; see `build_level`."""
    values = fingerprint(kernel)
    # The class itself, not its id, which another may get when this one is gone.
    key = type(kernel), values or kernel, half, tolerance, degree, dtype
    with _lock:
        if key in _memory:
            _memory.move_to_end(key)
            return _memory[key]
    path = _path(kernel_key(type(kernel)), values, half, tolerance, degree, np.dtype(dtype).name)
    level = _read(path) if path else None
    if level is None:
        level = build_level(kernel, half, tolerance, degree, dtype)
        if path:
            _write(path, level)
    with _lock:
        _memory[key] = level
        while sum(_bytes(kept) for kept in _memory.values()) > MEMORY_BYTES and len(_memory) > 1:
            _memory.popitem(last=False)
    return level


def _path(*what: Any) -> Path | None:
    """Return the file of a level; None if another process would not know what it belongs to."""
    base, key = folder(), None if None in what[:2] else fingerprint(*what)
    return base / f"{key[:32]}.npz" if base and key else None


def _bytes(level: Level) -> int:
    return level.matrices.nbytes


def _read(path: Path) -> Level | None:
    """Read a level; None if it is not there or damaged (a zip archive has checksums)."""
    if not path.exists():
        return None
    try:
        with np.load(path, allow_pickle=False) as file:
            fields: dict[str, Any] = {
                name: int(file[name]) if name == "degree" else file[name]
                for name in Level._fields
                if name in file
            }
            for name in Level._fields:
                if name not in fields:
                    count = int(file[f"{name}_count"])
                    fields[name] = tuple(file[f"{name}_{i}"] for i in range(count))
    except Exception:  # whatever the damage leads to
        return None
    with contextlib.suppress(OSError):  # of another owner, perhaps
        os.utime(path)  # used now: the oldest go first
    return Level(**fields)


def _write(path: Path, operators: Level) -> None:
    """Write a level, and delete the oldest if there is too much."""
    arrays: dict[str, Any] = {}
    for name, value in operators._asdict().items():
        if isinstance(value, tuple):
            arrays[f"{name}_count"] = np.array(len(value))
            arrays.update({f"{name}_{i}": array for i, array in enumerate(value)})
        else:
            arrays[name] = np.asarray(value)
    write_cache(path, lambda file: np.savez(file, **arrays))
    with contextlib.suppress(OSError):  # another process may delete some as well
        _delete_oldest(path.parent)


def _delete_oldest(where: Path) -> None:
    levels = sorted(where.glob("*.npz"), key=lambda level: level.stat().st_mtime)
    total = sum(level.stat().st_size for level in levels)
    for oldest in levels[:-1]:
        if total <= DISK_BYTES:
            break
        total -= oldest.stat().st_size
        oldest.unlink(missing_ok=True)
