"""Error against epsilon

K example 1 with organisms as long as epsilon, as in K table 3, on one thread. `kitc` has theta
0.7, n = 7 and N0 = 2000. E is K eq. (8.1) at 2000 random targets. `kitc` is summed at these
targets only, since its time does not depend on epsilon.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from benchmarks import plots, printed, sums, tables
from benchmarks.experiments.curve import treecode
from benchmarks.methods import FMM, KITC
from benchmarks.rows import Row
from mrs import markdown

measure = sums.one_sum


def cases(quick: bool) -> Iterator[Row]:
    """Yield values of epsilon with backends."""
    for epsilon in printed.K3:
        n = 10_000 if quick else 640_000
        common: Row = {"points": "organisms", "size": n, "epsilon": epsilon}
        yield common | treecode(KITC, 0.7, 7) | {"sampled": True}
        yield common | {"backend": FMM, "tol": 3e-5}


def table(rows: list[Row]) -> Iterator[str]:
    """Yield the lines of a table, a row for each sum."""
    header = "N,epsilon,backend,parameters,E,K: E,seconds"
    return markdown.table(header.split(","), map(_line, rows))


def _line(row: Row) -> list[str]:
    kitc = row["backend"] == KITC
    return [
        f"{row['n']:,}",
        f"{row['epsilon']:g}",
        row["backend"],
        tables.options(row),
        tables.error(row["error"]),
        tables.error(printed.K3[row["epsilon"]]) if kitc and row["n"] == 640_000 else "",
        "" if kitc else tables.seconds(row),
    ]


def plot(rows: list[Row], figure: Any) -> None:
    """Draw E against epsilon."""
    figure.set_size_inches(plots.WIDTH, 4.0)
    axes = figure.subplots()
    for style, backend in enumerate((KITC, FMM)):
        mine = [row for row in rows if row["backend"] == backend]
        if mine:
            label = f"{backend}, {tables.options(mine[0])}"
            plots.line(axes, mine, "epsilon", "error", backend, label, style)
    if rows[0]["n"] == 640_000:
        plots.printed(axes, list(printed.K3), list(printed.K3.values()), KITC, "K table 3")
    axes.set(xscale="log", yscale="log", xlabel="epsilon", ylabel="E")
    axes.set_xticks(list(printed.K3), [f"{epsilon:g}" for epsilon in printed.K3])
    axes.minorticks_off()
    plots.finish(figure)
