"""The cost of a step by stage, and savings by leaving out work that a scene does not need.

python -m benchmarks.savings [--output docs/profile.md]
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from statistics import median
from typing import NamedTuple

import numpy as np
from tqdm import tqdm

import mrs
import treecode as tc
from benchmarks.machine import machine_today, publish
from benchmarks.methods import DIRECT, FMM, KITC, TAYLOR
from mrs import markdown
from mrs.profile import STAGES, Profile
from mrs.run import scenario_files
from treecode.methods import taylor

STEPS = 10
TURNS = 9
IMPORTED = "numpy", "numba", "treecode", "mrs", "mrs, scipy.spatial", "mrs, pyvista, meshio"
EULER = mrs.Integrator("euler", dt=1e-6)
BY_KITC = mrs.Backend(KITC, theta=0.7, degree=5, leaf_size=1000)
BY_FMM = mrs.Backend(FMM, tolerance=1e-4)


def swimmers(count: int) -> mrs.Simulation:
    """Return a suspension as dense as the scenario's."""
    positions, along = mrs.random_suspension(count, 1.2 * count ** (1 / 3), 0.2, reach=1.0)
    bodies = [mrs.Swimmers(positions, along, length=1.0, force=1.0, epsilon=0.1)]
    return mrs.Simulation(mrs.Fluid(), bodies, backend=DIRECT, integrator=EULER)


def rods(side: int, backend: mrs.Backend) -> mrs.Simulation:
    """Return the beating carpet of K 8.2, side x side rods of 151 nodes."""
    options = {"rows": side, "columns": side, "nodes": 151, "wall": False}
    return scenario_files.make("cilia_array", options).build(backend=backend, integrator=EULER)


def tracers(count: int) -> mrs.Simulation:
    """Return tracers in shear flow."""
    bodies = [mrs.Tracers(np.random.default_rng(0).uniform(-5.0, 5.0, (count, 3)))]
    fluid = mrs.Fluid(background=mrs.flows.shear(1.0))
    return mrs.Simulation(fluid, bodies, integrator=EULER)


class Step(NamedTuple):
    """The cost of one step."""

    points: int
    seconds: dict[str, float]
    """By stage, medians."""
    pairs: dict[str, int]


def profiled(sim: mrs.Simulation) -> Step:
    """Return the cost of a step, from some steps."""
    points = len(sim.now.points)
    sim.step(1e-6)  # compiles, chooses, estimates the spectral radius
    steps = []
    for _ in range(STEPS):
        sim.scene.profile = Profile()
        sim.step(sim.time + 1e-6)
        steps.append(sim.profile)
    seconds = {stage: median(step.seconds[stage] for step in steps) for stage in steps[0].seconds}
    return Step(points, seconds, dict(steps[0].pairs))


def profiles() -> Iterator[str]:
    """Yield the lines of a table: a row a stage, a column a scene."""
    scenes = {
        "8000 swimmers": profiled(swimmers(8000)),
        "15 x 15 rods, kitc": profiled(rods(15, BY_KITC)),
        "15 x 15 rods, fmm": profiled(rods(15, BY_FMM)),
        "16000 tracers": profiled(tracers(16000)),
    }
    steps = scenes.values()
    rows = []
    for stage, meaning in STAGES.items():
        if any(stage in step.seconds for step in steps):
            times = [step.seconds.get(stage) for step in steps]
            cells = ["" if t is None else f"{1e3 * t:.2f}" for t in times]
            rows.append([f"{stage}: {meaning}", *cells])
    rows.append(["points", *(str(step.points) for step in steps)])
    for part in ("near", "far"):
        rows.append([f"pairs {part}", *(f"{step.pairs.get(part, 0):,}" for step in steps)])
    return markdown.table(["ms a step", *scenes], rows)


def compared(*actions: Callable[[], object]) -> list[float]:
    """Return the medians of the times of some actions that take turns, in milliseconds."""
    times: list[list[float]] = [[] for _ in actions]
    for turn in range(TURNS + 1):  # the first one compiles
        for action, own in zip(actions, times, strict=True):
            start = time.perf_counter()
            action()
            if turn:
                own.append(1e3 * (time.perf_counter() - start))
    return [median(own) for own in times]


def summed(
    kernel: tc.Kernel, backend: str, sources: np.ndarray, targets: np.ndarray | None, **options: int
) -> Callable[[], np.ndarray]:
    """Return one evaluation as a function: points set, forces summed."""
    plan = tc.Plan(kernel, backend, **options)
    strengths = np.zeros((len(sources), kernel.strength_size))
    strengths[:, :3] = np.random.default_rng(1).standard_normal((len(sources), 3))
    return lambda: plan.set_points(sources, targets).execute(strengths)


def savings() -> Iterator[tuple[str, Callable[[], object], Callable[[], object]]]:
    """Yield a name for each saving, an action with it and one without it."""
    rng = np.random.default_rng(0)
    stokeslet, rotlet = tc.RegularizedStokeslet(0.05), tc.RegularizedStokesletRotlet(0.05)
    points = rng.random((8000, 3))
    yield (
        "swimmers have no torques: sums of 8000 points, 3 by 3 beside 6 by 6, direct",
        summed(stokeslet, DIRECT, points, None),
        summed(rotlet, DIRECT, points, None),
    )
    yield (
        "tracers put no force on the fluid: 4000 sources and 8000 targets beside 8000 of both",
        summed(stokeslet, DIRECT, points[:4000], points),
        summed(stokeslet, DIRECT, points, None),
    )
    few = points[:1000]
    beyond = np.concatenate([few[1:], [[9.0, 9.0, 9.0]]])  # one target that accepts the root
    yield (
        "no weights of a cluster that no target accepts: 1000 points in one leaf, kitc, degree 7",
        summed(stokeslet, KITC, few, few, degree=7),
        summed(stokeslet, KITC, few, beyond, degree=7),
    )
    again = summed(stokeslet, TAYLOR, few, None, degree=7, leaf_size=100)

    def anew() -> None:
        taylor._tables.cache_clear()
        again()

    yield "tables of multi-indices made once: 1000 points, taylor, degree 7", again, anew
    shear, tube = mrs.flows.shear(1.0), mrs.flows.poiseuille(1.0, 1.0)
    many = rng.random((16_000, 3))
    yield (
        "no products of coordinates in linear flows: 16000 points, shear beside a tube",
        lambda: shear.velocity(many, 0.0),
        lambda: tube.velocity(many, 0.0),
    )
    fewer = summed(stokeslet, DIRECT, points[:76], None)

    def with_bar() -> None:
        tqdm(total=1, disable=True).close()
        fewer()

    yield "no progress bar where none is shown: 76 points, direct", fewer, with_bar


def possible() -> Iterator[tuple[str, Callable[[], object], Callable[[], object]]]:
    """Yield savings that are possible but not made, in the same way."""
    points = np.random.default_rng(0).random((34_000, 3))
    for backend, options in (
        (KITC, {"degree": 5, "leaf_size": 1000}),
        (FMM, {"tol": 1e-4}),
    ):
        kernel = tc.RegularizedStokeslet(0.02)
        plan = tc.Plan(kernel, backend, **options).set_points(points)
        strengths = np.random.default_rng(1).standard_normal((len(points), 3))
        whole = summed(kernel, backend, points, None, **options)
        yield (
            f"a tree kept while points move: 34000 points, {backend}",
            lambda plan=plan, strengths=strengths: plan.execute(strengths),
            whole,
        )


def table(rows: Iterator[tuple[str, Callable[[], object], Callable[[], object]]]) -> Iterator[str]:
    """Yield the lines of a table of savings."""

    def line(row: tuple[str, Callable[[], object], Callable[[], object]]) -> list[str]:
        title, saving, wasting = row
        less, more = compared(saving, wasting)
        return [title, f"{less:.3g}", f"{more:.3g}", f"{more / less:.2f}"]

    return markdown.table(["saving", "with (ms)", "without (ms)", "ratio"], map(line, rows))


def imports() -> Iterator[str]:
    """Yield the lines of a table: how long it takes to import packages, in a new process."""

    def line(packages: str) -> list[str]:
        times = []
        for _ in range(TURNS):
            start = time.perf_counter()
            subprocess.run([sys.executable, "-c", f"import {packages}"], check=True)
            times.append(time.perf_counter() - start)
        return [packages, f"{median(times):.2f}"]

    return markdown.table(["imported", "s"], map(line, IMPORTED))


def main() -> None:
    parser = argparse.ArgumentParser(description="Print the cost of a step, and savings.")
    parser.add_argument("--output", type=Path, help="a file; the terminal by default")
    options = parser.parse_args()
    lines = [
        "# The cost of a step",
        f"\n{machine_today()}. Written by `python -m benchmarks.savings`.",
        f"\n## By stage\n\nMedians of {STEPS} steps of forward Euler.\n",
        *profiles(),
        f"\n## With and without\n\nMedians of {TURNS} turns.\n",
        *table(savings()),
        "\n## Not done\n",
        *table(possible()),
        "\n## Imports\n",
        *imports(),
    ]
    publish(lines, options.output)


if __name__ == "__main__":
    main()
