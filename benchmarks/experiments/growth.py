"""Time and error against the number of points

K example 1 (epsilon 0.02) on one thread, as in K figure 3 and table 1. `kitc` has theta 0.7 and
N0 = 2000. "K" marks the numbers that the paper prints, for n = 7 and for direct sums. E is K eq.
(8.1) at 2000 random targets. A "~" marks a time scaled up from sampled targets. The building of
the operators of `fmm` is not in its seconds.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import groupby
from typing import Any

from benchmarks import plots, printed, sums, tables
from benchmarks.experiments.curve import treecode
from benchmarks.methods import DIRECT, FMM, KITC
from benchmarks.rows import Row

measure = sums.one_sum

DEGREES = {10_000: printed.DEGREES, 80_000: printed.DEGREES, 640_000: (1, 3, 5, 7), 5_120_000: (7,)}
TOLERANCES = (1e-3, 3e-5)


def cases(quick: bool) -> Iterator[Row]:
    """Yield sizes with backends."""
    for n, degrees in {2_000: (3,), 10_000: (3, 7)}.items() if quick else DEGREES.items():
        common: Row = {"points": "organisms", "size": n, "epsilon": 0.02}
        yield common | {"backend": DIRECT}
        yield from (common | treecode(KITC, 0.7, degree) for degree in degrees)
        yield from (common | {"backend": FMM, "tol": tol} for tol in TOLERANCES[: 2 - quick])


def table(rows: list[Row]) -> Iterator[str]:
    """Yield the lines of a table, a row for each sum."""
    return tables.beside(rows, "K", lambda row: of_paper(row, printed.K1, row["n"]))


def of_paper(row: Row, paper: dict[int, printed.Printed], size: int) -> tables.Printed:
    """Return seconds and error that K prints: of direct sums, and of `kitc` at n = 7."""
    if size in paper and row["backend"] == DIRECT:
        return paper[size].direct, None
    if size in paper and (row["backend"], row.get("degree")) == (KITC, 7):
        return paper[size].treecode, paper[size].error
    return None, None


def plot(rows: list[Row], figure: Any) -> None:
    """Draw error and seconds against N."""
    figure.set_size_inches(plots.WIDTH, 5.0)
    paper = {n: values for n, values in printed.K1.items() if n <= max(row["n"] for row in rows)}
    against_n(rows, figure, paper, "K table 1")


def against_n(rows: list[Row], figure: Any, paper: dict[int, printed.Printed], source: str) -> None:
    """Draw error and seconds against N, with the numbers that a paper prints for each N."""
    errors, seconds = figure.subplots(1, 2)
    sizes, values = list(paper), list(paper.values())
    key = _parameters
    for (backend, parameters), group in groupby(sorted(rows, key=key), key=key):
        mine = list(group)
        label = (
            f"{backend}, {parameters}"
            if parameters
            else f"{backend} (hollow: from sampled targets)"
        )
        style = sorted({key(row) for row in rows if row["backend"] == backend}).index(key(mine[0]))
        plots.line(errors, mine, "n", "error", backend, label, style)
        plots.line(seconds, mine, "n", "seconds", backend, label, style)
    plots.printed(errors, sizes, [value.error for value in values], KITC, f"{source}, n 7")
    plots.printed(seconds, sizes, [value.treecode for value in values], KITC, f"{source}, n 7")
    plots.printed(seconds, sizes, [value.direct for value in values], DIRECT, f"{source}, direct")
    for axes, label in ((errors, "E"), (seconds, "seconds")):
        plots.points_axis(axes, (row["n"] for row in rows))
        axes.set(yscale="log", ylabel=label)
    plots.finish(figure)


def _parameters(row: Row) -> tuple[str, str]:
    return row["backend"], tables.options(row)
