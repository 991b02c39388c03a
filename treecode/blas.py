"""BLAS on one thread, where threads of our own share the work."""

from __future__ import annotations

import threading
from functools import cache
from typing import Any

from threadpoolctl import ThreadpoolController

from treecode._jit import free_at_fork


class _OneThread:
    """A context in which BLAS has one thread: products of a chunk are too small to be shared.

    The number is that of the process. Of those who ask for it at the same time the last one out
    restores it; were it each, the first one's number would be lost, and BLAS left with one thread.
    """

    def __init__(self) -> None:
        self._lock, self._users = threading.Lock(), 0

    def __enter__(self) -> None:
        with self._lock:
            if not self._users:
                self._limit = _blas().limit(limits=1, user_api="blas")
            self._users += 1

    def __exit__(self, *exception: Any) -> None:
        with self._lock:
            self._users -= 1
            if not self._users:
                self._limit.restore_original_limits()


blas_of_one_thread = _OneThread()
free_at_fork(blas_of_one_thread._lock)


@cache
def _blas() -> ThreadpoolController:
    return ThreadpoolController()
