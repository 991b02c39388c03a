"""Prescribed cilia

Lung cilia with their measured beat stand on a grid over a wall, 20 points each, the carpet of the
scenario `prescribed_cilia`. An evaluation finds the forces at all points by iterations over sums
to 1e-4, from the forces a fiftieth of a period before. Medians over a period, on one thread, by
the backend that "auto" chooses. "Solve" is the stage of the profile with the iterations, and "sums"
the part of the time that their sums take.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import numba
import numpy as np

from benchmarks import plots, sums, tables
from benchmarks.methods import DIRECT, KITC
from benchmarks.rows import Row
from mrs import markdown
from mrs.run import scenario_files

TIMES = 50  # of a period


def cases(quick: bool) -> Iterator[Row]:
    """Yield cilia on a side."""
    yield from ({"cilia": cilia} for cilia in ((2, 3) if quick else (5, 10, 20)))


def evaluate_carpet(cilia: int) -> Row:
    """Evaluate a carpet at times of a period, after a first evaluation, which compiles."""
    numba.set_num_threads(1)
    options = {"rows": cilia, "columns": cilia, "tracers": 0}
    sim = scenario_files.make("prescribed_cilia", options).build()
    now, profile = sim.now, sim.profile
    resistance = sim.scene.resistance
    assert resistance is not None
    before, solved = resistance.mobility.evaluations, profile.seconds["resistance"]
    laps = []
    for moment in (1.0 + np.arange(TIMES)) / TIMES:
        start = time.perf_counter()
        now = sim.scene.evaluate(moment, sim.state)
        laps.append(time.perf_counter() - start)
    count = (resistance.mobility.evaluations - before) / TIMES
    solved = profile.seconds["resistance"] - solved

    def lap() -> float:
        start = time.perf_counter()
        resistance.mobility(now.points, now.loads)
        return time.perf_counter() - start

    lap()  # with the points set
    one = float(np.median(sums.repeat(lap)))
    return {
        "n": len(now.points),
        "seconds": float(np.median(laps)),
        "sums": count,
        "solve": solved / sum(laps),
        "summing": count * one / float(np.mean(laps)),
        "choice": str(resistance.mobility.choices[0].backend),
    }


measure = evaluate_carpet


def table(rows: list[Row]) -> Iterator[str]:
    """Yield the lines of a table, a row for each carpet."""
    header = "cilia,points,backend,evaluations a second,sums of each,solve (%),sums (%)"
    return markdown.table(header.split(","), map(_line, rows))


def _line(row: Row) -> list[str]:
    return [
        f"{row['cilia']} x {row['cilia']}",
        f"{row['n']:,}",
        row["choice"],
        tables.figure(1.0 / row["seconds"]),
        f"{row['sums']:.1f}",
        f"{100 * row['solve']:.0f}",
        f"{100 * row['summing']:.0f}",
    ]


def plot(rows: list[Row], figure: Any) -> None:
    """Draw seconds of an evaluation, and of each of its sums, against points."""
    each = [row | {"each": row["seconds"] * row["summing"] / row["sums"]} for row in rows]
    figure.set_size_inches(0.6 * plots.WIDTH, 4.0)
    axes = figure.subplots()
    plots.line(axes, each, "n", "seconds", KITC, "an evaluation", 0)
    plots.line(axes, each, "n", "each", DIRECT, "a sum", 1)
    plots.points_axis(axes, (row["n"] for row in rows))
    axes.set(yscale="log", xlabel="points", ylabel="seconds")
    plots.finish(figure)
