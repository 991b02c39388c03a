"""Sets that are not uniform

Regularized Stokeslets with random forces at 300,000 points, epsilon a thousandth of the width, on
one thread. The last column is the time for a point beside that in a cube. E is K eq. (8.1) at
2000 random targets.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import groupby
from typing import Any

from benchmarks import plots, sums, tables
from benchmarks.experiments.curve import treecode
from benchmarks.methods import FMM, KITC
from benchmarks.point_sets import UNEVEN
from benchmarks.rows import Row
from mrs import markdown

measure = sums.one_sum


def cases(quick: bool) -> Iterator[Row]:
    """Yield sets with backends."""
    for name in UNEVEN:
        common: Row = {"points": name, "size": 5_000 if quick else 300_000}
        yield common | treecode(KITC, 0.7, 3)
        yield common | {"backend": FMM, "tol": 1e-3}


def table(rows: list[Row]) -> Iterator[str]:
    """Yield the lines of a table, a row for each sum."""
    header = f"{tables.CASE},E,build (s),seconds,a point beside the cube"
    return markdown.table(header.split(","), (_line(row, rows) for row in rows))


def _line(row: Row, rows: list[Row]) -> list[str]:
    return [
        *tables.case(row),
        tables.error(row["error"]),
        tables.build(row),
        tables.seconds(row),
        tables.figure(beside_cube(row, rows)),
    ]


def beside_cube(row: Row, rows: list[Row]) -> float | None:
    """Return the seconds of a point in units of those in the cube, by the same backend."""
    cube = [r for r in rows if r["points"] == UNEVEN[0] and r["backend"] == row["backend"]]
    return row["seconds"] / row["n"] / (cube[0]["seconds"] / cube[0]["n"]) if cube else None


def plot(rows: list[Row], figure: Any) -> None:
    """Draw a bar for each sum."""
    figure.set_size_inches(plots.WIDTH, 3.5)
    axes = figure.subplots()
    key = _backend
    for i, (backend, group) in enumerate(groupby(sorted(rows, key=key), key=key)):
        mine = {row["points"]: 1e6 * row["seconds"] / row["n"] for row in group}
        places = [UNEVEN.index(name) + 0.38 * (0.5 - i) for name in mine]
        axes.barh(places, list(mine.values()), 0.36, color=plots.COLORS[backend], label=backend)
    axes.set_yticks(range(len(UNEVEN)), UNEVEN)
    axes.invert_yaxis()
    axes.set(xlabel="microseconds a point")
    plots.finish(figure)


def _backend(row: Row) -> str:
    return str(row["backend"])
