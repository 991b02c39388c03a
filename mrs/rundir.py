"""A run directory: its configuration, and what made it."""

from __future__ import annotations

import platform
import shutil
import subprocess
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

import tomli_w

CONFIG = "config.toml"


def create(
    directory: str | Path, recipe: dict[str, Any] | None, t_end: float, *, overwrite: bool
) -> None:
    """Make a directory with its config.toml.

    Raises
    ------
    FileExistsError
        If there is a run in it, unless `overwrite`; or if it holds anything else.
    """
    directory = Path(directory)
    present = sorted(path.name for path in directory.iterdir()) if directory.is_dir() else []
    if present and CONFIG not in present:
        raise FileExistsError(
            f"{directory} holds {present[0]!r} and no run; choose an empty directory"
        )
    if present and not overwrite:
        raise FileExistsError(
            f"{directory} holds a run; resume it, choose another, or overwrite it"
        )
    if present:
        shutil.rmtree(directory)
    directory.mkdir(parents=True, exist_ok=True)
    content = {"run": {"t_end": t_end}, "versions": versions()}
    if recipe is not None:
        content = recipe | content
    (directory / CONFIG).write_text(tomli_w.dumps(content), encoding="utf-8")


@cache
def versions() -> dict[str, str]:
    """Return the versions of what computes, and the commit if run from a working copy."""
    names = ("mrs-treecode", "numpy", "numba", "scipy", "h5py")
    found = {name: metadata.version(name) for name in names} | {"python": platform.python_version()}
    if _git("ls-files", "--error-unmatch", __file__) is not None:
        found["git"] = _git("describe", "--always", "--dirty") or "unknown"
    return found


def _git(*arguments: str) -> str | None:
    """Return what git says about this package's folder; None if it refuses or is not there."""
    command = ["git", *arguments]
    try:
        done = subprocess.run(
            command, cwd=Path(__file__).parent, capture_output=True, text=True, check=True
        )
    except (OSError, subprocess.CalledProcessError):
        return None
    return done.stdout.strip()
