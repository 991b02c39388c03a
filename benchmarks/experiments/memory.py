"""Memory

The most memory that NumPy holds at one time, from points to values. The caller's arrays, the
result and the operators of `fmm` are included. The memory of compiled code is not, some 100 KiB a
thread. K example 1 is as in K table 2 (theta 0.7, N0 = 2000), sphere and cube as in T tables 2
and 4 (theta 0.5, N0 = 2000). "Paper" marks the numbers that the papers print. The memory of a
direct sum is scaled up from 10,000 points.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import groupby
from typing import Any

from benchmarks import plots, printed, sums, tables
from benchmarks.experiments.curve import treecode
from benchmarks.methods import DIRECT, FMM, KITC, TAYLOR
from benchmarks.rows import Row
from mrs import markdown

measure = sums.peak_memory

DEGREES = {10_000: printed.DEGREES, 80_000: printed.DEGREES, 640_000: (1, 5, 9)}
ORDERS = {("sphere", 5): (2, 6, 10), ("sphere", 6): (2, 6, 10), ("sphere", 7): (6,),
          ("cube", 125_000): (2, 6, 10), ("cube", 1_000_000): (6,)}  # fmt: skip


def cases(quick: bool) -> Iterator[Row]:
    """Yield point sets with backends."""
    for n, degrees in {2_000: (1, 3), 10_000: (1, 3)}.items() if quick else DEGREES.items():
        common: Row = {"points": "organisms", "size": n, "epsilon": 0.02}
        yield common | {"backend": DIRECT}
        yield from (common | treecode(KITC, 0.7, degree) for degree in degrees)
        yield common | {"backend": FMM, "tol": 1e-3}
    for (points, size), orders in ORDERS.items() if not quick else ():
        common = {"points": points, "size": size}
        yield common | {"backend": DIRECT}
        yield from (common | treecode(TAYLOR, 0.5, order) for order in orders)


def table(rows: list[Row]) -> Iterator[str]:
    """Yield the lines of a table, a row for each sum."""
    header = f"{tables.CASE},MB,of direct,paper: MB,paper: of direct"
    return markdown.table(header.split(","), (_line(row, rows) for row in rows))


def _line(row: Row, rows: list[Row]) -> list[str]:
    direct = [r["bytes"] for r in rows if r["n"] == row["n"] and r["backend"] == DIRECT]
    theirs, base = _paper(row)
    return [
        *tables.case(row),
        ("~" if row["extrapolated"] else "") + tables.figure(row["bytes"] / 1e6),
        f"{row['bytes'] / direct[0]:.2f}" if direct else "",
        tables.figure(theirs),
        f"{theirs / base:.2f}" if theirs and base else "",
    ]


def _paper(row: Row) -> tuple[float | None, float | None]:
    """Return the megabytes printed for a row, and for its direct sum."""
    organisms = row["points"] == "organisms"
    direct, values = (printed.K2 if organisms else printed.T_MEMORY).get(row["size"], (None, ()))
    if row["backend"] == DIRECT:
        return direct, direct
    parameters = printed.DEGREES if organisms else printed.ORDERS
    if row["backend"] == FMM or not values:
        return None, None
    return values[parameters.index(row["degree"])], direct


def plot(rows: list[Row], figure: Any) -> None:
    """Draw bytes a point against N, a panel for each point set."""
    names = list(dict.fromkeys(row["points"] for row in rows))
    figure.set_size_inches(plots.WIDTH, 5.0)
    key = _parameters
    styles = sorted({key(row) for row in rows})
    panels = figure.subplots(1, len(names), squeeze=False, sharey=True)[0]
    for axes, points in zip(panels, names, strict=True):
        mine = [row for row in rows if row["points"] == points]
        for (backend, parameters), group in groupby(sorted(mine, key=key), key=key):
            line = [row | {"each": row["bytes"] / row["n"]} for row in group]
            style = styles.index((backend, parameters))
            plots.line(axes, line, "n", "each", backend, f"{backend} {parameters}", style)
        for backend in (DIRECT, KITC, TAYLOR):
            theirs = [(row["n"], _paper(row)[0]) for row in mine if row["backend"] == backend]
            both = [(n, 1e6 * value / n) for n, value in theirs if value]
            sizes, each = (list(values) for values in zip(*both, strict=True)) if both else ([], [])
            plots.printed(axes, sizes, each, backend, f"papers, {backend}")
        plots.points_axis(axes, (row["n"] for row in mine))
        axes.set(title=points)
    panels[0].set(yscale="log", ylabel="bytes a point")
    plots.finish(figure)


def _parameters(row: Row) -> tuple[str, str]:
    return row["backend"], tables.options(row)
