"""Tests of arguments, arrays, results of users' functions and spelling, beside `treecode.check`."""

from __future__ import annotations

import difflib
import functools
import inspect
import re
from collections.abc import Callable, Iterable
from typing import Any, TypeVar

import numpy as np

from treecode.check import (
    LARGEST_COORDINATE,
    direction,
    integer,
    number,
    one_of,
    points,
    positive,
    real,
    rows,
    shaped,
    short,
    unmasked,
    vector,
    within,
)

__all__ = [
    "FunctionError",
    "NotFiniteValueError",
    "broadcast",
    "computable",
    "direction",
    "file_name",
    "flag",
    "function",
    "instance",
    "instances",
    "integer",
    "key",
    "nearest",
    "not_negative",
    "number",
    "one_of",
    "points",
    "positive",
    "real",
    "rows",
    "shaped",
    "spelling",
    "unmasked",
    "vector",
    "vectors",
    "within",
]

_Called = TypeVar("_Called", bound=Callable[..., Any])


class FunctionError(ValueError):
    """The result of a user's function cannot be used."""


class NotFiniteValueError(FunctionError):
    """The result is not finite, which may be due to too long a step."""


def broadcast(
    name: str,
    value: Any,
    shape: tuple[int, ...],
    low: float = -np.inf,
    *,
    low_inclusive: bool = False,
) -> np.ndarray:
    """Return `value`, finite and above `low` as in `within`, broadcast to `shape` as float64."""
    array = real(name, value)
    try:
        array = np.array(np.broadcast_to(array, shape), np.float64)
    except ValueError:
        raise ValueError(
            f"{name} must be a number, or have shape {shape}, got shape {array.shape}"
        ) from None
    return within(name, array, low, low_inclusive=low_inclusive)


def not_negative(name: str, value: Any, high: float = 1e60) -> float:
    """Return `value` as a float from zero to below `high`."""
    return number(name, value, 0.0, high, low_inclusive=True)


def flag(name: str, value: Any) -> bool:
    """Return `value` if it is True or False."""
    if not isinstance(value, (bool, np.bool_)):
        raise TypeError(f"{name} must be True or False, got {value!r}")
    return bool(value)


def instance(name: str, value: Any, *kinds: type) -> Any:
    """Return `value` if it is of one of `kinds`."""
    if not isinstance(value, kinds):
        allowed = " or ".join("None" if k is type(None) else f"mrs.{k.__name__}" for k in kinds)
        raise TypeError(f"{name} must be {allowed}, got {short.repr(value)}")
    return value


def instances(name: str, values: Any, kind: type) -> tuple[Any, ...]:
    """Return `values`, any number of `kind`, as a tuple."""
    if isinstance(values, kind) or not isinstance(values, Iterable):
        raise TypeError(
            f"{name} must be a list of mrs.{kind.__name__}, in brackets also a single one, "
            f"got {short.repr(values)}"
        )
    return tuple(instance(f"{name}[{i}]", value, kind) for i, value in enumerate(values))


def key(name: str, value: Any, allowed: Iterable[str]) -> str:
    """Return `value` if it is one of the names `allowed`; KeyError, as mappings raise it."""
    try:
        return one_of(name, value, allowed)
    except ValueError as error:
        raise KeyError(str(error)) from None


def function(name: str, value: Any, of: str) -> Any:
    """Return `value` if it can be called."""
    if not callable(value):
        raise TypeError(f"{name} must be a function of {of}, got {short.repr(value)}")
    return value


def file_name(name: str, value: Any) -> str:
    """Return `value` if it can be the name of a file anywhere."""
    if not isinstance(value, str) or not re.fullmatch(r"\w[\w .-]{0,63}", value):
        raise ValueError(
            f"{name} must be a text of 1 to 64 letters, digits, '_', '-', '.' or spaces, "
            f"got {value!r}"
        )
    return value


def vectors(name: str, value: Any, count: int, where: Callable[[int], str]) -> np.ndarray:
    """Return the result of a user's function: (count, 3), or (3,) for all alike; all of it finite.

    Parameters
    ----------
    name : str
    value : array_like
    count : int
    where : callable
        Says of a row which place and time it belongs to.

    Raises
    ------
    FunctionError
    """
    array = np.asarray(real(name, value), float)
    if array.shape not in ((3,), (count, 3)):
        raise FunctionError(f"{name} must give shape (3,) or ({count}, 3), got {array.shape}")
    array = np.broadcast_to(array, (count, 3))
    with np.errstate(over="ignore", invalid="ignore"):
        total = array.sum()  # half the time of a look at each
    if not np.isfinite(total) and not np.isfinite(array).all():
        row = int(np.argmin(np.isfinite(array).all(axis=1)))
        raise NotFiniteValueError(f"{name} must give finite numbers, got {array[row]} {where(row)}")
    return array


def computable(points: np.ndarray, loads: np.ndarray) -> bool:
    """Return whether points and loads are in the range of the sums."""
    within = np.abs(points).max(initial=0.0) <= LARGEST_COORDINATE  # false for nan as well
    return bool(within and np.isfinite(loads).all())


def nearest(name: str, names: Iterable[str]) -> str:
    """Return "; did you mean ...?" with the nearest of `names`; nothing if none is near."""
    close = difflib.get_close_matches(name, names, n=1)
    return f"; did you mean {close[0]!r}?" if close else ""


def spelling(what: _Called) -> _Called:
    """Let a class or function name the nearest of its arguments to one that it does not have.

    Python 3.13 does so by itself.
    """
    function = what.__init__ if isinstance(what, type) else what  # type: ignore[misc]
    names = [name for name in inspect.signature(function).parameters if name != "self"]

    @functools.wraps(function)
    def called(*arguments: Any, **options: Any) -> Any:
        for name in options:
            if name not in names:
                near = nearest(name, names) or f"; there are {', '.join(names)}"
                raise TypeError(f"{what.__name__} has no argument {name!r}{near}")
        return function(*arguments, **options)

    if not isinstance(what, type):
        return called  # type: ignore[return-value]
    what.__init__ = called  # type: ignore[misc]
    return what
