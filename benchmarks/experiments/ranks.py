"""One rank and two

The same sum on one rank of MPI and on two, of one thread each, in turns. The ranks share the
targets, as in algorithm 2 of T. The efficiency is half the ratio of their times, the median over
turns. "Waiting" is the time until the other rank is done, "communication" the exchange of values,
both in parts of the time of rank 0. "Paper" marks the numbers of T table 5, on two processes.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from benchmarks import plots, tables
from benchmarks.experiments.curve import treecode
from benchmarks.methods import FMM, KITC, TAYLOR
from benchmarks.on_ranks import on_ranks
from benchmarks.rows import Row
from mrs import markdown

measure = on_ranks

PAPER = {TAYLOR: 336.6 / 176.3 / 2.0}  # T table 5, a million points


def cases(quick: bool) -> Iterator[Row]:
    """Yield sums."""
    common: Row = {"ranks": 2, "size": 10_000 if quick else 80_000}
    organisms: Row = common | {"points": "organisms", "epsilon": 0.02}
    yield common | {"points": "cube"} | treecode(TAYLOR, 0.5, 6)
    yield organisms | treecode(KITC, 0.7, 7)
    yield organisms | {"backend": FMM, "tol": 1e-3}
    if not quick:
        yield organisms | {"backend": FMM, "tol": 3e-5}


def table(rows: list[Row]) -> Iterator[str]:
    """Yield the lines of a table, a row for each sum."""
    header = (
        f"{tables.CASE},E,1 rank (s),2 ranks (s),efficiency (%),paper: efficiency (%),"
        "waiting (%),communication (%),MB received"
    )
    return markdown.table(header.split(","), map(_line, rows))


def _line(row: Row) -> list[str]:
    theirs = PAPER.get(row["backend"])
    return [
        *tables.case(row),
        tables.error(row["error"]),
        tables.seconds(row),
        tables.seconds(row, "seconds2"),
        f"{100 * row['efficiency']:.0f}",
        f"{100 * theirs:.0f}" if theirs else "",
        f"{100 * row['waiting']:.1f}",
        f"{100 * row['communication']:.1f}",
        f"{row['received'] / 1e6:.2f}",
    ]


def plot(rows: list[Row], figure: Any) -> None:
    """Draw a bar for the efficiency of each sum."""
    figure.set_size_inches(plots.WIDTH, 1.5 + 0.35 * len(rows))
    axes = figure.subplots()
    for i, row in enumerate(rows):
        axes.barh(i, 100 * row["efficiency"], color=plots.COLORS[row["backend"]])
    names = [f"{row['points']}, {row['backend']} {tables.options(row)}" for row in rows]
    axes.set_yticks(range(len(rows)), names)
    axes.invert_yaxis()
    axes.set(xlabel="parallel efficiency on two ranks (%)", xlim=(0, 110))
    plots.finish(figure)
