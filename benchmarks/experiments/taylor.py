"""Singular Stokeslets and stresslets: sphere and cube

T table 1 has Stokeslets and stresslets on the unit sphere (strengths f, h, nu). T table 3 has
Stokeslets in a cube of number density 2500. `taylor` has N0 = 2000, and `fmm` stands beside it,
both on one thread. "T" marks the numbers that the paper prints. Its seconds are the seconds of its
direct sum over the ratio that it prints. E is K eq. (8.1) at 2000 random targets. A "~" marks a
time scaled up from sampled targets. The building of the operators of `fmm` is not in its seconds.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import groupby
from typing import Any

from benchmarks import plots, printed, sums, tables
from benchmarks.experiments import curve
from benchmarks.methods import DIRECT, FMM, TAYLOR
from benchmarks.rows import Row

measure = sums.one_sum

EVERY, SOME = printed.ORDERS, (2, 6, 10)
SETS: dict[tuple[str, int], dict[float, tuple[int, ...]]] = {
    ("sphere", 6): {0.2: SOME, 0.5: EVERY, 0.8: EVERY},
    ("sphere", 7): {0.5: (2, 6), 0.8: (2, 6)},
    ("cube", 125_000): {0.2: SOME, 0.5: EVERY, 0.8: EVERY},
    ("cube", 1_000_000): {0.5: (6,), 0.8: (2, 6, 10)},
}
QUICK: dict[tuple[str, int], dict[float, tuple[int, ...]]] = {
    ("sphere", 4): {0.5: (2, 6), 0.8: (2, 6)},
    ("cube", 8_000): {0.5: (2, 6)},
}
TOLERANCES = {"sphere": (1e-2, 1e-3, 1e-4), "cube": (1e-3, 1e-5, 1e-7)}


def cases(quick: bool) -> Iterator[Row]:
    """Yield point sets with backends."""
    for (points, size), grid in (QUICK if quick else SETS).items():
        common: Row = {"points": points, "size": size}
        yield common | {"backend": DIRECT}
        for theta, orders in grid.items():
            yield from (common | curve.treecode(TAYLOR, theta, order) for order in orders)
        if points == "cube" and not quick:
            yield common | curve.treecode(TAYLOR, 0.5, 6) | curve.SINGLE
        if not quick:
            yield from (common | {"backend": FMM, "tol": tol} for tol in TOLERANCES[points])


def table(rows: list[Row]) -> Iterator[str]:
    """Yield the lines of a table, a row for each sum."""
    return tables.beside(rows, "T", _paper)


def _paper(row: Row) -> tables.Printed:
    """Return the seconds and the error that T prints for a row."""
    if row["backend"] == TAYLOR:
        return printed.taylor(row["size"], row["theta"], row["degree"])
    return printed.T_DIRECT.get(row["size"]) if row["backend"] == DIRECT else None, None


def plot(rows: list[Row], figure: Any) -> None:
    """Draw seconds against error, a panel for each point set."""
    key = _point_set
    groups = [(names, list(group)) for names, group in groupby(rows, key=key)]
    height = -(-len(groups) // 2)
    figure.set_size_inches(plots.WIDTH, 1.5 + 4.0 * height)
    panels = figure.subplots(height, 2, squeeze=False).ravel()
    for axes, ((points, n), same) in zip(panels, groups, strict=False):
        curve.draw(axes, same)
        figures = [(*_paper(row), row["backend"]) for row in same]
        both = [(e, s) for s, e, backend in figures if s and e and backend == TAYLOR]
        errors, seconds = (list(values) for values in zip(*both, strict=True)) if both else ([], [])
        plots.printed(axes, errors, seconds, TAYLOR, "T (taylor)")
        for s, _, backend in figures:
            if s and backend == DIRECT:
                axes.axhline(s, color="0.5", linestyle=":", linewidth=1, label="T (direct)")
        title = f"{points}, N = {n:,}"
        axes.set(xscale="log", yscale="log", title=title, xlabel="E", ylabel="seconds")
    for axes in panels[len(groups) :]:
        axes.remove()
    plots.finish(figure)


def _point_set(row: Row) -> tuple[str, int]:
    return row["points"], row["n"]
