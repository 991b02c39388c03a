"""Refusals: every bad argument is named, with its value and what is allowed, before any work."""

from __future__ import annotations

import math
import re
import reprlib
from numbers import Real
from typing import Any

import numpy as np

# Kernels use up to the fifth power of an inverse length; within these it stays in range.
LARGEST_COORDINATE = 1e60
SMALLEST_PARAMETER, LARGEST_PARAMETER = 1e-60, 1e60

short = reprlib.Repr()
short.maxstring = short.maxother = 80


def number(name: str, value: Any, low: float, high: float, *, low_inclusive: bool = False) -> float:
    """Return `value` as a float between `low` and `high`, which is `low` only if that is said."""
    least = f"{low:g} (inclusive)" if low_inclusive else f"{low:g}"
    allowed = f"{name} must be a number between {least} and {high:g} (exclusive), got {value!r}"
    if isinstance(value, (str, bytes, bool, np.bool_)):
        raise TypeError(allowed)
    try:
        result = float(value)
    except (TypeError, ValueError, OverflowError):
        raise TypeError(allowed) from None
    if not (low < result < high or (low_inclusive and result == low)):  # nan: neither
        raise ValueError(allowed)
    return result


def positive(name: str, value: Any) -> float:
    """Return a kernel's parameter as a positive float whose powers stay in range."""
    return number(name, value, SMALLEST_PARAMETER, LARGEST_PARAMETER)


def kernel(value: Any, backend: str, members: tuple[str, ...], others: list[str]) -> Any:
    """Return `value` if it is a named tuple with the members that the backend needs.

    `value_lengths` must be as many numbers as values. `others` are backends for any kernel.
    """
    missing = [name for name in members if not hasattr(value, name)]
    if isinstance(value, type) or not isinstance(value, tuple):
        raise TypeError(
            "kernel must be an instance of a kernel such as RegularizedStokeslet(epsilon=0.1), "
            f"got {value!r}"
        )
    if missing:
        raise TypeError(
            f"kernel must have {', '.join(missing)} for backend {backend!r}, got {value!r}; "
            f"{' and '.join(map(repr, others))} work with any treecode.Kernel"
        )
    lengths, size = getattr(value, "value_lengths", None), getattr(value, "value_size", 0)
    if not (
        isinstance(lengths, tuple)
        and len(lengths) == size
        and all(isinstance(length, Real) for length in lengths)
    ):
        raise TypeError(
            f"kernel must have value_lengths, a tuple of {size} numbers that are equal for values "
            "of one unit, as (1, 1, 1) for velocities or (1, 1, 1, 2, 2, 2) for velocities and "
            f"angular velocities; got {lengths!r} in {value!r}"
        )
    return value


def integer(name: str, value: Any, low: int, high: int = 10**12) -> int:
    """Return `value` as an int from `low` to `high`."""
    allowed = f"{name} must be an integer from {low} to {high}, got {value!r}"
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, (int, np.integer)):
        raise TypeError(allowed)
    if not low <= value <= high:
        raise ValueError(allowed)
    return int(value)


def hexadecimals(name: str, value: Any) -> str:
    """Return a text of hexadecimal numbers of 64 bits at most, with blanks between."""
    if not isinstance(value, str) or not re.fullmatch(r"(?:[0-9a-f]{1,16}(?: |$))*", value):
        raise ValueError(f"{name} must be hexadecimal numbers of 64 bits, got {value!r}")
    return value


def one_of(name: str, value: Any, allowed: Any) -> str:
    """Return `value` if it is one of the strings `allowed`."""
    if not isinstance(value, str) or value not in allowed:
        raise ValueError(f"{name} must be one of {', '.join(map(repr, allowed))}, got {value!r}")
    return value


def absent(where: str, **values: Any) -> None:
    """Refuse values that something else decides."""
    for name, value in values.items():
        if value is not None:
            raise ValueError(f"{name} must be None {where}, got {value!r}")


def rows(name: str, value: Any, columns: int, count: int | None = None) -> np.ndarray:
    """Return `value` as a finite (N, columns) float64 array; N must be `count` if that is given."""
    shape = f"({'N' if count is None else count}, {columns})"
    unmasked(name, value)
    try:
        array = np.asarray(value)
    except ValueError:  # ragged
        raise ValueError(f"{name} must have shape {shape}, got rows of different length") from None
    if array.dtype.kind not in "fiu" and array.size:
        raise TypeError(f"{name} must hold real numbers, got dtype {array.dtype}")
    expected = array.shape[0] if array.ndim and count is None else count
    if array.shape != (expected, columns):
        raise ValueError(f"{name} must have shape {shape}, got {array.shape}")
    with np.errstate(over="ignore"):  # of wider floats; refused below
        array = np.ascontiguousarray(array, dtype=np.float64)
    if not np.isfinite(array).all():
        row = int(np.argmax(~np.isfinite(array).all(axis=1)))
        raise ValueError(f"{name} must be finite, got {array[row]} in row {row}")
    return array


def unmasked(name: str, value: Any) -> None:
    """Refuse masked entries, which NumPy would take for numbers."""
    parts = value if isinstance(value, (list, tuple)) else (value,)
    if any(np.ma.is_masked(part) for part in parts):
        raise ValueError(
            f"{name} must not have masked entries: fill them, or leave the rows out, got {value!r}"
        )


def real(name: str, value: Any) -> np.ndarray:
    """Return `value` as an array of real numbers, none of them masked."""
    unmasked(name, value)
    try:
        array = np.asarray(value)
    except ValueError:  # ragged
        raise ValueError(f"{name} must have rows of one length, got {short.repr(value)}") from None
    if array.dtype.kind not in "fiu":
        raise TypeError(f"{name} must hold real numbers, got {short.repr(value)}")
    return array


def shaped(name: str, value: Any, *shapes: tuple[int, ...]) -> np.ndarray:
    """Return `value`, finite and of one of `shapes`, as float64."""
    array = real(name, value)
    if array.shape not in shapes:
        allowed = " or ".join(map(str, shapes))
        raise ValueError(f"{name} must have shape {allowed}, got shape {array.shape}")
    return within(name, array.astype(np.float64), -np.inf)


def within(name: str, array: np.ndarray, low: float, *, low_inclusive: bool = False) -> np.ndarray:
    """Return `array` if it is finite and above `low`, or `low` itself if that is said."""
    above = array >= low if low_inclusive else array > low
    bad = np.argwhere(~(np.isfinite(array) & above))
    if len(bad):
        place = tuple(bad[0].tolist())
        than = "at least" if low_inclusive else "greater than"
        bound = "" if low == -np.inf else f" and {than} {low:g}"
        where = f" at {name}[{', '.join(map(str, place))}]" if place else ""
        raise ValueError(f"{name} must be finite{bound}, got {array[place]}{where}")
    return array


def vector(name: str, value: Any) -> np.ndarray:
    """Return `value` as a finite (3,) float64 array."""
    return shaped(name, value, (3,))


def direction(name: str, value: Any) -> np.ndarray:
    """Return `value`, (3,) and not zero, scaled to unit length."""
    array = vector(name, value)
    length = np.linalg.norm(array)
    if length == 0.0:
        raise ValueError(f"{name} must not be zero, got {value!r}")
    return array / length


def groups(value: Any, count: int) -> np.ndarray:
    """Return `value` as an int array, (count,)."""
    unmasked("groups", value)
    array = np.asarray(value)
    if array.dtype.kind not in "iu" and array.size:
        raise TypeError(f"groups must hold integers, got dtype {array.dtype}")
    if array.shape != (count,):
        raise ValueError(f"groups must have shape ({count},), one a target, got {array.shape}")
    return array.astype(np.int64)


def points(name: str, value: Any) -> np.ndarray:
    """Return `value` as a finite (N, 3) float64 array within `LARGEST_COORDINATE`."""
    array = rows(name, value, 3)
    if array.size and max(array.max(), -array.min()) > LARGEST_COORDINATE:
        row = int(np.argmax((np.abs(array) > LARGEST_COORDINATE).any(axis=1)))
        raise ValueError(
            f"{name} must lie within {LARGEST_COORDINATE:g} of the origin, "
            f"got {array[row]} in row {row}"
        )
    return array


def finite(name: str, value: np.ndarray) -> np.ndarray:
    """Return `value`; raise FloatingPointError if the arithmetic has left the range of doubles."""
    with np.errstate(over="ignore", invalid="ignore"):
        total = value.sum()  # half the time of a look at each
    if not math.isfinite(total) and not np.isfinite(value).all():
        raise FloatingPointError(
            f"{name} overflowed: strengths, epsilon or distances are beyond the range of float64"
        )
    return value
