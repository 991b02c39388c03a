"""The common part of all pictures: colours, markers, axes and legends."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from benchmarks.methods import DIRECT, EWALD, FMM, KITC, TAYLOR
from benchmarks.rows import Row

# Okabe and Ito's colours, which differ for colour-blind readers as well
COLORS = {
    DIRECT: "#000000",
    KITC: "#0072B2",
    TAYLOR: "#D55E00",
    FMM: "#009E73",
    EWALD: "#56B4E9",
    "fmm3d": "#CC79A7",
    "euler": "#000000",
    "heun": "#E69F00",
    "rk4": "#0072B2",
    "bs32": "#009E73",
    "rkc2": "#D55E00",
    "bdf": "#CC79A7",
}
NAMES = {"fmm3d": "FMM3D (singular)"}
PAPERS = {"marker": "*", "markersize": 11, "markerfacecolor": "none", "linestyle": "none"}
MARKERS = "osD^vP<>"
DASHES = ("-", "--", ":", "-.")
WIDTH = 10.0  # inches, of all pictures


def name(backend: str) -> str:
    """Return the name of a backend in legends."""
    return NAMES.get(backend, backend)


def envelope(rows: list[Row]) -> list[Row]:
    """Return the rows that no other beats in both error and seconds, by falling error.

    Direct sums have no error.
    """
    best: list[Row] = []
    for row in sorted(rows, key=lambda row: (row["seconds"], row["error"] or 0.0)):
        if not best or (row["error"] or 0.0) < (best[-1]["error"] or 0.0):
            best.append(row)
    return best


def line(axes: Any, rows: list[Row], x: str, y: str, color: str, label: str, style: int) -> None:
    """Draw rows as a line in the colour of a backend or method, extrapolated ones hollow.

    `style` picks markers and dashes.
    """
    rows = [row for row in rows if row[x] and row[y]]
    look = {"color": COLORS[color], "marker": MARKERS[style % len(MARKERS)], "markersize": 5}
    dashes = DASHES[style % len(DASHES)]
    xs, ys = ([row[name] for row in rows] for name in (x, y))
    if rows:
        axes.plot(xs, ys, linestyle=dashes, linewidth=1.2, label=label, **look)
    for row in rows:
        if row.get("extrapolated"):
            axes.plot(row[x], row[y], markerfacecolor="white", **look)


def points_axis(axes: Any, sizes: Iterable[int]) -> None:
    """Label an axis of numbers of points with those that occur."""
    sizes = sorted(set(sizes))
    names = [f"{n / 1e6:.3g}M" if n >= 10**6 else f"{n / 1e3:.3g}K" for n in sizes]
    axes.set(xscale="log", xlabel="N")
    axes.set_xticks(sizes, names)
    axes.set_xticks([], minor=True)


def printed(axes: Any, x: Sequence[float], y: Sequence[float], backend: str, label: str) -> None:
    """Draw figures that a paper prints, in the colour of the backend that they are of."""
    if x:
        axes.plot(x, y, color=COLORS[backend], label=label, **PAPERS)


def finish(figure: Any, *, columns: int = 4) -> None:
    """Add a grid to all axes and one legend for them below."""
    entries: dict[str, Any] = {}
    for axes in figure.axes:
        axes.grid(True, which="major", alpha=0.3)
        handles, labels = axes.get_legend_handles_labels()
        entries |= dict(zip(labels, handles, strict=True))
    if entries:
        figure.legend(
            entries.values(),
            entries.keys(),
            loc="outside lower center",
            ncols=columns,
            fontsize="small",
        )
