"""A run directory: its configuration, and what made it."""

from __future__ import annotations

import platform
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

import tomli_w
from filelock import FileLock, Timeout

from mrs.output.atomic import replacing

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

CONFIG = "config.toml"
_WRITTEN = ("checkpoint*.h5", "log.csv", "profile.csv", "*.vtkhdf")


def require_free(directory: str | Path, *, overwrite: bool) -> None:
    """Refuse a directory that holds a run, unless `overwrite`, or anything else but no run.

    Raises
    ------
    FileExistsError
    """
    directory = Path(directory)
    present = sorted(path.name for path in directory.iterdir()) if directory.is_dir() else []
    if present and not _content(directory):
        raise FileExistsError(
            f"{directory} holds {present[0]!r} and no run; choose an empty directory"
        )
    if present and not overwrite:
        raise FileExistsError(
            f"{directory} holds a run; resume it, choose another, or overwrite it"
        )


@contextmanager
def held(directory: str | Path) -> Iterator[None]:
    """Keep other processes from running in a directory, which is made if it is missing.

    Raises
    ------
    FileExistsError
        If another run goes on in it.
    """
    directory = Path(directory)
    directory.mkdir(parents=True, exist_ok=True)
    try:
        with FileLock(directory / ".lock", timeout=0):
            yield
    except Timeout:
        raise FileExistsError(f"{directory}: a run is going on in it") from None


def begin(directory: str | Path, recipe: dict[str, Any] | None, t_end: float) -> None:
    """Delete the files of an earlier run, no others, and write config.toml."""
    directory = Path(directory)
    for trajectory in directory.glob("*.vtkhdf"):
        _delete_live(trajectory.with_suffix(".pvd"))
    for pattern in _WRITTEN:
        for path in directory.glob(pattern):
            path.unlink()
    _write(directory, (recipe or {}) | {"run": {"t_end": t_end}, "versions": versions()})


def read(directory: str | Path) -> dict[str, Any]:
    """Return config.toml.

    Raises
    ------
    FileNotFoundError
        If the directory holds no run.
    """
    content = _content(Path(directory))
    if not content:
        raise FileNotFoundError(f"{directory} holds no run: no {CONFIG} with [run] and [versions]")
    return content


def extend(directory: str | Path, t_end: float) -> None:
    """Note in config.toml until when the run goes."""
    content = read(directory)
    if content["run"]["t_end"] != t_end:
        content["run"]["t_end"] = t_end
        _write(Path(directory), content)


def load_toml(path: str | Path) -> dict[str, Any]:
    """Return the contents of a TOML file; ValueError names the file if it is none."""
    try:
        return tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except ValueError as error:  # not TOML, or not UTF-8
        raise ValueError(f"{path}: {error}") from None


def _delete_live(path: Path) -> None:
    """Delete the list of a body's .vtp files, and these."""
    if path.exists():
        for frame in path.with_suffix("").glob("[0-9]*.vtp"):
            frame.unlink()
        path.unlink()
        with suppress(OSError):  # something else is in it
            path.with_suffix("").rmdir()


def _content(directory: Path) -> dict[str, Any]:
    """Return config.toml; nothing if there is none, or not that of a run."""
    path = directory / CONFIG
    content = load_toml(path) if path.is_file() else {}
    return content if "t_end" in content.get("run", {}) and "versions" in content else {}


def _write(directory: Path, content: dict[str, Any]) -> None:
    with replacing(directory / CONFIG) as temporary:
        temporary.write_text(tomli_w.dumps(content), encoding="utf-8")


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
