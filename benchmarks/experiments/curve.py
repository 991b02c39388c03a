"""Run time against error

K example 1 (organisms in a cube, epsilon 0.02) on one thread, as in K figure 2. Seconds go from
points to values. The building of the operators of `fmm` stands apart; it is done once for a
kernel, a box and a tolerance. E is K eq. (8.1) at 2000 random targets.

A "~" marks a time scaled up from sampled targets. A star marks the lower envelope: no
other method and parameters are both faster and more accurate. FMM3D (`fmm3dpy`) sums singular
Stokeslets at the same points in its own arithmetic. Its error is against direct sums of singular
Stokeslets.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import groupby
from typing import Any

from benchmarks import plots, printed, sums, tables
from benchmarks.methods import DIRECT, FMM, KITC, TAYLOR
from benchmarks.rows import Row
from mrs import markdown

measure = sums.one_sum

THETAS = (0.5, 0.6, 0.7, 0.8, 0.2)  # that are drawn, here and for T
SINGLE = {"precision": "float32"}
SINGLE_THETA = 0.7  # of the sums that are done in singles as well

FINE: dict[str, Any] = {
    KITC: ((0.5, 0.6, 0.7, 0.8), (1, 3, 5, 7, 9)),
    TAYLOR: ((0.5, 0.6, 0.7, 0.8), (1, 3, 5, 7, 9)),
    FMM: (1e-2, 2e-3, 1e-3, 1e-4, 3e-5, 1e-6, 5e-7, 3e-7, 1e-8, 1e-10, 1e-11),
    "fmm3d": (1e-3, 1e-6, 1e-9),
}
COARSE = FINE | {
    KITC: ((0.6, 0.7, 0.8), (1, 3, 5, 7)),
    TAYLOR: ((0.6, 0.7, 0.8), (3, 5, 7, 9)),
    "fmm3d": (1e-3, 1e-6),
}
QUICK: dict[str, Any] = {
    KITC: ((0.7,), (3, 7)),
    TAYLOR: ((0.7,), (3, 7)),
    FMM: (1e-2, 1e-3),
    "fmm3d": (1e-3,),
}


def cases(quick: bool) -> Iterator[Row]:
    """Yield backends with their parameters."""
    for n, grid in ((10_000, QUICK),) if quick else ((80_000, FINE), (640_000, COARSE)):
        common: Row = {"points": "organisms", "size": n, "epsilon": 0.02}
        yield common | {"backend": DIRECT}
        for backend in (KITC, TAYLOR):
            thetas, degrees = grid[backend]
            for theta in thetas:
                for degree in degrees:
                    yield common | treecode(backend, theta, degree)
            for degree in degrees:
                yield common | treecode(backend, SINGLE_THETA, degree) | SINGLE
        yield from (common | {"backend": FMM, "tol": tol} for tol in grid[FMM])
        yield from (common | {"backend": "fmm3d", "tol": tol} for tol in grid["fmm3d"])


def treecode(backend: str, theta: float, degree: int, leaf_size: int = 2000) -> Row:
    """Return the parameters of a treecode, with the papers' leaf size."""
    return {"backend": backend, "theta": theta, "degree": degree, "leaf_size": leaf_size}


def table(rows: list[Row]) -> Iterator[str]:
    """Yield the lines of a table, a row for each sum, by N and error."""
    header = "N,backend,parameters,E,build (s),points (s),total (s),near,far,precision"
    return markdown.table(header.split(","), _lines(rows))


def _lines(rows: list[Row]) -> Iterator[list[str]]:
    for n, group in groupby(rows, key=lambda row: row["n"]):
        same = list(group)
        best = plots.envelope(regularized(same))
        for row in sorted(same, key=lambda row: -(row["error"] or 1.0)):
            star = " *" if any(row is other for other in best) else ""
            yield [
                f"{n:,}",
                plots.name(row["backend"]) + star,
                tables.options(row),
                tables.error(row["error"]),
                tables.build(row),
                tables.figure(row["setting"]),
                tables.seconds(row),
                tables.figure(row["near"]),
                tables.figure(row["far"]),
                row["precision"],
            ]


def regularized(rows: list[Row]) -> list[Row]:
    """Return the rows that solve the same problem."""
    return [row for row in rows if row["backend"] != "fmm3d"]


def plot(rows: list[Row], figure: Any) -> None:
    """Draw seconds against error, a panel for each N."""
    groups = [(n, list(group)) for n, group in groupby(rows, key=lambda row: row["n"])]
    figure.set_size_inches(plots.WIDTH, 6.0)
    for axes, (n, same) in zip(
        figure.subplots(1, len(groups), squeeze=False)[0], groups, strict=True
    ):
        best = [row for row in plots.envelope(regularized(same)) if row["error"]]
        axes.plot(
            [row["error"] for row in best],
            [row["seconds"] for row in best],
            color="0.85",
            linewidth=7,
            label="lower envelope",
            zorder=0,
        )
        draw(axes, same)
        if n in printed.K1:
            paper = printed.K1[n]
            plots.printed(axes, [paper.error], [paper.treecode], KITC, "K table 1 (kitc)")
            axes.axhline(
                paper.direct, color="0.5", linestyle=":", linewidth=1, label="K table 1 (direct)"
            )
        axes.set(xscale="log", yscale="log", title=f"N = {n:,}", xlabel="E", ylabel="seconds")
    plots.finish(figure)


def draw(axes: Any, rows: list[Row]) -> None:
    """Draw a line for each backend and theta."""
    for row in rows:
        if row["backend"] == DIRECT:
            label = DIRECT + " (from sampled targets)" * row["extrapolated"]
            dashes = "-." if row["extrapolated"] else "--"
            axes.axhline(row["seconds"], color="k", linestyle=dashes, linewidth=1, label=label)
    for backend in (KITC, TAYLOR):
        for style, theta in enumerate(THETAS):
            same = [row for row in rows if (row["backend"], row.get("theta")) == (backend, theta)]
            for precision, note in (("float64", ""), ("float32", ", float32")):
                line = [row for row in same if row["precision"] == precision]
                shade = len(THETAS) if note else style
                label = f"{backend}, theta {theta:g}{note}"
                plots.line(axes, line, "error", "seconds", backend, label, shade)
    for style, backend in enumerate((FMM, "fmm3d")):
        line = [row for row in rows if row["backend"] == backend]
        plots.line(axes, line, "error", "seconds", backend, plots.name(backend), style)
