"""What backend "auto" takes beside the best of each backend, for the same error.

    python -m benchmarks.auto [--points 1000 10000 80000] [--tol 1e-2 1e-4 ...] [--output FILE]

Regularized Stokeslets with random forces, one thread. Processor time from points to values, the
least of several laps: of "direct" a sum at 2000 targets is scaled; of "kitc" and "taylor" the
fastest of theta, degree and leaf size that reach the tolerance; of "fmm" the largest of its
tolerances that does.
Operators are built before. Rows are kept in --rows, so that the command goes on where it ended.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from pathlib import Path
from typing import Any

import numba
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import test_tolerance

import treecode as tc
from benchmarks.machine import machine
from treecode import auto

KERNEL = tc.RegularizedStokeslet(epsilon=0.01)
COLUMNS = (
    "points", "N", "tol", "direct (s)", "kitc (s)", "taylor (s)", "fmm (s)", "auto (s)", "is",
    "error", "ratio", "first (s)",
)  # fmt: skip
CHECKED = 2000  # targets
LAPS = 0.3  # seconds, of short sums more than two
PATIENCE = 2.0  # times the best so far, beyond which no larger degree is tried


class Sum:
    """Points, forces, and direct sums at some targets."""

    def __init__(self, name: str, n: int) -> None:
        rng = np.random.default_rng(0)
        self.points = test_tolerance.SETS[name](n, rng)
        self.forces = rng.standard_normal((n, 3))
        self.drawn = np.random.default_rng(1).permutation(n)[:CHECKED]
        plan = tc.Plan(KERNEL, "direct").set_points(self.points, self.points[self.drawn])
        self.exact = plan.execute(self.forces)
        laps = []
        for _ in range(5):
            start = time.process_time()
            plan.execute(self.forces)
            laps.append(time.process_time() - start)
        self.direct_seconds = min(laps) * n / len(self.drawn)

    def run(self, plan: tc.Plan, once: bool = False) -> tuple[float, float]:
        """Return seconds, the least of several laps, and error."""
        seconds: list[float] = []
        while len(seconds) < 2 or sum(seconds) < LAPS:
            start = time.process_time()
            values = plan.set_points(self.points).execute(self.forces)
            seconds.append(time.process_time() - start)
            if once:
                break
        return min(seconds), tc.relative_error(values[self.drawn], self.exact)

    def treecode(self, backend: str, tol: float) -> float:
        """Return the seconds of the fastest that reaches a tolerance."""
        best, winner = math.inf, {}
        for theta in auto.THETAS:
            for degree in auto.DEGREES[backend]:
                options = {"theta": theta, "degree": degree}
                plan = tc.Plan(KERNEL, backend, leaf_size=500, **options)
                seconds, error = self.run(plan, once=True)
                if error <= tol and seconds < best:
                    best, winner = seconds, options
                if error <= tol or seconds > PATIENCE * min(best, self.direct_seconds):
                    break
        plans = [tc.Plan(KERNEL, backend, leaf_size=size, **winner) for size in auto.LEAF_SIZES]
        return min((self.run(plan)[0] for plan in plans if winner), default=math.inf)

    def multipole(self, tol: float) -> float:
        """Return the same for the fast multipole method."""
        for asked in auto.TOLERANCES:
            if asked <= 20.0 * tol:
                seconds, error = self.run(tc.Plan(KERNEL, "fmm", tol=asked))
                if error <= tol:
                    return seconds
        return math.inf


def row(name: str, n: int, tol: float) -> dict[str, Any]:
    """Return one line of the table."""
    case = Sum(name, n)
    seconds = {
        "direct": case.direct_seconds,
        "kitc": case.treecode("kitc", tol),
        "taylor": case.treecode("taylor", tol),
        "fmm": case.multipole(tol),
    }
    plan = tc.Plan(KERNEL, tol=tol)
    first, _ = case.run(plan, once=True)
    taken, error = case.run(plan)
    values = [name, n, f"{tol:g}", *(f"{s:.3g}" for s in seconds.values()), f"{taken:.3g}"]
    values += [plan.choice, f"{error:.1e}", f"{taken / min(seconds.values()):.2f}", f"{first:.3g}"]
    return dict(zip(COLUMNS, map(str, values), strict=True))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--points", type=int, nargs="+", default=[1000, 10_000, 80_000])
    parser.add_argument("--tol", type=float, nargs="+", default=[1e-2, 1e-4, 1e-6, 1e-8, 1e-10])
    parser.add_argument("--sets", nargs="+", default=["cube", "sphere", "clustered"])
    parser.add_argument("--rows", type=Path, default=Path("outputs/auto.jsonl"))
    parser.add_argument("--output", type=Path, help="a file; the terminal by default")
    options = parser.parse_args()
    numba.set_num_threads(1)
    kept = options.rows.read_text().splitlines() if options.rows.exists() else []
    rows = {(r["points"], r["N"], r["tol"]): r for r in map(json.loads, kept)}
    for n in options.points:
        for name in options.sets:
            for tol in options.tol:
                if (name, str(n), f"{tol:g}") not in rows:
                    new = row(name, n, tol)
                    print(*new.values(), file=sys.stderr, flush=True)
                    rows[name, str(n), f"{tol:g}"] = new
                    with options.rows.open("a") as file:
                        file.write(json.dumps(new) + "\n")
    lines = [
        '# Backend "auto" beside the best of each backend\n',
        *__doc__.split("\n\n")[2].splitlines(),
        "`ratio` is `auto` to the smallest of the four before it, `first` its first sum, with the",
        "look at a few targets and the sampled error.\n",
        machine() + "\n",
        "| " + " | ".join(COLUMNS) + " |",
        "|---" * len(COLUMNS) + "|",
        *("| " + " | ".join(r.values()) + " |" for r in rows.values()),
        f"\nLargest ratio: {max(float(r['ratio']) for r in rows.values()):.2f}.",
    ]
    text = "\n".join(lines) + "\n"
    if options.output is None:
        print(text, end="")
    else:
        options.output.write_text(text)


if __name__ == "__main__":
    main()
