"""The one file that spells numba: options, the on-disk cache, and machine-level primitives.

Nothing else in the package names a compiler flag. A function is one of four things:

``inlined``     always part of its caller;
``standalone``  called by others, compiled with them, but a function of its own to LLVM;
``compiled``    called from Python, independent of the kernel; compiled once and cached;
``Driver``      called from Python with a kernel first; compiled and cached once a kernel class.
"""

from __future__ import annotations

import hashlib
import inspect
import platform
import sys
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numba
import numpy as np
import platformdirs
from llvmlite import ir
from numba import types
from numba.extending import intrinsic, overload
from numba.np import arrayobj

# As fast as fastmath=True, but NaN and infinity keep their meaning; without "reassoc" a sum is
# not vectorised. The default error model tests every division for zero, which stops SIMD too.
# Both are given to every function: numba otherwise inherits them from whoever compiles first.
_OPTIONS: dict[str, Any] = {
    "fastmath": {"reassoc", "contract", "arcp", "nsz"},
    "error_model": "numpy",
}
_INLINED: Any = _OPTIONS | {"forceinline": True}
_CONFIG: Any = numba.config
INTERPRETED = bool(_CONFIG.DISABLE_JIT)  # nothing is compiled: debugging, coverage

inlined = numba.njit(**_INLINED)
standalone = numba.njit(**_OPTIONS, forceinline=False)


@cache
def _package_hash() -> str:
    """Hash of every source file: numba's own stamp misses an edit in a file that is called."""
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parent.rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def _cached(function: Callable, key: str | None, parallel: bool) -> Any:
    """Compile `function` with a disk cache in a folder named by `key`; no cache if it is None."""
    # Serial functions leave the interpreter to other threads, which run more of them.
    options = _OPTIONS | {"parallel": parallel, "forceinline": False, "nogil": not parallel}
    if key is None or INTERPRETED:
        return numba.njit(**options)(function)
    root = _CONFIG.CACHE_DIR
    folder = Path(root or platformdirs.user_cache_dir("treecode", appauthor=False))
    _CONFIG.CACHE_DIR = str(folder / key[:16])
    try:
        return numba.njit(cache=True, **options)(function)
    finally:
        _CONFIG.CACHE_DIR = root


def compiled(function: Callable) -> Any:
    """Compile a serial function that does not depend on the kernel."""
    return _cached(function, _package_hash(), parallel=False)


def compiled_parallel(function: Callable) -> Any:
    """Compile a function with ``prange`` loops that does not depend on the kernel."""
    return _cached(function, _package_hash(), parallel=True)


class Driver:
    """A function of a kernel, compiled and cached once for each kernel class.

    Each kernel class has a cache folder of its own, named by the package's sources and by the file
    that defines the kernel. An edit to a user's kernel is therefore seen, and no kernel that cannot
    be imported any more can spoil the index that others read. Kernels of a script or a notebook
    itself are compiled at each run.
    """

    def __init__(self, function: Callable, parallel: bool = True) -> None:
        self._function, self._parallel = function, parallel
        self._dispatchers: dict[type, Any] = {}

    def dispatcher(self, kernel_class: type) -> Any:
        """Return numba's dispatcher for one kernel class."""
        if kernel_class not in self._dispatchers:
            key = kernel_key(kernel_class)
            self._dispatchers[kernel_class] = _cached(self._function, key, self._parallel)
        return self._dispatchers[kernel_class]

    def __call__(self, kernel: Any, *arguments: Any) -> Any:
        return self.dispatcher(type(kernel))(kernel, *arguments)


def serial_driver(function: Callable) -> Driver:
    """Make a `Driver` of a function without ``prange`` loops, for threads of Python to call."""
    return Driver(function, parallel=False)


def kernel_key(kernel_class: type) -> str | None:
    """Return the name of a kernel's cache folder, or None if it cannot be cached."""
    if kernel_class.__module__.split(".")[0] == __package__:
        return _package_hash()
    if kernel_class.__module__ == "__main__":  # another process would not know it for the same
        return None
    source = inspect.getsource(sys.modules[kernel_class.__module__])
    name = f"{kernel_class.__module__}.{kernel_class.__qualname__}"
    return hashlib.sha256(f"{_package_hash()}{name}{source}".encode()).hexdigest()


def method_hook(stub: Callable) -> Callable:
    """Let jitted code call a Python method of a NamedTuple through the plain function `stub`.

    `stub(self, ...)` calls the method of its own name; compiled code gets the method itself,
    inlined. This is how kernels and expansions reach the loops, at no cost at run time.
    """
    name = stub.__name__

    @overload(stub, jit_options=_INLINED, strict=False)
    def _lookup(self, *arguments):
        return getattr(self.instance_class, name)

    return stub


def overloaded(stub: Callable) -> Callable:
    """Decorator: the decorated function returns the compiled twin of the Python function `stub`."""
    return overload(stub, jit_options=_INLINED)


@intrinsic
def _wide_vectors(typing_context):
    def codegen(context, builder, signature, arguments):
        attributes = builder.function.attributes
        attributes.add("noinline")  # inlined, a function loses its attributes
        # llvmlite lets only the names it knows through its own add(); LLVM takes any string.
        set.add(attributes, '"prefer-vector-width"="512"')
        return context.get_dummy_value()

    return types.void(), codegen


def _no_vectors() -> None:
    """Stand in for `wide_vectors` where nothing is compiled."""


# Called in a function, asks for the widest vectors in that function. LLVM keeps to 256 bits on
# AVX-512 processors; 512 bits are up to 1.6 times faster here (benchmarks/README.md). The
# attribute belongs to one function, where numba's CPU settings would change every other library.
wide_vectors = _no_vectors if INTERPRETED else _wide_vectors


@intrinsic
def _ticks(typing_context):
    def codegen(context, builder, signature, arguments):
        signature = ir.FunctionType(ir.IntType(64), ())
        counter = builder.module.declare_intrinsic("llvm.readcyclecounter", fnty=signature)
        return builder.call(counter, ())

    return types.int64(), codegen


@inlined
def _no_ticks():
    """Stand in for `ticks` on other processors, where programs may not read the counter."""
    return 0


# In a compiled function, a clock in a unit of its own.
_compiled_ticks = _ticks if platform.machine() in ("x86_64", "AMD64") else _no_ticks
ticks: Any = time.perf_counter_ns if INTERPRETED else _compiled_ticks


@intrinsic
def _stack_array(typing_context, like, rows, columns):
    array_type = types.Array(like.dtype, 2, "C")

    def codegen(context, builder, signature, arguments):
        rows, columns = (
            context.cast(builder, value, given, types.intp)
            for value, given in zip(arguments[1:], signature.args[1:], strict=True)
        )
        number = context.get_data_type(like.dtype)
        data = builder.alloca(number, size=builder.mul(rows, columns))
        data.align = 64
        itemsize = context.get_constant(types.intp, like.dtype.bitwidth // 8)
        array = context.make_array(array_type)(context, builder)
        arrayobj.populate_array(
            array,
            data=data,
            shape=(rows, columns),
            strides=(builder.mul(columns, itemsize), itemsize),
            itemsize=itemsize,
            meminfo=None,
        )
        return array._getvalue()

    return array_type(like, rows, columns), codegen


def _heap_array(like: np.ndarray, rows: int, columns: int) -> np.ndarray:
    """Stand in for `stack_array` where nothing is compiled."""
    return np.empty((rows, columns), like.dtype)


# An uninitialised (rows, columns) array of the numbers in `like` that lives until the calling
# function, which must be `standalone`, returns. LLVM knows that no two of these overlap, so that
# loops over them need no overlap checks at run time; for arrays of 16 columns those cost as much
# as the loops.
stack_array = _heap_array if INTERPRETED else _stack_array
