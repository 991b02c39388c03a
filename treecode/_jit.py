"""The one file that spells numba: options, the on-disk cache, and machine-level primitives.

Nothing else in the package names a compiler flag. A function is one of four things:

``inlined``     always part of its caller;
``standalone``  called by others, compiled with them, but a function of its own to LLVM;
``compiled``    called from Python, independent of the kernel; compiled once and cached;
``Driver``      called from Python with a kernel first; compiled and cached once a kernel class.

All are serial, and the last two leave the interpreter to other threads: `threads.Threads` shares
their work. numba's own threads stay alive and do not survive a fork.
"""

from __future__ import annotations

import functools
import hashlib
import os
import pickle
import platform
import sys
import time
from collections.abc import Callable
from operator import attrgetter
from pathlib import Path
from typing import Any

import llvmlite
import numba
import numpy as np
import numpy.ma  # else by numba in the first sum: a fork at that time would hang
from llvmlite import ir
from llvmlite.binding import Linkage
from numba import types
from numba.core.caching import NullCache
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompileResult
from numba.core.compiler_lock import global_compiler_lock
from numba.core.errors import NumbaError, UnsupportedBytecodeError
from numba.core.serialize import dumps
from numba.extending import intrinsic, overload
from numba.np import arrayobj

from treecode import cache
from treecode._fingerprint import code_of, fingerprint
from treecode._mistakes import explain

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
_CHECK = hashlib.sha256().digest_size  # bytes before those of a file of the cache


inlined = numba.njit(**_INLINED)
standalone = numba.njit(**_OPTIONS, forceinline=False)


def free_at_fork(lock: Any) -> None:
    """Let a process fork when nobody holds `lock`: in its child nobody could release it."""
    if hasattr(os, "register_at_fork"):
        os.register_at_fork(
            before=lock.acquire, after_in_parent=lock.release, after_in_child=lock.release
        )


free_at_fork(global_compiler_lock)


@functools.cache
def _package_hash() -> str:
    """Hash of every source file, and of who compiles them."""
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parent.rglob("*.py")):
        digest.update(path.read_bytes())
    versions = numba.__version__, llvmlite.__version__, np.__version__, sys.implementation.cache_tag
    digest.update(repr(versions).encode())
    return digest.hexdigest()


class _Cache(NullCache):
    """The compiled versions of one function on disk, a file each.

    A cache is never needed: what cannot be read is compiled, and written anew. numba's own keeps an
    index of the versions beside them. It ends the program where a file is damaged or cannot be
    written; two processes that start together can enter one version under the name of another; and
    it cannot be read any more once a kernel's class cannot be imported.
    """

    def __init__(self, function: Callable, key: str) -> None:
        self._name = f"{function.__module__}.{function.__qualname__}"
        self._key = key

    @property
    def cache_path(self) -> str | None:
        folder = cache.folder()
        return str(folder / self._key[:16]) if folder else None

    def _path(self, signature: Any, codegen: Any) -> Path | None:
        """Return the file of a version; None if it has no name that another process would know."""
        what = f"{self._key}{self._name}{signature}{codegen.magic_tuple()}"
        folder = self.cache_path
        if folder is None or " at 0x" in what:  # an address
            return None
        version = hashlib.sha256(what.encode()).hexdigest()[:16]
        return Path(folder) / f"{self._name}.{version}.nbc"

    def load_overload(self, signature: Any, target_context: Any) -> Any:
        """Return a compiled version; None if there is none, or a damaged one."""
        target_context.refresh()
        path = self._path(signature, target_context.codegen())
        if path is None:
            return None
        try:
            data = path.read_bytes()
            if hashlib.sha256(data[_CHECK:]).digest() != data[:_CHECK]:
                return None
            result = CompileResult._rebuild(target_context, *pickle.loads(data[_CHECK:]))
        except Exception:  # whatever unpickling raises
            return None
        cache.mark_used(path)
        return result if result.signature.args == tuple(signature) else None

    def save_overload(self, signature: Any, result: Any) -> None:
        """Write a compiled version."""
        path = self._path(signature, result.codegen)
        if path is None:
            if self.cache_path is None:
                cache.warn("there is no home folder")
            return
        if not result.library.has_dynamic_globals:
            data = dumps(result._reduce())
            cache.write(path, lambda file: file.write(hashlib.sha256(data).digest() + data))
            cache.prune_compiled()


def _keep_apart() -> None:
    """Let every function that is called from Python have its own copies of all that it calls.

    numba gives these copies one name in all libraries of a process. LLVM then takes the first that
    it meets for all of them, although each was optimised with its caller: the last bits of a sum
    would depend on whether code was compiled or loaded, and in which order.
    """
    library_class: Any = JITCodeLibrary
    finalize = library_class._finalize_final_module

    def finalize_apart(library: Any) -> None:
        if library.name in _entries:
            for function in library._final_module.functions:
                if function.linkage == Linkage.linkonce_odr:
                    function.linkage = Linkage.internal
        finalize(library)

    library_class._finalize_final_module = finalize_apart


_entries: set[str] = set()  # names of the libraries of functions that are called from Python
_keep_apart()


def _cached(function: Callable, key: str | None) -> Any:
    """Compile a function that is called from Python; keep it on disk if there is a key.

    It leaves the interpreter to other threads.
    """
    _entries.add(function.__qualname__)
    dispatcher = numba.njit(**_OPTIONS, forceinline=False, nogil=True)(function)
    if key is not None and not INTERPRETED:
        dispatcher._cache = _Cache(function, key)
    return dispatcher


def compiled(function: Callable) -> Any:
    """Compile a function that does not depend on the kernel."""
    return _cached(function, _package_hash())


class Driver:
    """A function of a kernel, compiled and cached once for each kernel class.

    Each kernel class has a cache folder of its own, named by all that is compiled of it. An edit to
    a user's kernel is therefore seen, wherever it is made. Kernels of a script or a notebook itself
    are compiled at each run.
    """

    def __init__(self, function: Callable) -> None:
        self._function = function
        self._dispatchers: dict[type, Any] = {}

    def dispatcher(self, kernel_class: type) -> Any:
        """Return numba's dispatcher for one kernel class."""
        if kernel_class not in self._dispatchers:
            made = _cached(self._function, kernel_key(kernel_class))
            self._dispatchers.setdefault(kernel_class, made)
        return self._dispatchers[kernel_class]

    def __call__(self, kernel: Any, *arguments: Any) -> Any:
        try:
            return self.dispatcher(type(kernel))(kernel, *arguments)
        except (NumbaError, UnsupportedBytecodeError) as error:
            # numba's own has some hundred lines, most of them about functions of this package.
            raise TypeError(explain(kernel, str(error))) from None


@functools.cache
def kernel_key(kernel_class: type) -> str | None:
    """Return the name of a kernel's cache folder, or None if it cannot be cached."""
    module, name = kernel_class.__module__, kernel_class.__qualname__
    if module.partition(".")[0] == __package__:
        return _package_hash()
    # Another process must find the same class.
    try:
        found = attrgetter(name)(sys.modules[module])
    except (KeyError, AttributeError):
        found = None
    if module in ("__main__", "__mp_main__") or found is not kernel_class:
        return None
    return fingerprint(_package_hash(), module, name, code_of(kernel_class, _hooked))


def require_unchanged(kernel_class: type) -> None:
    """Refuse a kernel whose code, or a global that it reads, is not what it was the first time.

    Compiled code would not follow.
    """
    if kernel_class.__module__.partition(".")[0] != __package__:
        mark = fingerprint(code_of(kernel_class, _hooked), files=False)
        if _marks.setdefault(kernel_class, mark) != mark:
            raise RuntimeError(
                f"kernel {kernel_class.__qualname__}, or a global that it reads, has changed since "
                "it was compiled: define the class anew, or make a field of what changes"
            )


_hooked: set[str] = set()  # methods that compiled code can call
_marks: dict[type, str | None] = {}  # of the kernels that have been seen


def method_hook(stub: Callable) -> Callable:
    """Let jitted code call a Python method of a NamedTuple through the plain function `stub`.

    `stub(self, ...)` calls the method of its own name; compiled code gets the method itself,
    inlined. This is how kernels and expansions reach the loops, at no cost at run time.
    """
    name = stub.__name__
    _hooked.add(name)

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
