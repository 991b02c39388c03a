"""Anything that a scene is made of as plain values, by which two scenes can be compared.

Numbers count as equal if they differ by rounding, which another machine may do otherwise. Of large
arrays a few sums are kept instead of the numbers.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import math
import platform
import types
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

_FEW = 24  # numbers that are kept as they are
_ROUNDING = 1e-11
_OURS = ("mrs", "treecode", "numpy", "scipy", "builtins", "functools")  # not the user's own code
_SUMS = 3
_BY_PYTHON = ("python", "code")


class Difference(NamedTuple):
    """One value that two scenes do not share."""

    place: str
    """Where, for example "bodies.rods.bending"."""
    old: Any
    new: Any

    def __str__(self) -> str:
        if self.place.endswith(".code"):
            return f"{self.place.removesuffix('.code')}: its code has changed"
        old, new = _short(self.old), _short(self.new)
        return f"{self.place}: {old} became " + ("one with other numbers" if old == new else new)


def described(value: Any, _within: tuple[int, ...] = ()) -> Any:
    """Return a value as numbers, texts, lists and dicts that JSON can hold."""
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    if id(value) in _within:
        return "..."
    inner = functools.partial(described, _within=(*_within, id(value)))
    if isinstance(value, np.generic):
        return inner(value.item())
    if isinstance(value, np.ndarray):
        return _array(value) if value.dtype.kind in "fiub" else inner(value.tolist())
    if isinstance(value, Mapping):
        return {str(key): inner(item) for key, item in value.items()}
    if hasattr(value, "_asdict"):
        return inner(value._asdict())
    if isinstance(value, (list, tuple)):
        return _sequence(value, inner)
    if isinstance(value, (set, frozenset)):
        return sorted(map(repr, value))
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, (type, types.ModuleType, types.BuiltinFunctionType, np.ufunc)):
        return value.__name__
    if isinstance(value, types.FunctionType):
        return {"function": value.__qualname__, **_code(value, inner)}
    if isinstance(value, types.MethodType):
        return {"method": inner(value.__func__), "of": inner(value.__self__)}
    if isinstance(value, functools.partial):
        return inner({"partial": value.func, "arguments": value.args, "keywords": value.keywords})
    return _object(value, inner)


def differences(old: Any, new: Any, place: str = "") -> list[Difference]:
    """Return where two descriptions differ."""
    lists = isinstance(old, list) and isinstance(new, list) and len(old) == len(new)
    if lists and any(isinstance(item, dict) for item in [*old, *new]):
        old, new = ({str(i): item for i, item in enumerate(side)} for side in (old, new))
    if not (isinstance(old, dict) and isinstance(new, dict)) or "array" in {*old, *new}:
        return [] if _equal(old, new) else [Difference(place, old, new)]
    other_python = old.get("python") != new.get("python")  # with other bytecode
    keys = [k for k in dict.fromkeys([*old, *new]) if not (other_python and k in _BY_PYTHON)]
    start = f"{place}." if place else ""
    return [d for k in keys for d in differences(old.get(k), new.get(k), f"{start}{k}")]


def _equal(old: Any, new: Any, size: float = 0.0) -> bool:
    """Return whether two values are the same but for rounding of numbers of that size."""
    if isinstance(old, dict) and isinstance(new, dict):
        if "array" in old and "array" in new:
            return _equal(old["array"], new["array"])
        return not differences(old, new)
    if isinstance(old, list) and isinstance(new, list):
        numbers = [abs(leaf) for leaf in _leaves(old) if isinstance(leaf, (int, float))]
        size = size or max(numbers, default=0.0)
        return len(old) == len(new) and all(
            _equal(one, other, size) for one, other in zip(old, new, strict=True)
        )
    if isinstance(old, (int, float)) and isinstance(new, (int, float)):
        near = abs(old - new) <= _ROUNDING * max(size, abs(old))
        return near or old == new or (math.isnan(old) and math.isnan(new))
    return bool(old == new)


def _short(value: Any) -> str:
    if isinstance(value, dict) and "array" in value:
        return f"array {value['array'][0]}"
    text = "nothing" if value is None else repr(value)
    return text if len(text) <= 80 else f"{text[:80]}..."


def _sequence(value: Any, inner: Callable[[Any], Any]) -> Any:
    try:
        array = np.asarray(value)
    except ValueError:  # rows of different lengths
        array = np.empty(0, object)
    if array.dtype.kind in "fiub":
        return _array(array)
    items = [inner(item) for item in value]
    if len(items) <= _FEW:
        return items
    leaves = list(_leaves(items))
    numbers = [leaf for leaf in leaves if isinstance(leaf, (int, float))]
    texts = [leaf for leaf in leaves if not isinstance(leaf, (int, float))]
    return {"items": len(items), "numbers": _array(np.array(numbers)), "texts": _digest(texts)}


def _leaves(value: Any) -> Iterator[Any]:
    if isinstance(value, dict):
        yield from value
        value = list(value.values())
    if isinstance(value, list):
        for item in value:
            yield from _leaves(item)
    else:
        yield value


def _array(array: np.ndarray) -> Any:
    if array.size <= _FEW:
        return array.tolist()
    flat = array.ravel().astype(float)
    order = np.arange(1.0, 1.0 + flat.size)
    sums = [float(np.cos(order * order * (0.3 + k)) @ flat) for k in range(_SUMS)]
    return {"array": [str(array.shape), float(np.linalg.norm(flat)), *sums]}


def _object(value: Any, inner: Callable[[Any], Any]) -> dict[str, Any]:
    """Return the attributes of an object, and the code of its class if that is the user's."""
    kind = type(value)
    names = (
        [field.name for field in dataclasses.fields(value)]
        if dataclasses.is_dataclass(value)
        else list(getattr(value, "__dict__", ()))
    )
    found = {"kind": kind.__qualname__, **{name: inner(getattr(value, name)) for name in names}}
    return found | own_code(kind, inner)


def own_code(kind: type, inner: Callable[[Any], Any] = described) -> dict[str, Any]:
    """Return the code of the methods of a user's class; empty for classes of packages."""
    classes = [c for c in kind.__mro__ if c.__module__.partition(".")[0] not in _OURS]
    methods = {
        f"{c.__qualname__}.{name}": method
        for c in classes
        for name, method in vars(c).items()
        if isinstance(method, types.FunctionType)
    }
    if not methods:
        return {}
    code = {name: _code(method, inner) for name, method in methods.items()}
    return {"python": _python(), "code": _digest(_without_python(code))}


def _code(function: types.FunctionType, inner: Callable[[Any], Any]) -> dict[str, Any]:
    """Return the code of a function, and the values that it takes from around its definition."""
    taken: dict[str, Any] = {}
    for name, cell in zip(function.__code__.co_freevars, function.__closure__ or (), strict=True):
        try:
            taken[name] = inner(cell.cell_contents)
        except ValueError:  # not set
            taken[name] = None
    for name in _names(function.__code__):
        value = function.__globals__.get(name)
        own = isinstance(value, types.FunctionType) and value.__globals__ is function.__globals__
        if own or isinstance(value, (bool, int, float, str, list, tuple, np.ndarray)):
            taken[name] = inner(value)
    defaults = inner([function.__defaults__, function.__kwdefaults__])
    return {
        "python": _python(),
        "code": _digest(_bytecode(function.__code__)),
        "values": taken,
        "defaults": defaults,
    }


def _names(code: types.CodeType) -> list[str]:
    inner = [
        name
        for const in code.co_consts
        if isinstance(const, types.CodeType)
        for name in _names(const)
    ]
    return list(dict.fromkeys([*code.co_names, *inner]))


def _bytecode(code: types.CodeType) -> list[Any]:
    constants = [
        _bytecode(const)
        if isinstance(const, types.CodeType)
        else sorted(map(repr, const))
        if isinstance(const, frozenset)
        else repr(const)
        for const in code.co_consts
    ]
    return [code.co_code.hex(), code.co_names, code.co_varnames, constants]


def _without_python(code: dict[str, Any]) -> list[Any]:
    return [
        [name, entry["code"], entry["values"], entry["defaults"]] for name, entry in code.items()
    ]


def _python() -> str:
    return ".".join(platform.python_version_tuple()[:2])


def _digest(value: Any) -> str:
    return hashlib.sha256(repr(value).encode()).hexdigest()[:16]
