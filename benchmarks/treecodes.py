"""Run time, pairs, error and memory of the treecodes on K example 1, on one and two threads.

    python benchmarks/treecodes.py [--points 80000 640000] [--repeats 3]

The thread counts take turns. Errors are sampled at 2000 targets. Memory is the peak of what NumPy
allocates from `set_points` to the end of `execute`, beside that of direct summation; scratch of
the compiled code, some 100 KiB a thread, is not in it. K's parameters: theta 0.7, N0 2000.
"""

from __future__ import annotations

import argparse
import time
import tracemalloc

import numba
import numpy as np

import treecode as tc
from point_sets import organisms

KERNEL = tc.RegularizedStokeslet(epsilon=0.02)
THETA, LEAF_SIZE = 0.7, 2000


def run(points, forces, backend: str, degree: int) -> tuple[float, tc.Plan]:
    """Return seconds from points to velocities, and the plan."""
    start = time.perf_counter()
    plan = tc.Plan(KERNEL, backend, theta=THETA, degree=degree, leaf_size=LEAF_SIZE)
    plan.set_points(points).execute(forces)
    return time.perf_counter() - start, plan


def peak_bytes(points, forces, backend: str, degree: int) -> int:
    """Return the peak of NumPy's memory in one run, the caller's arrays and the result included."""
    tracemalloc.start()
    run(points, forces, backend, degree)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak + points.nbytes + forces.nbytes


def speed(sizes: list[int], repeats: int) -> None:
    """Print a table of run times."""
    threads = range(1, numba.config.NUMBA_NUM_THREADS + 1)
    header = " | ".join(f"{t} thread{'s' * (t > 1)} (s)" for t in threads)
    print(f"| N | backend | degree | near / target | far / target | E | {header} | speed-up |")
    print("|---" * (7 + len(threads)) + "|")
    for n in sizes:
        points, forces = organisms(n, length=0.02, seed=0, octant=True)
        for backend, degree in (("kitc", 7), ("taylor", 7)):
            run(points[:3000], forces[:3000], backend, degree)
            times = np.empty((repeats, len(threads)))
            for row in times:
                for t in threads:
                    numba.set_num_threads(t)
                    row[t - 1], plan = run(points, forces, backend, degree)
            info, error = plan.info(), plan.estimate_error(forces, 2000)
            middle = np.median(times, axis=0)
            ratio = np.median(times[:, 0] / times[:, -1])
            pairs = f"{info['near_pairs'] / n:.0f} | {info['far_pairs'] / n:.0f}"
            seconds = " | ".join(f"{value:.2f}" for value in middle)
            print(
                f"| {n} | {backend} | {degree} | {pairs} | {error:.2e} | {seconds} | {ratio:.2f} |"
            )


def memory(sizes: list[int]) -> None:
    """Print a table like K table 2. The direct sum's memory is proportional to N."""
    small = 10_000
    per_point = peak_bytes(*organisms(small, 0.02, 0), "direct", 1) / small
    print("\n| N | direct (MB) | " + " | ".join(f"kitc n={n} (MB)" for n in (1, 3, 5, 7, 9)) + " |")
    print("|---" * 7 + "|")
    for n in sizes:
        points, forces = organisms(n, length=0.02, seed=0)
        direct = per_point * n
        peaks = [peak_bytes(points, forces, "kitc", degree) for degree in (1, 3, 5, 7, 9)]
        row = " | ".join(f"{peak / 1e6:.2f} ({peak / direct:.2f})" for peak in peaks)
        print(f"| {n} | {direct / 1e6:.2f} | {row} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--points", type=int, nargs="+", default=[80_000, 640_000])
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args()
    speed(options.points, options.repeats)
    memory(options.points)


if __name__ == "__main__":
    main()
