"""How long the stages of a sum take."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager


class Seconds(dict[str, float]):
    """Seconds by stage."""

    @contextmanager
    def stage(self, name: str, *, more: bool = False) -> Iterator[None]:
        """Note how long what is done inside takes, and what it took before if it is `more`."""
        start = time.perf_counter() - (self.get(name, 0.0) if more else 0.0)
        yield
        self[name] = time.perf_counter() - start
