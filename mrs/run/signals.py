"""Signals that stop a run: ctrl-C, and those that batch queues and closed terminals send."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from treecode.ranks import OneRank

_NAMES = ("SIGINT", "SIGTERM", "SIGHUP", "SIGUSR1", "SIGUSR2", "SIGXCPU")
_STOPPING = [getattr(signal, name) for name in _NAMES if hasattr(signal, name)]
CTRL_C = int(signal.SIGINT)
_ONE_WISH = 1.0  # seconds in which several signals are one: a terminal and a parent send the same


class Stopped(KeyboardInterrupt):
    """A signal has asked to stop."""

    def __init__(self, number: int) -> None:
        super().__init__(f"stopped by {signal.Signals(number).name}")
        self.number = number

    def __reduce__(self) -> tuple[type[Stopped], tuple[int]]:
        return Stopped, (self.number,)


class Stopping:
    """The handler of the signals.

    It raises `Stopped` itself where nothing can be spoilt by it. In a run it notes the first signal
    only, which `check` raises: an exception that comes at any moment can be lost (in a callback of
    the garbage collector), come out as another one, or crash the compiler.

    Ranks stop together: a signal at any of them is raised where all of them look.

    Parameters
    ----------
    ranks : OneRank, optional
        Of a run. Without them the first signal raises as well.

    Attributes
    ----------
    asked : int or None
        The first signal.
    """

    def __init__(self, ranks: OneRank | None = None) -> None:
        self.asked: int | None = None
        self._waits = ranks is not None
        self._ranks = ranks or OneRank()
        self._held = False
        self._last = -_ONE_WISH

    def hold(self) -> None:
        """Let no signal interrupt from now on."""
        self._held = True

    def check(self) -> None:
        """Raise `Stopped` if that was asked for, at any rank."""
        for asked in self._ranks.exchange(self.asked):
            if asked is not None:
                raise Stopped(asked)

    def __call__(self, number: int, frame: FrameType | None) -> None:
        """Handle a signal."""
        first, now = self.asked is None, time.monotonic()
        if first:
            self.asked = number
        if self._held:
            if self._ranks.rank == 0:
                os.write(2, b"\nstopping; the last files are being written\n")
        elif self._ranks.size == 1 and now - self._last >= _ONE_WISH:
            self._last = now
            if not (first and self._waits):
                raise Stopped(number)


@contextmanager
def stopping(ranks: OneRank | None = None) -> Iterator[Stopping]:
    """Let signals raise `Stopped` here instead of ending the process; see `Stopping`.

    Handlers of the user's own, and signals that are ignored (nohup), are left alone, and so is
    everything outside the main thread, where Python handles no signals. One that has not stopped
    anything yet raises at the end, unless an error is on its way already.
    """
    handler = Stopping(ranks)
    before = {}
    if threading.current_thread() is threading.main_thread():
        before = {n: old for n in _STOPPING if _is_default(old := signal.getsignal(n))}
    try:
        for number in before:
            signal.signal(number, handler)
        yield handler
    finally:
        handler.hold()
        for number, old in before.items():
            signal.signal(number, old)
    handler.check()


def _is_default(handler: object) -> bool:
    ours = isinstance(handler, Stopping)
    return ours or handler in (signal.SIG_DFL, signal.default_int_handler)
