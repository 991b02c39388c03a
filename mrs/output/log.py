"""The log of a run: a table of comma-separated values, a row now and then."""

from __future__ import annotations

import csv
import io
import math
import os
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mrs.output.atomic import DamagedError, replacing, telling
from mrs.output.frame_files import FrameFile
from mrs.time.interrupts import Interval

if TYPE_CHECKING:
    from mrs.run.simulation import Simulation

_TIME = "t"  # the column with the times of the rows
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
        If the columns differ from the header.
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


def times(path: str | os.PathLike[str]) -> list[float]:
    """Return the times of the complete rows.

    Parameters
    ----------
    path : path
        A log, or the place where one will be.

    Raises
    ------
    DamagedError
        If it is not a log; the message names the line.
    """
    path = Path(path)
    return _times(path, complete_lines(path))


def _times(path: Path, lines: list[list[str]]) -> list[float]:
    """Return the times of the rows, given the cells of the complete lines."""
    if not lines:
        return []
    header, *rows = lines
    if _TIME not in header:
        raise DamagedError(path, f"is no log of a run: its first line has no column {_TIME!r}")
    at = header.index(_TIME)
    found = []
    for number, row in enumerate(rows, 2):
        try:
            found.append(float(row[at]))
        except (IndexError, ValueError):
            reason = f"is damaged: line {number} has no number in column {_TIME!r}"
            raise DamagedError(path, reason) from None
    return found


def cut(path: str | os.PathLike[str], time: float) -> float | None:
    """Drop the rows later than `time`, and a last one that was not written to its end.

    A table that another program has saved, with a byte-order mark or line ends of its own, is
    brought back to the form that `append` goes on with.

    Parameters
    ----------
    path : path
        A log, or the place where one will be.
    time : float
        Of the state that the run goes on from.

    Returns
    -------
    float or None
        Time of the last row left: `time` itself if the digits of the row stand for it.

    Raises
    ------
    DamagedError
        If it is not a log.
    """
    path = Path(path)
    if not path.exists():
        return None
    lines = complete_lines(path)
    header, *rows = lines or [[]]
    pairs = zip(rows, _times(path, lines), strict=True)
    left = [(row, t) for row, t in pairs if t <= time or _same(t, time)]
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
    header, *rows = complete_lines(Path(path)) or [[]]
    return dict(zip(header, map(_value, rows[-1]), strict=False)) if rows else {}


def complete_lines(path: Path) -> list[list[str]]:
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


def _sampled_error(sim: Simulation) -> float:
    """Return the error of the sums at points drawn at random: it costs a sum and direct ones."""
    return sim.scene.sampled_error(sim.time, sim.state)


def _max_speed(sim: Simulation) -> float:
    return float(np.linalg.norm(sim.now.motion[:, :3], axis=1).max(initial=0.0))


COLUMNS: dict[str, Callable[[Simulation], Any]] = {
    "step": lambda sim: sim.stepper.steps,
    "t": lambda sim: sim.time,
    "dt": lambda sim: sim.stepper.taken,
    "wall": lambda sim: round(sim.moment.seconds, 3),
    "rejections": lambda sim: sim.stepper.rejections,
    "evaluations": lambda sim: sim.scene.evaluations,
    "max_speed": _max_speed,
    "elastic_energy": lambda sim: sim.energy(),
    "sampled_error": _sampled_error,
    "dt_lambda_max": lambda sim: sim.stepper.h_lambda,
    "backends": lambda sim: " ".join(map(str, sim.scene.choices)),
}
_OF_GIVEN = {"iterations": lambda sim: sim.scene.resistance.memory.iterations}
_EVERY = {"sampled_error": 10}  # rows that have a value in a column; others have one in each row


class LogFile(FrameFile):
    """log.csv: how the run is doing.

    Parameters
    ----------
    path : Path
    when : Interval
        Between the rows.
    columns : dict of functions
        The user's own, besides `COLUMNS`. A function with `labels` fills a column for each.
    given : bool, optional
        Whether the motion of some points is given: then there is a column "iterations".
    """

    def __init__(
        self,
        path: Path,
        when: Interval,
        columns: Mapping[str, Callable[[Simulation], Any]],
        given: bool = False,
    ) -> None:
        super().__init__(path)
        self.when, self.columns = when, {**COLUMNS, **(_OF_GIVEN if given else {}), **columns}
        self._headings = [head for item in self.columns.items() for head in _headings(*item)]
        twice = {head for head in self._headings if self._headings.count(head) > 1}
        if twice:
            raise ValueError(f"columns must have different headings, got twice {sorted(twice)}")

    def times(self, sim: Simulation) -> list[float]:
        lines = complete_lines(self.path)
        found = _times(self.path, lines)
        if found and lines[0] != self._headings:
            has, wanted = ", ".join(lines[0]), ", ".join(self._headings)
            raise DamagedError(self.path, f"has the columns {has}, not {wanted}")
        return found

    def cut(self, sim: Simulation) -> float | None:
        return cut(self.path, sim.time)

    def write(self, sim: Simulation) -> None:
        number = self.when.count(sim.time)
        row: dict[str, Any] = {}
        for name, column in self.columns.items():
            row |= {name: ""} if number % _EVERY.get(name, 1) else _cells(name, column, sim)
        append(self.path, row)


def _headings(name: str, column: Callable[[Simulation], Any]) -> list[str]:
    if not hasattr(column, "labels"):
        return [name]
    return [f"{name}[{label}]" for label in column.labels]


def _cells(name: str, column: Callable[[Simulation], Any], sim: Simulation) -> dict[str, Any]:
    """Return what a function puts into a row, by heading."""
    value = column(sim)
    if not hasattr(column, "labels"):
        return {name: _cell(name, value)}
    headings = _headings(name, column)
    if np.shape(value) != (len(headings),):
        raise ValueError(
            f"columns[{name!r}] must give {len(headings)} numbers, one a label, got {value!r}"
        )
    return {heading: _cell(heading, one) for heading, one in zip(headings, value, strict=True)}


def _cell(name: str, value: Any) -> Any:
    """Return the value of a column if a row can hold it."""
    if isinstance(value, np.generic):
        value = value.item()
    if not isinstance(value, (bool, int, float, str)):
        raise TypeError(f"columns[{name!r}] must give a number or a text, got {value!r}")
    return value
