"""How much memory a process may take."""

from __future__ import annotations

from pathlib import Path

import psutil

_GROUPS = Path("/sys/fs/cgroup")
_MEMBERSHIP = Path("/proc/self/cgroup")


def memory_limit() -> int:
    """Return the bytes that this process may have: of the machine, its control groups and ulimit.

    A container or a job of a batch system is a control group of Linux, with a limit of its own or
    of a group that it is in.
    """
    limits = [psutil.virtual_memory().total, *_group_limits()]
    if hasattr(psutil, "RLIMIT_AS"):
        limits.append(psutil.Process().rlimit(psutil.RLIMIT_AS)[0])
    return min(limit for limit in limits if limit > 0)


def _group_limits() -> list[int]:
    """Return the limits of the groups of this process; the first version writes huge ones."""
    limits: list[int] = []
    try:
        for line in _MEMBERSHIP.read_text().splitlines():
            _, controllers, path = line.split(":", 2)
            if controllers in ("", "memory"):
                root = _GROUPS / controllers
                file = "memory.limit_in_bytes" if controllers else "memory.max"
                inside = root / path.lstrip("/")
                # A container may see its group as the root.
                for group in (root, inside, *inside.parents):
                    if group.is_relative_to(root) and (group / file).is_file():
                        text = (group / file).read_text().strip()
                        limits += [int(text)] if text.isdigit() else []  # or "max"
    except OSError:  # another system
        pass
    return limits
