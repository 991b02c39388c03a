"""The memory that a process may have: the least of what the machine and its groups allow."""

import psutil
import pytest

from treecode import memory

pytestmark = pytest.mark.interpreted
MACHINE = psutil.virtual_memory().total


@pytest.fixture
def groups(tmp_path, monkeypatch):
    """Return a function that lays out the files of Linux for this process."""
    monkeypatch.setattr(memory, "_GROUPS", tmp_path / "cgroup")
    monkeypatch.setattr(memory, "_MEMBERSHIP", tmp_path / "membership")

    def lay_out(membership, **files):
        (tmp_path / "membership").write_text(membership)
        for name, text in files.items():
            path = tmp_path / "cgroup" / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)
        return memory.memory_limit()

    return lay_out


def test_second_version(groups):
    limit = groups("0::/jobs/mine\n", **{"jobs/mine/memory.max": "1000000\n"})
    assert limit == 1_000_000


def test_a_group_further_up(groups):
    files = {"jobs/memory.max": "70000\n", "jobs/mine/memory.max": "max\n"}
    assert groups("0::/jobs/mine\n", **files) == 70_000


def test_first_version_in_a_container(groups):
    """The path is the host's, which the container does not see; its own group is the root."""
    files = {"memory/memory.limit_in_bytes": "5000000\n"}
    assert groups("3:cpu:/docker/a\n2:memory:/docker/a\n0::/\n", **files) == 5_000_000


def test_no_limit(groups):
    limits = {"memory/memory.limit_in_bytes": "9223372036854771712\n", "memory.max": "max\n"}
    assert groups("2:memory:/\n0::/\n", **limits) == MACHINE


def test_not_linux(groups, tmp_path, monkeypatch):
    monkeypatch.setattr(memory, "_MEMBERSHIP", tmp_path / "nothing")
    assert memory.memory_limit() == MACHINE


@pytest.mark.skipif(not hasattr(psutil, "RLIMIT_AS"), reason="not Linux")
def test_ulimit(groups, monkeypatch):
    """Batch systems limit the address space of a job."""
    monkeypatch.setattr(psutil.Process, "rlimit", lambda self, which: (12345, -1))
    assert groups("0::/\n") == 12345
