"""One caller at a time, for objects whose work arrays are their own."""

from __future__ import annotations

import os
import threading
import weakref
from collections.abc import Callable
from functools import wraps
from typing import Any, Concatenate, ParamSpec, Protocol, TypeVar

_P = ParamSpec("_P")
_R = TypeVar("_R")


class Lock:
    """A re-entrant lock; a copy of it, pickled or not, is a new one.

    Examples
    --------
    >>> import treecode as tc
    >>> lock = tc.Lock()
    >>> with lock, lock:  # a thread may take it twice
    ...     print("one thread at a time")
    one thread at a time
    """

    def __init__(self) -> None:
        self._lock = threading.RLock()
        _locks.add(self)

    def __enter__(self) -> None:
        self._lock.acquire()

    def __exit__(self, *exception: Any) -> None:
        self._lock.release()

    def __reduce__(self) -> tuple[type[Lock], tuple[()]]:
        return Lock, ()

    def renew(self) -> None:
        """Free a forked process of what another thread, which it does not have, was holding."""
        if not self._lock._is_owned():  # type: ignore[attr-defined]
            self._lock = threading.RLock()


_locks: weakref.WeakSet[Lock] = weakref.WeakSet()


def _renew_all() -> None:
    for lock in list(_locks):
        lock.renew()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_renew_all)


class Locked(Protocol):
    """What has a lock."""

    lock: Lock


_L = TypeVar("_L", bound=Locked)


def one_at_a_time(method: Callable[Concatenate[_L, _P], _R]) -> Callable[Concatenate[_L, _P], _R]:
    """Let other threads wait until a method returns."""

    @wraps(method)
    def alone(self: _L, /, *arguments: _P.args, **options: _P.kwargs) -> _R:
        with self.lock:
            return method(self, *arguments, **options)

    return alone
