"""Refusals: those of `treecode.check`, and of vectors."""

from __future__ import annotations

from typing import Any

import numpy as np

from treecode.check import LARGEST_COORDINATE, integer, number, one_of, points, positive, rows

__all__ = [
    "broadcast",
    "computable",
    "direction",
    "integer",
    "number",
    "one_of",
    "points",
    "positive",
    "rows",
    "vector",
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
