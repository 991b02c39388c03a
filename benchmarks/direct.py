"""Pairs per second of direct summation on one thread, beside a plain C++ loop in the same run.

    python -m benchmarks.direct [--points 16384 80000 640000] [--repeats 7]

Needs g++. The two codes take turns, so that a machine that changes speed slows both.
"""

from __future__ import annotations

import argparse
import ctypes
import subprocess
import tempfile
import time
from pathlib import Path

import numba
import numpy as np

import treecode as tc
from benchmarks.methods import DIRECT
from mrs import markdown

FLAGS = ["-O3", "-march=native", "-ffast-math"]
EPSILON = 0.02
PAIRS = 1.5e8  # of one measurement, by taking fewer targets
HEADER = "kernel", "N", "C++ pairs/s", "treecode pairs/s", "ratio", "relative difference"


def plain_loops(folder: str) -> ctypes.CDLL:
    """Compile plain_loop.cpp and load it."""
    source = Path(__file__).with_name("plain_loop.cpp")
    library = Path(folder) / "plain_loop.so"
    subprocess.run(["g++", *FLAGS, "-shared", "-fPIC", source, "-o", library], check=True)
    return ctypes.CDLL(library)


def seconds(function, *arguments) -> float:
    """Return the wall time of one call."""
    start = time.perf_counter()
    function(*arguments)
    return time.perf_counter() - start


def compare(kernel, plain, points: np.ndarray, repeats: int) -> list[str]:
    """Return the row of a kernel in the table."""
    n = len(points)
    m = min(n, int(PAIRS / n))
    strengths = np.random.default_rng(1).uniform(-1, 1, (n, kernel.strength_size))
    x, y, z = np.ascontiguousarray(points.T)
    columns = np.ascontiguousarray(strengths.T)
    out = np.empty((kernel.value_size, m))
    arguments = [ctypes.c_long(m), ctypes.c_long(n), ctypes.c_double(EPSILON)]
    arguments += [a.ctypes.data_as(ctypes.c_void_p) for a in (x, y, z, columns, out)]
    plan = tc.Plan(kernel, DIRECT).set_points(points, points[:m])
    plan.execute(strengths)
    times = np.array(
        [(seconds(plain, *arguments), seconds(plan.execute, strengths)) for _ in range(repeats)]
    )
    difference = tc.relative_error(plan.execute(strengths), out.T)
    rates = m * n / np.median(times, axis=0)
    ratio = np.median(times[:, 0] / times[:, 1])
    cells = [type(kernel).__name__, str(n), f"{rates[0]:.2e}", f"{rates[1]:.2e}"]
    return [*cells, f"{ratio:.2f}", f"{difference:.1e}"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--points", type=int, nargs="+", default=[16384, 80_000, 640_000])
    parser.add_argument("--repeats", type=int, default=7)
    options = parser.parse_args()
    numba.set_num_threads(1)
    print(f"One thread, medians of {options.repeats} turns; g++ {' '.join(FLAGS)}\n")
    with tempfile.TemporaryDirectory() as folder:
        library = plain_loops(folder)
        kernels = [
            (tc.RegularizedStokeslet(EPSILON), library.regularized_stokeslet),
            (tc.RegularizedStokesletRotlet(EPSILON), library.regularized_stokeslet_rotlet),
        ]
        rows = (
            compare(kernel, plain, np.random.default_rng(0).random((n, 3)), options.repeats)
            for kernel, plain in kernels
            for n in options.points
        )
        for line in markdown.table(HEADER, rows):
            print(line, flush=True)


if __name__ == "__main__":
    main()
