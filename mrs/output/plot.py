"""Columns of the log as curves over time."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from mrs import check
from mrs.output import run_directory
from mrs.output.atomic import replacing
from mrs.output.log_table import LogTable

COLUMNS = ("elastic_energy", "max_speed", "dt")
SUFFIXES = (".png", ".svg", ".pdf")
_TIME = "t"


def plot(
    directory: str | os.PathLike[str],
    destination: str | os.PathLike[str],
    columns: Sequence[str] = COLUMNS,
) -> Path:
    """Draw columns of the log over time, one above the other.

    Parameters
    ----------
    directory : path
        Of the run, which may still go on.
    destination : path
        A .png, .svg or .pdf. It appears when it is complete.
    columns : sequence of str, optional
        Names of columns of numbers.

    Returns
    -------
    Path
        The destination.

    Raises
    ------
    FileNotFoundError
        If the directory has no log with rows.
    ValueError
        If the suffix does not fit, or there is no such column of numbers.
    """
    from matplotlib.figure import Figure

    destination = Path(destination)
    if destination.suffix not in SUFFIXES:
        raise ValueError(f"destination must end in {', '.join(SUFFIXES)}, got {destination}")
    log = LogTable(Path(directory) / "log.csv")
    if not log or not len(log[_TIME]):
        raise FileNotFoundError(f"{directory} has no log.csv with rows")
    numbers = [name for name, values in log.items() if values.dtype.kind in "if"]
    for name in columns:
        check.one_of("columns", name, numbers)
    figure = Figure(figsize=(7.0, 0.6 + 1.8 * len(columns)), layout="constrained")
    places = figure.subplots(len(columns), sharex=True, squeeze=False)[:, 0]
    for place, name in zip(places, columns, strict=True):
        known = np.isfinite(log[name])  # some columns have a value in few rows only
        place.plot(log[_TIME][known], log[name][known], marker=".")
        place.set_ylabel(name.replace("_", " "))
    places[-1].set_xlabel(_TIME)
    destination.parent.mkdir(parents=True, exist_ok=True)
    run_directory.note_made(directory, destination)
    with replacing(destination) as temporary:
        figure.savefig(temporary, dpi=150)
    return destination
