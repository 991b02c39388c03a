"""Signals as a terminal has them: what runs in the background, or under nohup, ignores some."""

import signal
import sys

import pytest

from tests.thread_ranks import call_on_ranks

for _name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGUSR1", "SIGUSR2", "SIGXCPU"):
    _number = getattr(signal, _name, None)  # not all are there on Windows
    if _number is not None and signal.getsignal(_number) is signal.SIG_IGN:
        is_ctrl_c = _number is signal.SIGINT
        signal.signal(_number, signal.default_int_handler if is_ctrl_c else signal.SIG_DFL)


@pytest.fixture
def on_ranks(monkeypatch):
    """A function that calls another on some ranks, and returns what each returns or raises."""
    monkeypatch.setattr(sys, "excepthook", sys.__excepthook__)
    return call_on_ranks
