"""Arrays of rods

K example 2: helical rods of 151 points, with forces and torques in, velocities and angular
velocities out, epsilon 0.3, on one thread. `kitc` has theta 0.7 and N0 = 1000 as in K figure 5.
"K" marks the numbers of K table 5. E is K eq. (8.1) at 2000 random targets. A "~" marks a time
scaled up from sampled targets. The building of the operators of `fmm` is not in its seconds.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from benchmarks import plots, point_sets, printed, sums, tables
from benchmarks.experiments import growth
from benchmarks.experiments.curve import treecode
from benchmarks.methods import DIRECT, FMM, KITC
from benchmarks.rows import Row

measure = sums.one_sum

DEGREES = {15: (1, 3, 5, 7, 9), 20: (1, 3, 5, 7, 9), 30: (1, 3, 5, 7), 40: (7,), 60: (7,), 80: (7,)}
TOLERANCE = 1e-4


def cases(quick: bool) -> Iterator[Row]:
    """Yield rods on a side with backends."""
    for side, degrees in {4: (3,), 8: (3,)}.items() if quick else DEGREES.items():
        common: Row = {"points": "rods", "size": side}
        yield common | {"backend": DIRECT}
        yield from (common | treecode(KITC, 0.7, degree, 1000) for degree in degrees)
        yield common | {"backend": FMM, "tol": TOLERANCE}


def table(rows: list[Row]) -> Iterator[str]:
    """Yield the lines of a table, a row for each sum."""
    return tables.beside(rows, "K", lambda row: growth.of_paper(row, printed.K5, row["size"]))


def plot(rows: list[Row], figure: Any) -> None:
    """Draw error and seconds against N."""
    figure.set_size_inches(plots.WIDTH, 5.0)
    sides = {row["size"] for row in rows}
    paper = {
        point_sets.ROD_POINTS * side**2: values
        for side, values in printed.K5.items()
        if side in sides
    }
    growth.against_n(rows, figure, paper, "K table 5")
