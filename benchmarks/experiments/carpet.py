"""What a step costs

The rods of K 8.2, 151 nodes each, stand on a square grid and are made to beat. `kitc` has theta
0.7 and n = 5. The steps are a microsecond of forward Euler, on one thread. "Outside the sums" is
the rest of a step: rods, integrator, checks.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import numba

import mrs
from benchmarks import plots, point_sets, tables
from benchmarks.methods import KITC, TAYLOR
from benchmarks.rows import Row
from mrs import markdown
from mrs.run import scenario_files

STEPS, DT = 5, 1e-6


def cases(quick: bool) -> Iterator[Row]:
    """Yield rods on a side."""
    yield from ({"rods": rods} for rods in ((2, 3) if quick else (5, 10, 15)))


def step_carpet(rods: int) -> Row:
    """Take some steps after a first one, which compiles and estimates the spectral radius."""
    numba.set_num_threads(1)
    nodes = point_sets.ROD_POINTS
    options = {"rows": rods, "columns": rods, "nodes": nodes, "wall": False}
    backend = mrs.Backend(KITC, theta=0.7, degree=5)
    scene = scenario_files.make("cilia_array", options)
    sim = scene.build(backend=backend, integrator=mrs.Integrator("euler", dt=DT))
    sim.step(DT)
    evaluations, before = sim.mobility.evaluations, _outside(sim)
    start = time.perf_counter()
    for _ in range(STEPS):
        sim.step(sim.time + DT)
    seconds = time.perf_counter() - start
    return {
        "n": len(sim.state.positions),
        "evaluations": (sim.mobility.evaluations - evaluations) / STEPS,
        "seconds": seconds / STEPS,
        "outside": (_outside(sim) - before) / STEPS,
    }


def _outside(sim: mrs.Simulation) -> float:
    """Return the seconds that steps have taken beside their sums."""
    return sum(sim.profile.seconds[stage] for stage in ("forces", "integrator"))


measure = step_carpet


def table(rows: list[Row]) -> Iterator[str]:
    """Yield the lines of a table, a row for each carpet."""
    header = "rods,nodes,sums a step,seconds a step,outside the sums (s),outside (%)"
    return markdown.table(header.split(","), map(_line, rows))


def _line(row: Row) -> list[str]:
    return [
        f"{row['rods']} x {row['rods']}",
        f"{row['n']:,}",
        f"{row['evaluations']:g}",
        tables.figure(row["seconds"]),
        tables.figure(row["outside"]),
        f"{100 * row['outside'] / row['seconds']:.1f}",
    ]


def plot(rows: list[Row], figure: Any) -> None:
    """Draw seconds of a step against nodes."""
    figure.set_size_inches(0.6 * plots.WIDTH, 4.0)
    axes = figure.subplots()
    plots.line(axes, rows, "n", "seconds", KITC, "a step", 0)
    plots.line(axes, rows, "n", "outside", TAYLOR, "of it outside the sums", 1)
    plots.points_axis(axes, (row["n"] for row in rows))
    axes.set(yscale="log", xlabel="nodes", ylabel="seconds")
    plots.finish(figure)
