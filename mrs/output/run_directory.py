"""A run directory: its configuration, the versions that made it, and the files of the run.

Every file that a run, or a command on it, writes there is noted in `files.txt`, one name a line.
Overwriting a run deletes these and no others.
"""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

import tomli_w
from filelock import FileLock, Timeout

from mrs.output.atomic import replacing, telling, temporary_name
from treecode.version import __version__

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

CONFIG = "config.toml"
CHECKPOINT = "checkpoint.h5"
_FILES = "files.txt"
_HEADER = "# Files of this run; `mrs run --overwrite` deletes these and no others."
_LOCK = ".lock"


@contextmanager
def held(directory: str | Path) -> Iterator[None]:
    """Keep other processes from running in a directory.

    The directory is made if it is missing, and goes again if nothing is written there.

    Parameters
    ----------
    directory : path

    Raises
    ------
    FileExistsError
        If another run goes on in it.
    NotADirectoryError
        If it is a file, or below one.
    """
    directory = Path(directory)
    with ExitStack() as stack:
        for folder in _missing(directory):
            stack.callback(_remove_empty, folder)
        directory.mkdir(parents=True, exist_ok=True)
        try:
            stack.enter_context(FileLock(directory / _LOCK, timeout=0))
        except Timeout:
            raise FileExistsError(f"{directory}: a run is going on in it") from None
        if os.name == "posix":  # elsewhere it goes when it is released
            stack.callback(_delete, directory / _LOCK)
        yield


def begin(
    directory: str | Path,
    recipe: dict[str, Any] | None,
    t_end: float,
    files: Iterable[Path],
    *,
    overwrite: bool,
) -> None:
    """Delete the files of an earlier run, no others, and write config.toml.

    Parameters
    ----------
    directory : path
    recipe : dict or None
        Scenario and options, from which the simulation can be built again.
    t_end : float
    files : iterable of Path
        Files that the run will write besides.
    overwrite : bool
        Whether an earlier run may be deleted.

    Raises
    ------
    FileExistsError
        If there is an earlier run, or a file that is not a run's where the run would write one.
        Nothing is changed then.
    """
    directory = Path(directory)
    earlier = noted(directory)
    if earlier and not overwrite:
        raise FileExistsError(
            f"{directory} holds a run; go on with it (`mrs resume {directory}`, in a script "
            "`mrs.restart(sim).run(t_end)`), choose another directory, or delete it with "
            "--overwrite (overwrite=True)"
        )
    own = [directory / CONFIG, directory / _FILES, *files]
    foreign = [path for path in own if os.path.lexists(path) and path not in earlier]
    if foreign:
        raise FileExistsError(
            f"{foreign[0]} is there already and not known as a run's; the run would write a file "
            "of that name: move it, or choose another directory"
        )
    discard(directory)
    try:
        note(directory, *own)
        _write(directory, (recipe or {}) | {"run": {"t_end": t_end}, "versions": versions()})
    except BaseException:
        discard(directory)
        raise


def note(directory: str | os.PathLike[str], *files: str | Path) -> None:
    """Note files as the run's own, before they are written: `--overwrite` deletes them.

    Parameters
    ----------
    directory : path
        Of the run.
    *files : path
        Files that are not below it are left out.
    """
    directory = Path(directory)
    root, listing = directory.resolve(), directory / _FILES
    text = listing.read_text(encoding="utf-8") if listing.exists() else ""
    places = (file.parent.resolve() / file.name for file in map(Path, files))
    inside = (place.relative_to(root) for place in places if place.is_relative_to(root))
    known = set(text.splitlines())
    names = [name for name in dict.fromkeys(map(Path.as_posix, inside)) if name not in known]
    if names:
        half = text and not text.endswith("\n")  # a name that a killed process began to write
        start = "\n" if half else "" if text else f"{_HEADER}\n"
        with telling(listing), listing.open("a", encoding="utf-8", newline="\n") as lines:
            lines.write(start + "".join(f"{name}\n" for name in names))


def note_made(directory: str | os.PathLike[str], *files: str | Path) -> None:
    """Note files that are made of a run, if the directory lists the files of one.

    Parameters
    ----------
    directory : path
        Of the run.
    *files : path
        As for `note`.
    """
    if noted(directory):
        note(directory, *files)


def noted(directory: str | os.PathLike[str]) -> list[Path]:
    """Return the files that are noted as the run's own, whether they are there or not.

    Parameters
    ----------
    directory : path
    """
    directory = Path(directory)
    listing = directory / _FILES
    header, *names = listing.read_text("utf-8").splitlines() if listing.is_file() else [""]
    if header != _HEADER:
        return []
    root = directory.resolve()
    paths = [directory / name for name in dict.fromkeys(names) if name]
    return [path for path in paths if path.parent.resolve().is_relative_to(root)]


def discard(directory: str | Path) -> None:
    """Delete the files of a run, halves that a killed process left, and folders left empty.

    Parameters
    ----------
    directory : path
    """
    directory = Path(directory)
    files = noted(directory)
    listing = directory / _FILES
    for path in sorted(files, key=lambda path: path == listing):  # the list goes last
        _delete(temporary_name(path))
        _delete(path)
    folders = {folder for path in files for folder in path.parents}
    for folder in sorted(folders - {directory, *directory.parents}, reverse=True):
        _remove_empty(folder)


def set_aside(path: Path) -> None:
    """Give a damaged file another name, beside it, if it is there at all.

    Parameters
    ----------
    path : Path
    """
    number = 1
    while os.path.lexists(other := path.with_name(f"{path.name}.damaged{number}")):
        number += 1
    if path.exists():
        note(path.parent, other)
        path.rename(other)


def read(directory: str | os.PathLike[str]) -> dict[str, Any]:
    """Return config.toml.

    Parameters
    ----------
    directory : path

    Raises
    ------
    FileNotFoundError
        If the directory holds no run.
    """
    path = Path(directory) / CONFIG
    content = load_toml(path) if path.is_file() else {}
    if "t_end" not in content.get("run", {}) or "versions" not in content:
        raise FileNotFoundError(f"{directory} holds no run: no {CONFIG} with [run] and [versions]")
    return content


def extend(directory: str | Path, t_end: float, files: Iterable[Path]) -> None:
    """Note a new end of a run, and the files that it writes from now on.

    Parameters
    ----------
    directory : path
    t_end : float
    files : iterable of Path
    """
    note(directory, *files)
    content = read(directory)
    if content["run"]["t_end"] != t_end:
        content["run"]["t_end"] = t_end
        _write(Path(directory), content)


def load_toml(path: str | Path) -> dict[str, Any]:
    """Return the contents of a TOML file.

    Parameters
    ----------
    path : path

    Raises
    ------
    ValueError
        If it is no TOML; the message names the file.
    """
    try:
        return tomllib.loads(Path(path).read_text(encoding="utf-8-sig"))
    except ValueError as error:  # not TOML, or not UTF-8
        raise ValueError(f"{path}: {error}") from None


def _missing(directory: Path) -> list[Path]:
    """Return the folders that must be made, outermost first."""
    missing: list[Path] = []
    for folder in (directory, *directory.parents):
        if folder.is_dir():
            return missing[::-1]
        if os.path.lexists(folder):
            raise NotADirectoryError(f"{folder} is not a directory, so no run can be written there")
        missing.append(folder)
    return missing[::-1]


def _delete(path: Path) -> None:
    with suppress(FileNotFoundError, IsADirectoryError, NotADirectoryError):
        path.unlink()


def _remove_empty(folder: Path) -> None:
    with suppress(OSError):  # something is in it
        folder.rmdir()


def _write(directory: Path, content: dict[str, Any]) -> None:
    with replacing(directory / CONFIG) as temporary:
        temporary.write_text(tomli_w.dumps(content), encoding="utf-8")


@cache
def versions() -> dict[str, str]:
    """Return the versions of the packages that compute, and the commit of a working copy."""
    found = {"mrs-treecode": __version__, "python": platform.python_version()}
    found |= {name: _version(name) for name in ("numpy", "numba", "scipy", "h5py")}
    if _git("ls-files", "--error-unmatch", __file__) is not None:
        found["git"] = _git("describe", "--always", "--dirty") or "unknown"
    return found


def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return "unknown"


def _git(*arguments: str) -> str | None:
    """Return the answer of git in this package's folder; None if it refuses or is not there."""
    command = ["git", *arguments]
    try:
        done = subprocess.run(
            command, cwd=Path(__file__).parent, capture_output=True, text=True, check=True
        )
    except (OSError, subprocess.CalledProcessError):
        return None
    return done.stdout.strip()
