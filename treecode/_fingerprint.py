"""A hash of values, and of functions with all that compiling them takes in.

Compiled code holds more than the text of a function: the values of the globals, attributes of
modules and closures that it reads, and what it calls, wherever that is written. What is not sure
to be the same in another process has no fingerprint.
"""

from __future__ import annotations

import builtins
import dis
import enum
import hashlib
import sys
from collections.abc import Iterable
from pathlib import Path
from types import BuiltinFunctionType, CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np
from numba.core.types import Type
from numba.core.typing.templates import builtin_registry

# What these define is known by name: it changes with their version only, which is hashed too, or
# in the case of this package with its sources, which are a part of every key.
_KNOWN = {__package__, "builtins", "cmath", "math", "numba", "numpy", "operator"}
_PLAIN = (type(None), type(Ellipsis), bool, int, float, complex, str, bytes)


class _UnsureError(Exception):
    """Something may be another thing in another process."""


def fingerprint(*values: Any, files: bool = True) -> str | None:
    """Return a hash of plain values, arrays, functions, and containers of these; None if unsure.

    Two processes that get the same one compile the same code from these functions. The `files` in
    which they stand count as well: an overload, or what an intrinsic emits, is beside its function.
    """
    digest = _Digest(files)
    try:
        digest.add(values)
    except _UnsureError:
        return None
    return digest.hash.hexdigest()


def code_of(kernel_class: type, methods: Iterable[str]) -> list[Any]:
    """Return what can be compiled of a class: its methods of these names, and its plain data."""
    data = {
        name: value
        for base in reversed(kernel_class.__mro__)
        for name, value in vars(base).items()
        if not name.startswith("__") and _is_plain(value)
    }
    return [data, [(name, getattr(kernel_class, name, None)) for name in sorted(methods)]]


def _is_plain(value: Any) -> bool:
    if isinstance(value, (tuple, frozenset)):
        return all(map(_is_plain, value))
    return isinstance(value, (*_PLAIN, np.generic))


class _Digest:
    """A hash to which values are added, each thing that may refer to itself once."""

    def __init__(self, files: bool) -> None:
        self.hash = hashlib.sha256()
        self._seen: dict[Any, Any] = {}  # what is kept alive keeps its id
        self._files: set[str] | None = set() if files else None

    def add(self, value: Any, attributes: Iterable[str] = ()) -> None:
        """Add a value; of a module or a class those of its `attributes` that are read."""
        key = id(value), tuple(attributes)
        if isinstance(value, _PLAIN):
            self._tell(type(value).__name__, repr(value))
        elif isinstance(value, (tuple, np.ndarray, np.generic)):  # equal ones may be one object
            self._add_object(value, attributes)
        elif key in self._seen:
            self._tell("seen", list(self._seen).index(key))
        else:
            self._seen[key] = value
            self._add_object(value, attributes)

    def _tell(self, *words: object) -> None:
        for word in words:
            text = word if isinstance(word, bytes) else str(word).encode()
            self.hash.update(b"%d:%b" % (len(text), text))

    def _add_object(self, value: Any, attributes: Iterable[str]) -> None:
        if isinstance(value, (np.ndarray, np.generic)):
            self._add_array(np.asarray(value))
        elif isinstance(value, (tuple, list)):
            self._tell(type(value).__qualname__, getattr(value, "_fields", ()), len(value))
            for item in value:
                self.add(item)
        elif isinstance(value, dict):
            self._tell("dict", len(value))
            for item in value.items():
                self.add(item)
        elif isinstance(value, (set, frozenset)):
            self._tell("set", *sorted(fingerprint(item) or _raise(item) for item in value))
        elif isinstance(value, enum.Enum):
            self._tell(type(value).__qualname__, value.name)
            self.add(value.value)
        elif isinstance(value, Type):  # numba's, a cast
            self._tell(value)
        elif isinstance(value, CodeType):
            self._add_code(value)
        elif isinstance(getattr(value, "py_func", None), FunctionType):  # compiled by numba
            self.add((value.py_func, value.targetoptions, getattr(value, "locals", None)))
        elif isinstance(value, ModuleType):
            self._add_members(value, value.__name__, attributes)
        elif isinstance(value, type):
            self._add_members(value, value.__module__, attributes)
            self._tell(value.__qualname__, getattr(value, "_fields", ()))
        elif isinstance(value, FunctionType) and not _is_known(value.__module__):
            self._add_function(value)
        elif isinstance(value, (FunctionType, BuiltinFunctionType, np.ufunc)):
            module = value.__module__ if hasattr(value, "__module__") else "numpy"
            self._add_known(value, module or "builtins", value.__name__)
        else:
            _raise(value)

    def _add_array(self, array: np.ndarray) -> None:
        if array.dtype.hasobject:
            _raise(array)
        self._tell(array.dtype, array.shape, np.ascontiguousarray(array).tobytes())

    def _add_known(self, value: Any, module: str, name: str) -> None:
        """Add the name of what a known package defines."""
        if not _is_known(module):
            _raise(value)
        package = sys.modules.get(module.partition(".")[0])
        self._tell(module, name, getattr(package, "__version__", sys.version))

    def _add_members(self, owner: Any, module: str, attributes: Iterable[str]) -> None:
        """Add the `attributes` of a module or a class that it has."""
        if _is_known(module):
            self._add_known(owner, module, owner.__name__)
            return
        self._tell(type(owner).__qualname__, owner.__name__)
        for name in attributes:
            if hasattr(owner, name):
                self._tell(name)
                self.add(getattr(owner, name), attributes)

    def _add_function(self, function: FunctionType) -> None:
        self.add(function.__code__)
        self.add(function.__defaults__)
        self.add(function.__kwdefaults__)
        attributes = sorted(_names(function.__code__, "LOAD_ATTR", "LOAD_METHOD"))
        for name in sorted(_names(function.__code__, "LOAD_GLOBAL")):
            self._tell(name)
            value = function.__globals__.get(name, getattr(builtins, name, None))
            self.add(value, attributes)
        for cell in function.__closure__ or ():
            try:
                value = cell.cell_contents
            except ValueError:  # empty
                _raise(function)
            self.add(value, attributes)
        for stub, kind in builtin_registry.globals:
            if stub is function:  # called, numba takes what its overload returns
                for template in kind.templates:
                    self.add(getattr(template, "_overload_func", None))

    def _add_code(self, code: CodeType) -> None:
        self._tell(code.co_code, code.co_argcount, code.co_kwonlyargcount, code.co_flags)
        self._tell(getattr(code, "co_exceptiontable", b""))
        self._tell(code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars)
        for constant in code.co_consts:
            self.add(constant)
        path = Path(code.co_filename)
        if self._files is not None and code.co_filename not in self._files and path.is_file():
            self._files.add(code.co_filename)
            self._tell(path.read_bytes())


def _is_known(module: str | None) -> bool:
    return (module or "").partition(".")[0] in _KNOWN


def _names(code: CodeType, *operations: str) -> set[str]:
    """Return the names that these operations of a function, and of those inside it, read."""
    found = {i.argval for i in dis.get_instructions(code) if i.opname in operations}
    inner = (c for c in code.co_consts if isinstance(c, CodeType))
    return found.union(*(_names(c, *operations) for c in inner))


def _raise(value: Any) -> Any:
    raise _UnsureError(value)
