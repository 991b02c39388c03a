"""The log of a run: a table of comma-separated values, a row now and then."""

from __future__ import annotations

import csv
import io
import math
import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from mrs.output.atomic import DamagedError, replacing, telling

_SAME = 1e-12  # of a time: other programs write fewer digits


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
        with path.open(encoding="utf-8-sig") as file:
            columns = next(csv.reader(file))
        if columns != list(row):
            raise ValueError(f"{path} has columns {columns}, got {list(row)}")
    lines.append(list(row.values()))
    with telling(path), path.open("a", encoding="utf-8", newline="") as file:
        file.write(_text(lines))


def times(path: str | os.PathLike[str], column: str = "t") -> list[float]:
    """Return the times of the complete rows.

    Parameters
    ----------
    path : path
        A log, or the place where one will be.
    column : str, optional
        Where the rows have their time.

    Raises
    ------
    DamagedError
        If it is not a log; the message names the line.
    """
    path = Path(path)
    lines = _lines(path)
    if not lines:
        return []
    header, *rows = lines
    if column not in header:
        raise DamagedError(path, f"is no log of a run: its first line has no column {column!r}")
    at = header.index(column)
    found = []
    for number, row in enumerate(rows, 2):
        try:
            found.append(float(row[at]))
        except (IndexError, ValueError):
            reason = f"is damaged: line {number} has no number in column {column!r}"
            raise DamagedError(path, reason) from None
    return found


def cut(path: str | os.PathLike[str], time: float, column: str = "t") -> float | None:
    """Drop the rows later than `time`, and a last one that was not written to its end.

    A table that another program has saved, with a byte-order mark or line ends of its own, is
    brought back to the form that `append` goes on with.

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
        Time of the last row left: `time` itself if that is what its digits mean.

    Raises
    ------
    DamagedError
        If it is not a log.
    """
    path = Path(path)
    if not path.exists():
        return None
    header, *rows = _lines(path) or [[]]
    left = [
        (row, t)
        for row, t in zip(rows, times(path, column), strict=True)
        if t <= time or _same(t, time)
    ]
    text = _text([header, *(row for row, _ in left)]) if header else ""
    if text.encode() != path.read_bytes():
        with replacing(path) as temporary:
            temporary.write_text(text, encoding="utf-8", newline="")
    last = left[-1][1] if left else None
    return time if last is not None and _same(last, time) else last


def last(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Return the last complete row by column; empty if there is none.

    Numbers are numbers again, and None is where nothing was.

    Parameters
    ----------
    path : path
    """
    header, *rows = _lines(Path(path)) or [[]]
    return dict(zip(header, map(_value, rows[-1]), strict=False)) if rows else {}


def _lines(path: Path) -> list[list[str]]:
    """Return the cells of the complete lines; none if there is no file."""
    if not path.exists():
        return []
    try:
        text = path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise DamagedError(path, f"is damaged, or not text in UTF-8 ({error})") from None
    text = text.replace("\r\n", "\n")
    complete = text[: text.rfind("\n") + 1]
    try:
        return [row for row in csv.reader(io.StringIO(complete)) if row]
    except csv.Error as error:
        raise DamagedError(path, f"is damaged ({error})") from None


def _text(lines: list[list[Any]]) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(lines)
    return text.getvalue()


def _same(time: float, other: float) -> bool:
    return math.isclose(time, other, rel_tol=_SAME)


def _value(text: str) -> float | str | None:
    for kind in (int, float):
        with suppress(ValueError):
            return kind(text)
    return text or None
