"""The log of a run: a table of comma-separated values, a row now and then."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from mrs.output.atomic import replacing


def append(path: str | os.PathLike[str], row: Mapping[str, Any]) -> None:
    """Add a row; the first one writes the header as well.

    Parameters
    ----------
    path : path
        For example ``log.csv``.
    row : dict
        Values by column, the same columns every time. Floats are written with all their digits.

    Raises
    ------
    ValueError
        If the columns are not those of the header.
    """
    path = Path(path)
    lines = [] if path.exists() and path.stat().st_size else [list(row)]
    if not lines:
        with path.open(encoding="utf-8") as file:
            columns = next(csv.reader(file))
        if columns != list(row):
            raise ValueError(f"{path} has columns {columns}, got {list(row)}")
    lines.append(list(row.values()))
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(lines)
    with path.open("a", encoding="utf-8", newline="") as file:
        file.write(text.getvalue())


def cut(path: str | os.PathLike[str], time: float, column: str = "t") -> float | None:
    """Drop the rows later than `time`, and a last one that was not written to its end.

    Parameters
    ----------
    path : path
        A log, or the place where one will be.
    time : float
        Of the state that the run goes on from.
    column : str, optional
        Where the rows have their time.

    Returns
    -------
    float or None
        Time of the last row left.
    """
    path = Path(path)
    text = path.read_text(encoding="utf-8") if path.exists() else ""
    lines = text[: text.rfind("\n") + 1].splitlines(keepends=True)
    header, *rows = [line for line in lines if line.strip()] or [""]
    at = next(csv.reader([header])).index(column) if header else 0
    times = [float(next(csv.reader([row]))[at]) for row in rows]
    left = [(t, row) for t, row in zip(times, rows, strict=True) if t <= time]
    shorter = header + "".join(row for _, row in left)
    if shorter != text:
        with replacing(path) as temporary:
            temporary.write_text(shorter, encoding="utf-8")
    return left[-1][0] if left else None


def last(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Return the last complete row by column; empty if there is none.

    Numbers are numbers again, and None is where nothing was.

    Parameters
    ----------
    path : path
    """
    path = Path(path)
    text = path.read_text(encoding="utf-8") if path.exists() else ""
    rows = list(csv.DictReader(text[: text.rfind("\n") + 1].splitlines()))
    return {name: _value(text) for name, text in rows[-1].items()} if rows else {}


def _value(text: str) -> Any:
    for kind in (int, float):
        with suppress(ValueError):
            return kind(text)
    return text or None
