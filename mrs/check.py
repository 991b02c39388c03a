"""Refusals: those of `treecode.check`, and of vectors."""

from __future__ import annotations

import re
from typing import Any

import numpy as np

from treecode.check import LARGEST_COORDINATE, integer, number, one_of, points, positive, rows

__all__ = [
    "broadcast",
    "computable",
    "direction",
    "file_name",
    "instance",
    "integer",
    "number",
    "one_of",
    "points",
    "positive",
    "rows",
    "vector",
    "vectors",
]


def broadcast(name: str, value: Any, shape: tuple[int, ...], low: float = -np.inf) -> np.ndarray:
    """Return `value`, finite and greater than `low`, broadcast to `shape` as float64."""
    array = np.asarray(value)
    if array.dtype.kind not in "fiu":
        raise TypeError(f"{name} must hold real numbers, got {value!r}")
    try:
        array = np.array(np.broadcast_to(array, shape), np.float64)
    except ValueError:
        raise ValueError(
            f"{name} must have a shape that fits {shape}, got shape {array.shape}"
        ) from None
    if not (np.isfinite(array) & (array > low)).all():
        bound = "" if low == -np.inf else f" and greater than {low:g}"
        raise ValueError(f"{name} must be finite{bound}, got {value!r}")
    return array


def instance(name: str, value: Any, *kinds: type) -> Any:
    """Return `value` if it is of one of `kinds`."""
    if not isinstance(value, kinds):
        allowed = " or ".join("None" if k is type(None) else f"mrs.{k.__name__}" for k in kinds)
        raise TypeError(f"{name} must be {allowed}, got {value!r}")
    return value


def file_name(name: str, value: Any) -> str:
    """Return `value` if it can be the name of a file anywhere."""
    if not isinstance(value, str) or not re.fullmatch(r"\w[\w .-]{0,63}", value):
        raise ValueError(
            f"{name} must be a text of 1 to 64 letters, digits, '_', '-', '.' or spaces, "
            f"got {value!r}"
        )
    return value


def vectors(name: str, value: Any, count: int) -> np.ndarray:
    """Return what a user's function gave: (count, 3), or (3,) for all alike."""
    array = np.asarray(value, float)
    if array.shape not in ((3,), (count, 3)):
        raise ValueError(f"{name} must give shape (3,) or ({count}, 3), got {array.shape}")
    return np.broadcast_to(array, (count, 3))


def vector(name: str, value: Any) -> np.ndarray:
    """Return `value` as a finite (3,) float64 array."""
    return broadcast(name, value, (3,))


def direction(name: str, value: Any) -> np.ndarray:
    """Return `value`, (3,) and not zero, scaled to unit length."""
    array = vector(name, value)
    length = np.linalg.norm(array)
    if length == 0.0:
        raise ValueError(f"{name} must not be zero, got {value!r}")
    return array / length


def computable(points: np.ndarray, loads: np.ndarray) -> bool:
    """Return whether points and loads are in the range of the sums."""
    within = np.abs(points).max(initial=0.0) <= LARGEST_COORDINATE  # false for nan as well
    return bool(within and np.isfinite(loads).all())
