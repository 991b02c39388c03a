"""Threads for compiled functions that release the interpreter."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from typing import Any

import numba
from tqdm import tqdm


class Threads:
    """As many threads as numba would use, but no more than `most`; a context.

    Who is done takes the next piece. Of prange each thread gets an equal share at once: in K
    example 1 two threads took 1.12 times half the time of one for that alone.
    """

    def __init__(self, progress: bool = False, most: int | None = None) -> None:
        self._progress, self._most = progress, most

    def __enter__(self) -> Threads:
        count = numba.get_num_threads()
        if self._most is not None:
            count = min(count, self._most)
        self._pool = ThreadPoolExecutor(count) if count > 1 else None
        return self

    def __exit__(self, *exception: Any) -> None:
        if self._pool:
            self._pool.shutdown(cancel_futures=True)

    def __call__(
        self, function: Callable[[slice], None], count: int, size: int, progress: bool = False
    ) -> None:
        """Call `function` for slices of ``range(count)``, each by one thread."""
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
