"""Time stepping: error at a fixed time against wall time

Four scenes with direct sums on one thread: the stiff rod of Olson, Lim & Cortez after 10 ms, a
planar wave along a rod of 301 nodes over a wall after a period, 60 swimmers in a periodic box
after 2 s, and nine beating cilia after a quarter of a beat. Methods without an error estimate have
fixed steps, the others tolerances. The error is the root mean square distance of points from those
of an explicit run with much smaller steps, in lengths of a body.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from functools import lru_cache
from itertools import groupby
from typing import Any, NamedTuple

import numba
import numpy as np

import mrs
from benchmarks import plots, sums, tables
from benchmarks.methods import DIRECT
from benchmarks.rows import Row
from mrs import markdown
from mrs.run import scenario_files


class Scene(NamedTuple):
    """A scene, its end, the length of a body, and the numbers of steps of the methods."""

    scenario: str
    options: dict[str, Any]
    t_end: float
    length: float
    steps: dict[str, tuple[int, ...]]
    reference: mrs.Integrator


SCENES = {
    "rod": Scene(
        "rod_relaxation",
        {},
        0.01,
        75 * np.pi / 40,
        {
            "euler": (1500, 3000, 6000),
            "heun": (1500, 3000, 6000),
            "rk4": (1250, 2500),
        },
        mrs.Integrator("rk4", dt=0.01 / 5000),
    ),
    "wave": Scene("rod_above_wall", {}, 0.05, 60.0, {}, mrs.Integrator("rkc2", tolerance=1e-7)),
    "swimmers": Scene(
        "swimmer_suspension",
        {"count": 60, "size": 5.0},
        2.0,
        1.0,
        {"euler": (100, 400, 1600), "heun": (100, 200, 400), "rk4": (100, 200, 400)},
        mrs.Integrator("rk4", dt=2.0 / 3200),
    ),
    "cilia": Scene(
        "cilia_array",
        {"rows": 3, "columns": 3, "nodes": 41, "wall": False},
        0.25,
        6.0,
        {"euler": (700, 1400, 2800), "heun": (700, 1400, 2800), "rk4": (500, 1000)},
        mrs.Integrator("rk4", dt=0.25 / 2000),
    ),
}
TOLERANCES = {
    "bs32": (1e-3, 1e-4, 1e-5, 1e-6, 1e-7),
    "rkc2": (1e-2, 1e-3, 1e-4, 1e-5, 1e-6),
    "bdf": (1e-2, 1e-3, 1e-4, 1e-5, 1e-6),
}
_TOO_LONG = {("wave", "bs32"), ("swimmers", "bdf")}  # limited by stability; not stiff
METHODS = ("euler", "heun", "rk4", "bs32", "rkc2", "bdf")


def cases(quick: bool) -> Iterator[Row]:
    """Yield scenes with integrators."""
    for name, scene in SCENES.items():
        if not quick or name == "swimmers":
            for method, counts in scene.steps.items():
                yield from ({"scene": name, "method": method, "steps": n} for n in counts)
            for method, tolerances in TOLERANCES.items():
                if (name, method) in _TOO_LONG:
                    continue
                yield from ({"scene": name, "method": method, "tolerance": t} for t in tolerances)


def run_scene(scene: str, method: str, steps: int = 0, tolerance: float = 1e-4) -> Row:
    """Run a scene with fixed steps or a tolerance, and again while that is short."""
    numba.set_num_threads(1)
    what = SCENES[scene]
    dt: Any = what.t_end / steps if steps else "auto"
    integrator = mrs.Integrator(method, dt=dt, tolerance=tolerance)
    exact = _reference(scene)
    sims: list[mrs.Simulation] = []

    def lap() -> float:
        sims.append(build(what, integrator))
        start = time.perf_counter()
        sims[-1].run(what.t_end)
        return time.perf_counter() - start

    laps = sums.repeat(lap)
    sim = sims[-1]
    distance = np.linalg.norm(sim.state.positions - exact, axis=1) / what.length
    return {
        "taken": sim.stepper.steps,
        "evaluations": sim.mobility.evaluations,
        "seconds": float(np.median(laps)),
        "error": float(np.sqrt(np.mean(distance**2))),
    }


def build(scene: Scene, integrator: mrs.Integrator) -> mrs.Simulation:
    """Return a scene at its start."""
    made = scenario_files.make(scene.scenario, scene.options)
    return made.build(backend=mrs.Backend(DIRECT), integrator=integrator)


@lru_cache
def _reference(name: str) -> np.ndarray:
    """Return the positions at the end of a run with small steps."""
    scene = SCENES[name]
    return build(scene, scene.reference).run(scene.t_end).state.positions


measure = run_scene


def table(rows: list[Row]) -> Iterator[str]:
    """Yield the lines of a table, a row for each run, by scene and error."""
    header = "scene,integrator,step,steps taken,evaluations,error,seconds"
    ordered = sorted(rows, key=lambda row: (row["scene"], -row["error"]))
    return markdown.table(header.split(","), map(_line, ordered))


def _line(row: Row) -> list[str]:
    step = f"tolerance {row['tolerance']:g}" if "tolerance" in row else "fixed"
    return [
        row["scene"],
        row["method"],
        step,
        f"{row['taken']:,}",
        f"{row['evaluations']:,}",
        tables.error(row["error"]),
        tables.figure(row["seconds"]),
    ]


def plot(rows: list[Row], figure: Any) -> None:
    """Draw error against seconds, a panel for each scene."""
    groups = [(name, list(group)) for name, group in groupby(rows, key=lambda row: row["scene"])]
    figure.set_size_inches(plots.WIDTH, 8.0)
    panels = figure.subplots(2, 2).ravel()
    for axes, (name, mine) in zip(panels, groups, strict=False):
        for style, method in enumerate(METHODS):
            line = [row for row in mine if row["method"] == method]
            plots.line(axes, line, "error", "seconds", method, method, style)
        axes.set(xscale="log", yscale="log", title=name, xlabel="error", ylabel="seconds")
    plots.finish(figure, columns=len(METHODS))
