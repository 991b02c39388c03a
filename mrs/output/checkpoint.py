"""Checkpoints: the whole state in one file, exact to the bit, and the one before beside it."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import warnings
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np

from mrs.output.atomic import DamagedError, replacing, sync
from mrs.output.hdf5 import File
from mrs.output.trackers import Tracker
from mrs.time.interrupts import WallTime

if TYPE_CHECKING:
    from mrs.run.simulation import Simulation


def save(
    path: str | os.PathLike[str],
    arrays: Mapping[str, np.ndarray],
    attributes: Mapping[str, Any],
) -> None:
    """Write a checkpoint; the last one becomes ``<stem>.previous.h5``, if it is intact.

    Parameters
    ----------
    path : path
        For example ``checkpoint.h5``.
    arrays : dict of ndarray
        Numbers of any type and shape. A name like "integrator/vector" makes a group.
    attributes : dict
        All that JSON can hold, in dicts and lists, and integers of any size such as those in the
        state of a random generator. Tuples come back as lists, and so do arrays in it.
    """
    path = Path(path)
    content = {name: np.asarray(array) for name, array in arrays.items()}
    text = json.dumps(attributes, default=_plain)
    with replacing(path) as temporary:
        with File(temporary, "w") as file:
            file["attributes"] = text
            file.attrs["sha256"] = _digest(content, text)
            group = file.create_group("arrays")
            for name, array in content.items():
                group[name] = array
        if _is_intact(path):  # a damaged one must not take the place of a good one before it
            with replacing(previous(path)) as spare:
                shutil.copyfile(path, spare)


def load(path: str | os.PathLike[str]) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Return arrays and attributes as given to `save`.

    Warns if the newest checkpoint is missing or damaged and the one before it is read.

    Parameters
    ----------
    path : path
        As given to `save`.

    Returns
    -------
    arrays : dict of ndarray
    attributes : dict

    Raises
    ------
    FileNotFoundError
        If there is no checkpoint.
    ValueError
        If there are checkpoints but none is intact.
    """
    path = Path(path)
    problems = []
    for candidate in (path, previous(path)):
        try:
            content = _read(candidate)
        except FileNotFoundError:
            problems.append(f"{candidate} is missing")
        except DamagedError as error:
            problems.append(str(error))
        except (OSError, KeyError, ValueError, RuntimeError) as error:
            problems.append(f"{candidate} is damaged ({error})")
        else:
            if problems:
                warnings.warn(f"{problems[0]}; reading {candidate}", stacklevel=2)
            return content
    if path.exists() or previous(path).exists():
        raise ValueError(f"no intact checkpoint: {'; '.join(problems)}")
    raise FileNotFoundError(f"no checkpoint {path}")


def previous(path: Path) -> Path:
    """Return the name of the checkpoint before the last one.

    Parameters
    ----------
    path : Path
        Of the last one.
    """
    return path.with_suffix(f".previous{path.suffix}")


def _is_intact(path: Path) -> bool:
    try:
        _read(path)
    except (OSError, KeyError, ValueError, RuntimeError):
        return False
    return True


def _read(path: Path) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    with File(path, "r") as file:
        text = file["attributes"][()].decode()
        arrays: dict[str, np.ndarray] = {}

        def collect(name: str, item: h5py.Dataset | h5py.Group) -> None:
            if isinstance(item, h5py.Dataset):
                arrays[name] = item[()] if item.shape else np.asarray(item[()])

        file["arrays"].visititems(collect)
        if file.attrs["sha256"] != _digest(arrays, text):
            raise ValueError("its checksum is wrong")
    return arrays, json.loads(text)


def _digest(arrays: Mapping[str, np.ndarray], text: str) -> str:
    digest = hashlib.sha256(text.encode())
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        digest.update(f"{name} {array.dtype.str} {arrays[name].shape}".encode())
        digest.update(array.data)
    return digest.hexdigest()


def _plain(value: Any) -> Any:
    if isinstance(value, (np.generic, np.ndarray)):
        return value.tolist()
    raise TypeError(f"a checkpoint cannot hold {value!r} among its attributes")


class Checkpoints(Tracker):
    """Saves the simulation every so many seconds of real time, and at the end.

    Parameters
    ----------
    path : Path
        For example ``checkpoint.h5``.
    seconds : float
    """

    def __init__(self, path: Path, seconds: float) -> None:
        self.path, self.when = path, WallTime(seconds)
        self._saved: float | None = None

    def initialize(self, sim: Simulation) -> None:
        self._saved = None
        if not sim.resumed:
            self._save(sim)

    def output_files(self, sim: Simulation) -> list[Path]:
        return [self.path, previous(self.path)]

    def handle(self, sim: Simulation) -> None:
        if sim.time < sim.t_end:  # the one of the end knows the last frames
            self._save(sim)

    def finalize(self, sim: Simulation) -> None:
        if self._saved != sim.time:
            self._save(sim)

    def _save(self, sim: Simulation) -> None:
        for name in sim.written:  # a power cut must not keep the checkpoint, and not their frames
            with suppress(FileNotFoundError):
                sync(self.path.parent / name)
        save(self.path, *sim.snapshot())
        self._saved = sim.time
