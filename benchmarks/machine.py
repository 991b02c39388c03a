"""The machine and the versions of a measurement, and the writing of its page."""

from __future__ import annotations

import datetime
import os
import platform
import shutil
import sys
from importlib.metadata import version
from pathlib import Path

PACKAGES = ("mrs-treecode", "numba", "numpy", "scipy")


def machine() -> str:
    """Return processor, system and versions."""
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text().splitlines() if cpuinfo.exists() else []
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    processor = models[0] if models else platform.processor() or platform.machine()
    versions = ", ".join(f"{name} {version(name)}" for name in PACKAGES)
    return (
        f"{os.cpu_count()} cores of {processor}, {platform.system()}; "
        f"Python {platform.python_version()}, {versions}"
    )


def mpirun() -> str | None:
    """Return the launcher of MPI, beside Python or on the path; None if there is none."""
    places = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
    return shutil.which("mpirun", path=places)


def machine_today() -> str:
    """Return the same with the date."""
    return f"{machine()}; {datetime.date.today()}"


def publish(lines: list[str], output: Path | None) -> None:
    """Write a page, or print it."""
    text = "\n".join(lines) + "\n"
    if output is None:
        print(text, end="")
    else:
        output.write_text(text)
