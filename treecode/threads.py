"""Threads for compiled functions that release the interpreter."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from typing import Any

import numba
from numba.np.ufunc import parallel
from tqdm import tqdm

_TURNS = 8  # pieces for each thread where work comes in no pieces of its own


def thread_count() -> int:
    """Return how many threads a sum may use: ``numba.get_num_threads()``.

    numba itself starts as many to answer that, and they would stay. Before `set_num_threads`,
    which starts them too, the answer is known.
    """
    return numba.get_num_threads() if parallel._is_initialized else parallel.get_thread_count()


class Threads:
    """As many threads as numba would use, but no more than `most`; a context.

    They live as long as the context, so that a process that forks has none. Who is done takes the
    next piece. Of prange each thread gets an equal share at once: in K example 1 two threads took
    1.12 times half the time of one for that alone.
    """

    def __init__(self, progress: bool = False, most: int | None = None) -> None:
        self._progress, self._most = progress, most

    def __enter__(self) -> Threads:
        count = thread_count()
        self._count = count if self._most is None else max(1, min(count, self._most))
        self._pool = ThreadPoolExecutor(self._count) if self._count > 1 else None
        return self

    def __exit__(self, *exception: Any) -> None:
        if self._pool:
            self._pool.shutdown(cancel_futures=True)

    def __call__(
        self,
        function: Callable[[slice], None],
        count: int,
        size: int | None = None,
        *,
        least: int = 1,
        progress: bool = False,
    ) -> None:
        """Call `function` for slices of ``range(count)``, each by one thread.

        A slice has `size` entries; where that is not given as many as make a few slices a thread,
        and at least `least`.
        """
        if size is None:
            size = max(least, -(-count // (_TURNS * self._count if self._pool else 1)))
        slices = [slice(i, min(i + size, count)) for i in range(0, count, size)]
        # A single piece wakes nobody.
        pool = self._pool if len(slices) > 1 else None
        run: Callable[..., Iterable[None]] = pool.map if pool else map
        # A bar that is not shown takes 37 us to make, longer than to sum a hundred points.
        shown = progress and self._progress
        with tqdm(total=len(slices), unit="batch") if shown else nullcontext() as bar:
            for _ in run(function, slices):
                if bar is not None:
                    bar.update()


def shared(function: Callable[[Any], Any], items: Sequence[Any]) -> list[Any]:
    """Return the values of `function` for all items, each computed by one thread."""
    values: list[Any] = [None] * len(items)

    def some(numbers: slice) -> None:
        for number in range(numbers.start, numbers.stop):
            values[number] = function(items[number])

    with Threads(most=len(items)) as threads:
        threads(some, len(items), size=1)
    return values
