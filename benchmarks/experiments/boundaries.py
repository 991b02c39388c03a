"""Walls, periodic boxes and slabs

Uniform points in a cube of side 1 with random loads, epsilon 0.005: over a wall that the cube
stands on, in a periodic box that is the cube, and in a slab, which repeats it in two directions.
Seconds are those of a sum with the points set anew, on one thread, beside free space by the same
backend (periodic sums: by "fmm"). Both are summed in turns, and the ratio is the median of the
turns. Direct sums are at as many targets as take some seconds. Errors are those of the flow within
the boundary, sampled at 400 targets.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from itertools import product
from typing import Any

import numba
import numpy as np

import treecode as tc
from benchmarks import plots, tables
from benchmarks.methods import DIRECT, EWALD, FMM, KITC
from benchmarks.rows import Row
from mrs import markdown

KERNELS = {"forces": tc.RegularizedStokeslet, "loads": tc.RegularizedStokesletRotlet}
BOUNDARIES = {
    "wall": tc.Wall(),
    "box": tc.Periodic((1.0, 1.0, 1.0)),
    "slab": tc.Periodic((1.0, 1.0), "xy"),
}
EPSILON = 0.005
TURNS = 3
DIRECT_PAIRS = 6e8
SIZES = 15_000, 300_000


def cases(quick: bool) -> Iterator[Row]:
    """Yield sums over a wall, then periodic ones; torques where operators take some minutes."""
    sizes = (2_000,) if quick else SIZES
    for size, kernel in product(sizes, KERNELS):
        common: Row = {"boundary": "wall", "strengths": kernel, "size": size}
        yield common | {"backend": DIRECT}
        tolerances = (1e-3,) if quick else (1e-3, 1e-5, 1e-8)
        for backend, tol in product((KITC, FMM), tolerances):
            if backend == FMM and kernel == "loads" and tol < 1e-5:
                continue
            if backend == KITC and size > SIZES[0] and tol < 1e-3:
                continue
            yield common | {"backend": backend, "tol": tol}
    sizes, tolerances = ((2_000,), (1e-5,)) if quick else ((100_000, 1_000_000), (1e-5, 1e-10))
    for boundary, size, tol in product(("box", "slab"), sizes, tolerances):
        if boundary == "box" or (size, tol) == (sizes[0], tolerances[0]):
            yield {
                "boundary": boundary, "strengths": "forces", "size": size, "backend": EWALD,
                "tol": tol,
            }  # fmt: skip


def measure(boundary: str, strengths: str, size: int, backend: str, **options: Any) -> Row:
    """Return seconds within the boundary and in free space, in turns, and the error."""
    numba.set_num_threads(1)
    kernel = KERNELS[strengths](EPSILON)
    rng = np.random.default_rng(0)
    points, q = rng.random((size, 3)), rng.standard_normal((size, kernel.strength_size))
    wanted = min(size, int(DIRECT_PAIRS / size)) if backend == DIRECT else size
    targets = points[:wanted] if wanted < size else None
    plans = [
        tc.Plan(kernel, name, **options, boundary=within)
        for name, within in (
            (backend, BOUNDARIES[boundary]),
            (FMM if backend == EWALD else backend, None),
        )
    ]

    def lap(plan: tc.Plan) -> float:
        start = time.perf_counter()
        plan.set_points(points, targets).execute(q)
        return time.perf_counter() - start

    for plan in plans:  # chosen, compiled, operators built
        lap(plan)
    turns = np.array([[lap(plan) for plan in plans] for _ in range(TURNS)])
    error = None if backend == DIRECT else plans[0].estimate_error(q, 400, by_unit=True)
    seconds = np.median(turns, axis=0) * size / wanted
    return {
        "n": size,
        "seconds": seconds[0],
        "free": seconds[1],
        "ratio": float(np.median(turns[:, 0] / turns[:, 1])),
        "error": error,
        "extrapolated": wanted < size,
    }


def table(rows: list[Row]) -> Iterator[str]:
    """Yield the lines of a table, a row for each sum."""
    header = "within,strengths,N,backend,tol,E,seconds,in free space (s),ratio"
    return markdown.table(header.split(","), map(_line, rows))


def _line(row: Row) -> list[str]:
    return [
        row["boundary"],
        row["strengths"],
        f"{row['n']:,}",
        row["backend"],
        f"{row['tol']:g}" if "tol" in row else "",
        tables.error(row["error"]),
        tables.seconds(row),
        tables.seconds(row, "free"),
        f"{row['ratio']:.2f}",
    ]


def plot(rows: list[Row], figure: Any) -> None:
    """Draw the ratios as bars, a row for each sum."""
    figure.set_size_inches(plots.WIDTH, 0.8 + 0.22 * len(rows))
    axes = figure.subplots()
    names = [" ".join(_line(row)[:5]) for row in rows]
    colors = [plots.COLORS[row["backend"]] for row in rows]
    axes.barh(range(len(rows)), [row["ratio"] for row in rows], 0.7, color=colors)
    axes.set_yticks(range(len(rows)), names)
    axes.invert_yaxis()
    axes.set(xlabel="time beside free space")
    plots.finish(figure)
