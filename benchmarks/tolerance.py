"""Errors achieved beside those asked for, of random sums: the cases of tests/cases/tolerance.py.

    python -m benchmarks.tolerance [--cases 500] [--largest 200000] [--output FILE]
    python -m benchmarks.tolerance --apart [--cases 100] [--largest 20000] [--output FILE]

The second is of targets apart from their sources, the cases of tests/cases/apart.py. Every case is
kept in --rows, so that the command goes on where it ended. Each processor has a case at a time, on
one thread.
"""

from __future__ import annotations

import argparse
import multiprocessing
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

import numba
import numpy as np
from tqdm import tqdm

from benchmarks.machine import machine_today, publish
from benchmarks.rows import Row, Rows
from mrs import markdown
from tests.cases import apart, tolerance

PROMISE = """## The promise of a tolerance

`tol`, and `tolerance` of a simulation's backend, is the relative error in the Euclidean norm (K eq.
8.1), |u - exact| / |exact|, over the targets of each group, separately for each unit of the values:
velocities have one, angular velocities another. `Plan.set_points(sources, targets, groups)` takes
the groups; by default all targets are one group. It does not bound the error of each target: a
value that is small beside the others of its group may be off by more.

* The first `execute` chooses a sum and samples its error, as a mean square and two of its standard
  deviations, at 400 targets, or 50 of each group. A sum that misses is done again, more accurately.
* Every later `execute` as long as ten million pairs looks at up to 16 targets, three at least of a
  group. If all but the worst of a group are off by twice `tol`, the error is sampled and, if it is
  too large, another sum chosen. Shorter sums are not watched: `refine` samples them.
* A tolerance that cannot be kept raises a `ToleranceError`; if direct sums in doubles cannot keep
  it either, a `CancellationError`.
* With parameters by hand (`degree`) nothing is sampled: `estimate_error` returns the error. "fmm"
  with a degree aims at `tol`.
* In a simulation groups are bodies. The tolerance is for the total over all blob sizes, forces and
  torques. A sum that is cancelled by others gets a smaller tolerance by as much, at the first
  evaluation and every 50 steps. Bodies without forces have sums of their own. `Simulation.velocity`
  and `mrs field` choose for the given points. If not even direct sums keep the tolerance, direct
  sums are used.

## Measured
"""

HEADER = "class", "", "cases", "within", "largest error / asked", "median"

CLASSES: dict[str, Callable[[Row], str]] = {
    "kernel": lambda row: row["kernel"],
    "points": lambda row: row["points"],
    "strengths": lambda row: row["strengths"],
    "N": lambda row: f"up to 1e{len(str(row['n']))}",
    "asked": lambda row: f"from {10.0 ** np.floor(np.log10(row['tol'])):.0e}",
    "done by": lambda row: row["choice"].partition("(")[0],
}

APART: dict[str, Callable[[Row], str]] = {
    **{name: CLASSES[name] for name in ("kernel", "points", "strengths", "asked", "done by")},
    "targets": lambda row: row["place"],
    "groups": lambda row: "two" if row["grouped"] else "one",
    "backend": lambda row: row["backend"],
}


def solve(seed: int, largest: int) -> Row:
    """Return one case, the choice for it, and the error."""
    numba.set_num_threads(1)
    case = tolerance.Case.draw(seed, largest)
    start = time.perf_counter()
    error, plan = tolerance.solve(case)
    seconds = time.perf_counter() - start
    return case._asdict() | {"choice": str(plan.choice), "error": error, "seconds": seconds}


def solve_apart(seed: int, largest: int) -> Row:
    """Return one case of targets apart, the choice for it, and the error."""
    numba.set_num_threads(1)
    case = apart.Apart.draw(seed, 1000, largest)
    start = time.perf_counter()
    error, choice = apart.solve(case)
    seconds = time.perf_counter() - start
    return case._asdict() | {"choice": choice, "error": error, "seconds": seconds}


def summary(rows: list[Row], classes: dict[str, Callable[[Row], str]]) -> Iterator[list[str]]:
    """Yield the cells of a line for each class of cases."""
    for title, classify in {"all": lambda row: "", **classes}.items():
        for name in sorted({classify(row) for row in rows}):
            ratios = [row["error"] / row["tol"] for row in rows if classify(row) == name]
            within = np.mean(np.array(ratios) <= 1.0)
            cells = [title, name, str(len(ratios)), f"{within:.1%}", f"{max(ratios):.2f}"]
            yield [*cells, f"{np.median(ratios):.2g}"]


def about(count: int, largest: int) -> list[str]:
    return [
        "# Asked and achieved errors\n",
        PROMISE,
        f"{count} random sums by `Plan(kernel, tol=...)`: kernels, sets of 10 to",
        f"{largest} points, strengths that are random, without a net force, or pairs that",
        "push against each other, and tolerances from 1e-10 to 1e-2. Errors, K eq. (8.1), by the",
        "oracle of the tests or, where that is too slow, by direct sums at 2000 targets, over the",
        "norm of all values.\n",
    ]


def about_apart(count: int, largest: int) -> list[str]:
    return [
        "# Asked and achieved errors at targets apart from the sources\n",
        f"{count} random sums of 1000 to {largest} sources at 100 to 1000 targets: among the",
        "sources, and 1, 30 and 10,000 of their widths away; half of them with two groups, of",
        "which one stays among the sources. By `Plan(kernel, tol=...)` and by",
        '`Plan(kernel, "fmm", tol=...)`. Errors, K eq. (8.1), are the largest of groups and of',
        "velocities and angular velocities, by the oracle of the tests or, where that is too slow,",
        "by direct sums. A sum that ends in `ToleranceError` counts as kept, done by 'refused'.\n",
    ]


def solve_missing(rows: Rows, solve_one: Callable[..., Row], cases: list[Row]) -> None:
    """Solve the cases that have no row, one on each processor at a time."""
    missing = [case for case in cases if rows.find(solve_one, case) is None]
    with ProcessPoolExecutor(mp_context=multiprocessing.get_context("spawn")) as pool:
        solved = {pool.submit(solve_one, **case): case for case in missing}
        for future in tqdm(as_completed(solved), total=len(missing), unit="case"):
            row = future.result()
            rows.keep(solve_one, solved[future], row)
            if row["error"] > row["tol"]:
                print(row, file=sys.stderr, flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--apart", action="store_true", help="targets apart from the sources")
    parser.add_argument("--cases", type=int)
    parser.add_argument("--largest", type=int, help="number of points")
    parser.add_argument("--rows", type=Path)
    parser.add_argument("--output", type=Path, help="a file; the terminal by default")
    options = parser.parse_args()
    count = options.cases or (100 if options.apart else 500)
    largest = options.largest or (20_000 if options.apart else 200_000)
    name = "tolerance-apart" if options.apart else "tolerance"
    rows = Rows(options.rows or Path(f"outputs/{name}.json"))
    cases = [{"seed": seed, "largest": largest} for seed in range(count)]
    one = solve_apart if options.apart else solve
    solve_missing(rows, one, cases)
    done = [row for case in cases if (row := rows.find(one, case)) is not None]
    head = about_apart(count, largest) if options.apart else about(count, largest)
    lines = [*head, machine_today() + ".\n"]
    lines += markdown.table(HEADER, summary(done, APART if options.apart else CLASSES))
    publish(lines, options.output)


if __name__ == "__main__":
    main()
