"""Operators are built once: kept in memory, and on disk for other processes."""

from __future__ import annotations

import threading
from collections import OrderedDict
from pathlib import Path
from typing import Any

import numpy as np

from treecode import cache
from treecode._fingerprint import fingerprint
from treecode._jit import free_at_fork, kernel_key
from treecode.kernels.base import Kernel
from treecode.methods.fmm.level import Level
from treecode.methods.fmm.operators import build_level

MEMORY_BYTES = 2**31
DISK_BYTES = 2**32

_memory: OrderedDict[Any, Level] = OrderedDict()
_lock = threading.Lock()
free_at_fork(_lock)


def folder() -> Path | None:
    """Return where operators are kept; None if nowhere."""
    base = cache.folder()
    return base and base / cache.OPERATORS


def get_level(kernel: Kernel, half: float, tol: float, degree: int | None, dtype: type) -> Level:
    """Return the operators of a level, from memory, from disk, or built; see `build_level`."""
    values = fingerprint(kernel)
    # The class itself, not its id, which another may get when this one is gone.
    key = type(kernel), values or kernel, half, tol, degree, dtype
    with _lock:
        if key in _memory:
            _memory.move_to_end(key)
            return _memory[key]
    path = _path(kernel_key(type(kernel)), values, half, tol, degree, np.dtype(dtype).name)
    level = _read(path) if path else None
    if level is None:
        level = build_level(kernel, half, tol, degree, dtype)
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
        # Opened here, since numpy does not close what it finds damaged.
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
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
    cache.mark_used(path)
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
    cache.write(path, lambda file: np.savez(file, **arrays))
    cache.delete_oldest(path.parent.iterdir(), DISK_BYTES)
