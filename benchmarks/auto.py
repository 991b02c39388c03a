"""Seconds of backend "auto" beside the best of each backend, for the same error.

    python -m benchmarks.auto [--points 1000 3000 ...] [--tol 1e-2 1e-4 ...] [--output FILE]

Regularized Stokeslets with random forces, on one thread. Times are processor time from points to
values, the least of several laps in turns. "direct" is scaled from a sum at 2000 targets. "kitc"
and "taylor" are the fastest of theta, degree and leaf size that reach the tolerance. All three
are in single precision where that reaches it. "fmm" has the largest of its tolerances that
reaches it. Its operators are built before. Rows are kept in --rows, so that the command goes on
where it ended.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from itertools import product
from operator import itemgetter
from pathlib import Path
from typing import Any

import numba
import numpy as np

import treecode as tc
from benchmarks.machine import machine_today, publish
from benchmarks.methods import DIRECT, FMM, KITC, TAYLOR
from benchmarks.rows import Row, Rows
from mrs import markdown
from tests.cases import tolerance
from treecode import methods
from treecode.methods.base import PRECISIONS
from treecode.methods.fmm.method import TOLERANCES
from treecode.methods.treecode import LEAF_SIZES, THETAS

KERNEL = tc.RegularizedStokeslet(epsilon=0.01)
COLUMNS = (
    "points", "N", "tol", "direct (s)", "kitc (s)", "taylor (s)", "fmm (s)", "auto (s)", "is",
    "error", "ratio", "first (s)",
)  # fmt: skip
CHECKED = 2000  # targets
LAPS, MOST = 1.0, 30  # seconds of laps in turns, and most rounds, three at least
PATIENCE = 2.0  # times the best so far, beyond which no larger degree is tried


class Sum:
    """Points, forces, and direct sums at some targets."""

    def __init__(self, name: str, n: int) -> None:
        rng = np.random.default_rng(0)
        self.points = tolerance.SETS[name](n, rng)
        self.forces = rng.standard_normal((n, 3))
        self.drawn = np.random.default_rng(1).permutation(n)[:CHECKED]
        self.exact, seconds = self.lap(tc.Plan(KERNEL, DIRECT))
        self.direct_seconds = seconds * n / len(self.drawn)

    def lap(self, plan: tc.Plan) -> tuple[np.ndarray, float]:
        """Return values and seconds; of "direct" at the drawn targets alone."""
        targets = self.points[self.drawn] if plan.backend == DIRECT else None
        start = time.process_time()
        values = plan.set_points(self.points, targets).execute(self.forces)
        return values, time.process_time() - start

    def error(self, values: np.ndarray) -> float:
        """Return the relative error, as the drawn targets tell."""
        return tolerance.error_at(self.drawn, values, self.exact)

    def direct(self, tol: float) -> tc.Plan:
        """Return direct sums, in singles if these reach a tolerance."""
        single = tc.Plan(KERNEL, DIRECT, precision="float32")
        good = tc.relative_error(self.lap(single)[0], self.exact) <= tol
        return single if good else tc.Plan(KERNEL, DIRECT)

    def treecode(self, backend: str, tol: float) -> tc.Plan | None:
        """Return the fastest that reaches a tolerance."""
        best, winner = math.inf, None
        for theta in THETAS:
            for degree in methods.get(backend).degrees:
                plan = tc.Plan(KERNEL, backend, theta=theta, degree=degree, leaf_size=500)
                values, seconds = self.lap(plan)
                good = self.error(values) <= tol
                if good and seconds < best:
                    best, winner = seconds, plan.choice
                if good or seconds > PATIENCE * min(best, self.direct_seconds):
                    break
        if winner is None:
            return None
        options: dict[str, Any] = {
            "theta": winner.parameters["theta"],
            "degree": winner.parameters["degree"],
        }
        plans = [
            tc.Plan(KERNEL, backend, leaf_size=size, precision=precision, **options)
            for size, precision in product(LEAF_SIZES, PRECISIONS)
        ]
        laps = [self.lap(plan) for plan in plans]
        good = [
            (seconds, plan)
            for plan, (values, seconds) in zip(plans, laps, strict=True)
            if self.error(values) <= tol
        ]
        return min(good, key=itemgetter(0))[1]

    def multipole(self, tol: float) -> tc.Plan | None:
        """Return the same for the fast multipole method."""
        for asked in TOLERANCES:
            if asked <= 20.0 * tol:
                plan = tc.Plan(KERNEL, FMM, tol=asked)
                if self.error(self.lap(plan)[0]) <= tol:
                    return plan
        return None

    def in_turns(self, plans: list[tc.Plan | None]) -> list[float]:
        """Return the least seconds of each in several rounds, as the speed of machines varies."""
        laps: list[list[float]] = [[] for _ in plans]
        while len(laps[0]) < 3 or sum(map(sum, laps)) < LAPS:
            for plan, seconds in zip(plans, laps, strict=True):
                seconds.append(self.lap(plan)[1] if plan else math.inf)
            if len(laps[0]) >= MOST:
                break
        least = [min(seconds) for seconds in laps]
        least[0] *= len(self.points) / len(self.drawn)
        return least


def compare(points: str, n: int, tol: float) -> Row:
    """Return the cells of one line of the table, by column."""
    case = Sum(points, n)
    chosen = tc.Plan(KERNEL, tol=tol)
    values, first = case.lap(chosen)
    *seconds, taken = case.in_turns(
        [
            case.direct(tol),
            case.treecode(KITC, tol),
            case.treecode(TAYLOR, tol),
            case.multipole(tol),
            chosen,
        ]
    )
    cells = [points, n, f"{tol:g}", *(f"{s:.3g}" for s in seconds), f"{taken:.3g}", chosen.choice]
    cells += [f"{case.error(values):.1e}", f"{taken / min(seconds):.2f}", f"{first:.3g}"]
    return dict(zip(COLUMNS, map(str, cells), strict=True))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--points", type=int, nargs="+", default=[1000, 3000, 10_000, 80_000])
    parser.add_argument("--tol", type=float, nargs="+", default=[1e-2, 1e-4, 1e-6, 1e-8, 1e-10])
    parser.add_argument("--sets", nargs="+", default=["cube", "sphere", "clustered"])
    parser.add_argument("--rows", type=Path, default=Path("outputs/auto.json"))
    parser.add_argument("--output", type=Path, help="a file; the terminal by default")
    options = parser.parse_args()
    numba.set_num_threads(1)
    rows, found = Rows(options.rows), []
    by_difficulty = sorted(options.points), sorted(options.sets), sorted(options.tol, reverse=True)
    for n, points, tol in product(*by_difficulty):
        case = {"points": points, "n": n, "tol": tol}
        row = rows.find(compare, case)
        if row is None:
            row = rows.measure(compare, case)
            print(*row.values(), file=sys.stderr, flush=True)
        found.append(row)
    lines = [
        '# Backend "auto" beside the best of each backend\n',
        *__doc__.split("\n\n")[2].splitlines(),
        "`ratio` is the time of `auto` over the smallest of the four before it. `first` is its",
        "first sum, with the probe at a few targets and the sampled error.\n",
        machine_today() + ".\n",
        *markdown.table(COLUMNS, ([row[name] for name in COLUMNS] for row in found)),
        f"\nLargest ratio: {max(float(row['ratio']) for row in found):.2f}.",
    ]
    publish(lines, options.output)


if __name__ == "__main__":
    main()
