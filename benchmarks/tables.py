"""Cells of the tables in Markdown."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from benchmarks.methods import FMM, TAYLOR
from benchmarks.rows import Row
from mrs import markdown

CASE = "points,N,backend,parameters"
Printed = tuple[float | None, float | None]
"""Seconds and error, None where a paper prints none."""


def figure(value: Any, digits: int = 3) -> str:
    """Return a number with so many significant digits, "" for None."""
    if value is None:
        return ""
    return f"{value:,.0f}" if abs(value) >= 10 ** (digits - 1) else f"{value:.{digits}g}"


def error(value: float | None) -> str:
    """Return an error as the papers print it, "" for None."""
    return "" if value is None else f"{value:.2e}"


def seconds(row: Row, key: str = "seconds") -> str:
    """Return a time, marked with ~ if it was extrapolated from fewer targets."""
    return ("~" if row["extrapolated"] else "") + figure(row[key])


def build(row: Row) -> str:
    """Return the seconds in which operators were built, "" where there are none."""
    return figure(row["build"]) if row["backend"] == FMM else ""


def ratio(printed: float | None, ours: float) -> str:
    """Return how many times ours goes into the printed value."""
    return "" if printed is None else figure(printed / ours, 2)


def options(row: Row) -> str:
    """Return the parameters of a backend."""
    names = {"theta": "theta", "degree": "p" if row["backend"] == TAYLOR else "n", "tol": "tol"}
    parts = [f"{short} {row[name]:g}" for name, short in names.items() if name in row]
    if "tol" not in row and row.get("precision") == "float32":  # else the tolerance decides
        parts.append("float32")
    return ", ".join(parts)


def case(row: Row) -> list[str]:
    """Return the points and the method of a sum: the columns `CASE`."""
    return [row["points"], f"{row['n']:,}", row["backend"], options(row)]


def beside(rows: list[Row], name: str, paper: Callable[[Row], Printed]) -> Iterator[str]:
    """Yield the lines of a table of sums beside the numbers that a paper prints for them."""

    def line(row: Row) -> list[str]:
        theirs, their_error = paper(row)
        return [
            *case(row),
            error(row["error"]),
            error(their_error),
            build(row),
            seconds(row),
            figure(theirs),
            ratio(theirs, row["seconds"]),
        ]

    header = f"{CASE},E,*: E,build (s),seconds,*: seconds,* / ours"
    return markdown.table(header.replace("*", name).split(","), map(line, rows))
