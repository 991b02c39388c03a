"""One thread and two

The same sum on one thread and on two, in turns. The efficiency is half the ratio of their times,
the median over turns. "Paper" marks the numbers of K tables 4 and 5 and T table 5, on two cores.
A "~" marks a time scaled up from sampled targets.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from benchmarks import plots, printed, sums, tables
from benchmarks.experiments.curve import SINGLE, treecode
from benchmarks.methods import DIRECT, FMM, KITC, TAYLOR
from benchmarks.rows import Row
from mrs import markdown

measure = sums.on_threads


def cases(quick: bool) -> Iterator[Row]:
    """Yield sums."""
    organisms: Row = {"points": "organisms", "size": 10_000 if quick else 640_000, "epsilon": 0.02}
    rods: Row = {"points": "rods", "size": 8 if quick else 80}
    cube: Row = {"points": "cube", "size": 10_000 if quick else 1_000_000}
    yield organisms | {"backend": DIRECT}
    yield organisms | treecode(KITC, 0.7, 7)
    yield organisms | treecode(KITC, 0.7, 7) | SINGLE
    yield organisms | treecode(KITC, 0.62, 6) | SINGLE  # E below the 3.17e-5 of K
    yield organisms | {"backend": FMM, "tol": 1e-3}
    if not quick:
        yield organisms | {"backend": FMM, "tol": 3e-5}
        yield rods | {"backend": DIRECT}
        yield rods | treecode(KITC, 0.7, 7, 1000)
        yield rods | {"backend": FMM, "tol": 1e-4}
    yield cube | treecode(TAYLOR, 0.5, 6)
    yield cube | treecode(TAYLOR, 0.5, 6) | SINGLE


def table(rows: list[Row]) -> Iterator[str]:
    """Yield the lines of a table, a row for each sum."""
    header = (
        f"{tables.CASE},E,1 thread (s),2 threads (s),times as fast,efficiency (%),"
        "paper: 1 core (s),paper: 2 cores (s),paper: efficiency (%)"
    )
    return markdown.table(header.split(","), map(_line, rows))


def _line(row: Row) -> list[str]:
    one, two = _paper(row)
    return [
        *tables.case(row),
        tables.error(row["error"]),
        tables.seconds(row),
        tables.seconds(row, "seconds2"),
        f"{2.0 * row['efficiency']:.2f}",
        f"{100 * row['efficiency']:.0f}",
        tables.figure(one),
        tables.figure(two),
        f"{100 * one / two / 2:.0f}" if one and two else "",
    ]


def _paper(row: Row) -> tuple[float | None, float | None]:
    """Return the seconds printed for one core and for two."""
    seconds = printed.strong(row["points"], row["size"], row["backend"])
    return seconds.get(1), seconds.get(2)


def plot(rows: list[Row], figure: Any) -> None:
    """Draw a bar for the efficiency of each sum."""
    figure.set_size_inches(plots.WIDTH, 1.5 + 0.35 * len(rows))
    axes = figure.subplots()
    theirs: dict[str, list[tuple[float, int]]] = {}
    for i, row in enumerate(rows):
        axes.barh(i, 100 * row["efficiency"], color=plots.COLORS[row["backend"]])
        one, two = _paper(row)
        if one and two:
            theirs.setdefault(row["backend"], []).append((50 * one / two, i))
    for values in theirs.values():
        efficiencies, places = (list(value) for value in zip(*values, strict=True))
        axes.plot(efficiencies, places, color="0.3", label="papers, 2 cores", **plots.PAPERS)
    names = [f"{row['points']}, {row['backend']} {tables.options(row)}" for row in rows]
    axes.set_yticks(range(len(rows)), names)
    axes.invert_yaxis()
    axes.set(xlabel="parallel efficiency on two threads (%)", xlim=(0, 110))
    plots.finish(figure)
