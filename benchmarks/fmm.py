"""Run time against error of the fast multipole method, beside the treecode and direct sums.

    python benchmarks/fmm.py curve [--points 80000 640000] [--tol 1e-2 1e-3 ...]
    python benchmarks/fmm.py rods [--tol 1e-4 1e-5]
    python benchmarks/fmm.py growth | threads | sets

Times run from points to values; operators come from memory ("warm"), what building them takes is
a column of its own. Errors are sampled at 1000 targets, K eq. (8.1). One thread unless it says so.
"""

from __future__ import annotations

import argparse
import time
import tracemalloc

import numba
import numpy as np

import treecode as tc
from point_sets import organisms, rods, sphere

KERNEL = tc.RegularizedStokeslet(epsilon=0.02)
HEADER = (
    "| case | N | asked | E | build (s) | points (s) | sum (s) | total (s) | near | precision |"
)


def run(kernel, points, strengths, repeats: int = 3, **options) -> tuple[tc.Plan, list[float]]:
    """Return the plan and the medians of seconds: building, setting points, summing."""
    start = time.perf_counter()
    plan = tc.Plan(kernel, **options).set_points(points)
    build = plan.info()["seconds"].get("operators", 0.0)
    plan.execute(strengths)
    laps = []
    for _ in range(repeats):
        start = time.perf_counter()
        plan.set_points(points)
        middle = time.perf_counter()
        plan.execute(strengths)
        laps.append((middle - start, time.perf_counter() - middle))
    return plan, [build, *np.median(laps, axis=0)]


def report(case: str, kernel, points, strengths, repeats: int = 3, **options) -> float:
    """Print a row and return the total."""
    plan, (build, setting, summing) = run(kernel, points, strengths, repeats, **options)
    error, info = plan.estimate_error(strengths, 1000), plan.info()
    asked = info.get("tol", f"n={info['degree']}")
    pairs = f"{info['near_pairs'] / len(points):.0f}"
    print(
        f"| {case} | {len(points)} | {asked} | {error:.2e} | {build:.2f} | {setting:.2f} | "
        f"{summing:.2f} | {setting + summing:.2f} | {pairs} | {info.get('precision', 'float64')} |",
        flush=True,
    )
    return setting + summing


def header() -> None:
    """Print the head of the table."""
    print(HEADER)
    print("|---" * HEADER.count(" | ") + "|---|")


def curve(options: argparse.Namespace) -> None:
    """K example 1: tolerances, and the treecode at theta 0.7."""
    header()
    for n in options.points:
        points, forces = organisms(n, 0.02, 0, octant=True)
        for tol in options.tol:
            report("fmm", KERNEL, points, forces, backend="fmm", tol=tol)
        for degree in options.degree:
            report("kitc", KERNEL, points, forces, 1, backend="kitc", degree=degree)


def rod_array(options: argparse.Namespace) -> None:
    """K example 2, 80 by 80 rods: forces and torques in, velocities and angular velocities out."""
    header()
    points, strengths = rods(80, 0)
    kernel = tc.RegularizedStokesletRotlet(epsilon=0.3)
    for tol in options.tol:
        report("rods", kernel, points, strengths, 1, backend="fmm", tol=tol)


def growth(options: argparse.Namespace) -> None:
    """Eight times the points, at the same density, and the memory of the larger sum."""
    header()
    times = []
    for n in (640_000, 5_120_000):
        points, forces = organisms(n, 0.02, 0, octant=True)
        scale = (n / 640_000) ** (1 / 3)
        times.append(
            report("cube", KERNEL, scale * points, forces, 1, backend="fmm", tol=options.tol[0])
        )
    numba.set_num_threads(numba.config.NUMBA_NUM_THREADS)
    tracemalloc.start()
    report("all threads", KERNEL, scale * points, forces, 1, backend="fmm", tol=options.tol[0])
    print(
        f"\ngrowth {times[1] / times[0]:.2f}, "
        f"peak {tracemalloc.get_traced_memory()[1] / 1e9:.2f} GB"
    )


def threads(options: argparse.Namespace) -> None:
    """One thread and all of them, in turn."""
    points, forces = organisms(640_000, 0.02, 0, octant=True)
    plan = tc.Plan(KERNEL, "fmm", tol=options.tol[0]).set_points(points)
    times: dict[int, list[float]] = {1: [], numba.config.NUMBA_NUM_THREADS: []}
    for _ in range(5):
        for count, laps in times.items():
            numba.set_num_threads(count)
            start = time.perf_counter()
            plan.execute(forces)
            laps.append(time.perf_counter() - start)
    one, many = times.values()
    ratios = np.array(one) / np.array(many)
    print(f"sums: {np.median(one):.2f} s, {np.median(many):.2f} s, ratios {np.round(ratios, 2)}")


def sets(options: argparse.Namespace) -> None:
    """Sets that are not uniform, beside a cube with as many points: time per point."""
    header()
    n, rng = 300_000, np.random.default_rng(0)
    cube = rng.uniform(-1.0, 1.0, (n, 3))
    clump = cube.copy()
    clump[::2] *= 1e-3
    apart = 1e-3 * cube
    apart[::2] += 1.0
    on_sphere = sphere(7, 0)[0][:n]
    rod_points = rods(45, 0)[0][:n]
    named = {
        "cube": cube,
        "rods": rod_points,
        "sphere": on_sphere,
        "clump": clump,
        "two clumps": apart,
    }
    per_point = {}
    for name, points in named.items():
        kernel = tc.RegularizedStokeslet(epsilon=2e-3 * np.ptp(points) / 2.0)
        forces = rng.standard_normal((len(points), 3))
        total = report(name, kernel, points, forces, backend="fmm", tol=options.tol[0])
        per_point[name] = total / len(points)
    print({name: round(value / per_point["cube"], 2) for name, value in per_point.items()})


CASES = {"curve": curve, "rods": rod_array, "growth": growth, "threads": threads, "sets": sets}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("case", choices=CASES)
    parser.add_argument("--points", type=int, nargs="+", default=[80_000, 640_000])
    parser.add_argument("--tol", type=float, nargs="+", default=[1e-3, 1e-4, 1e-5, 1e-6])
    parser.add_argument("--degree", type=int, nargs="*", default=[3, 5, 7])
    options = parser.parse_args()
    numba.set_num_threads(1)
    CASES[options.case](options)


if __name__ == "__main__":
    main()
