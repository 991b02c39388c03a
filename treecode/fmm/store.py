"""Operators are built once: kept in memory, and on disk for other processes."""

from __future__ import annotations

import contextlib
import hashlib
import os
import tempfile
import threading
import zipfile
from collections import OrderedDict
from pathlib import Path
from typing import Any

import numpy as np
import platformdirs

from treecode._jit import kernel_key
from treecode.fmm.operators import Level, build_level
from treecode.kernels.base import Kernel

MEMORY_BYTES = 2**31
DISK_BYTES = 2**32

_memory: OrderedDict[str, Level] = OrderedDict()
_lock = threading.Lock()


def folder() -> Path:
    """Return where operators are kept: in numba's cache folder if one is set."""
    root = os.environ.get("NUMBA_CACHE_DIR")
    base = Path(root or platformdirs.user_cache_dir("treecode", appauthor=False))
    return base / "operators"


def get_level(
    kernel: Kernel, half: float, tolerance: float, degree: int | None, dtype: type
) -> Level:
    """Return the operators of a level, from memory, from disk, or built; see `build_level`."""
    source = kernel_key(type(kernel))  # None for a kernel that another process would not know
    what: Any = (type(kernel).__qualname__, repr(kernel), half.hex(), tolerance, degree, dtype)
    key = hashlib.sha256(f"{source or id(type(kernel))}{what}".encode()).hexdigest()
    with _lock:
        if key in _memory:
            _memory.move_to_end(key)
            return _memory[key]
    path = None if source is None else folder() / f"{key[:32]}.npz"
    level = _read(path) if path else None
    if level is None:
        level = build_level(kernel, half, tolerance, degree, dtype)
        if path:
            with contextlib.suppress(OSError):  # a full or read-only disk is no reason to stop
                _write(path, level)
    with _lock:
        _memory[key] = level
        while sum(_bytes(kept) for kept in _memory.values()) > MEMORY_BYTES and len(_memory) > 1:
            _memory.popitem(last=False)
    return level


def _bytes(level: Level) -> int:
    return level.matrices.nbytes


def _read(path: Path) -> Level | None:
    """Read a level; None if it is not there or damaged (a zip archive has checksums)."""
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
        os.utime(path)  # used now: the oldest go first
    except (OSError, KeyError, ValueError, EOFError, zipfile.BadZipFile):
        return None
    return Level(**fields)


def _write(path: Path, operators: Level) -> None:
    """Write a level, whole or not at all, and delete the oldest if there is too much."""
    arrays: dict[str, Any] = {}
    for name, value in operators._asdict().items():
        if isinstance(value, tuple):
            arrays[f"{name}_count"] = np.array(len(value))
            arrays.update({f"{name}_{i}": array for i, array in enumerate(value)})
        else:
            arrays[name] = np.asarray(value)
    path.parent.mkdir(parents=True, exist_ok=True)
    descriptor, temporary = tempfile.mkstemp(dir=path.parent, suffix=".part")
    try:
        with os.fdopen(descriptor, "wb") as file:
            np.savez(file, **arrays)
        Path(temporary).replace(path)
    finally:
        Path(temporary).unlink(missing_ok=True)
    levels = sorted(path.parent.glob("*.npz"), key=lambda level: level.stat().st_mtime)
    total = sum(level.stat().st_size for level in levels)
    for oldest in levels[:-1]:
        if total <= DISK_BYTES:
            break
        total -= oldest.stat().st_size
        oldest.unlink(missing_ok=True)
