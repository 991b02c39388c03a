"""Errors achieved beside those asked for, of random sums: the cases of tests/cases/tolerance.py.

    python -m benchmarks.tolerance [--cases 500] [--largest 200000] [--output FILE]

Every case is kept in --rows, so that the command goes on where it ended. Each processor has a case
at a time, on one thread.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

import numba
import numpy as np
from tqdm import tqdm

from benchmarks.machine import machine_today, publish
from tests.cases import tolerance

CLASSES: dict[str, Callable[[dict[str, Any]], str]] = {
    "kernel": lambda row: row["kernel"],
    "points": lambda row: row["points"],
    "strengths": lambda row: row["strengths"],
    "N": lambda row: f"up to 1e{len(str(row['n']))}",
    "asked": lambda row: f"from {10.0 ** np.floor(np.log10(row['tol'])):.0e}",
    "done by": lambda row: row["choice"].partition("(")[0],
}


def solve(seed: int, largest: int) -> dict[str, Any]:
    """Return one case, what was chosen for it, and the error."""
    numba.set_num_threads(1)
    case = tolerance.Case.draw(seed, largest)
    start = time.perf_counter()
    error, plan = tolerance.solve(case)
    seconds = time.perf_counter() - start
    return case._asdict() | {"choice": str(plan.choice), "error": error, "seconds": seconds}


def table(rows: list[dict[str, Any]]) -> list[str]:
    """Return the lines of the table."""
    lines = ["| class | | cases | within | largest error / asked | median |", "|---" * 6 + "|"]
    for title, classify in {"all": lambda row: "", **CLASSES}.items():
        for name in sorted({classify(row) for row in rows}):
            ratios = [row["error"] / row["tol"] for row in rows if classify(row) == name]
            within = np.mean(np.array(ratios) <= 1.0)
            lines.append(
                f"| {title} | {name} | {len(ratios)} | {within:.1%} | {max(ratios):.2f} | "
                f"{np.median(ratios):.2g} |"
            )
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=500)
    parser.add_argument("--largest", type=int, default=200_000, help="number of points")
    parser.add_argument("--rows", type=Path, default=Path("outputs/tolerance.jsonl"))
    parser.add_argument("--output", type=Path, help="a file; the terminal by default")
    options = parser.parse_args()
    kept = options.rows.read_text().splitlines() if options.rows.exists() else []
    rows = {row["seed"]: row for row in map(json.loads, kept)}
    missing = [seed for seed in range(options.cases) if seed not in rows]
    with ProcessPoolExecutor(mp_context=multiprocessing.get_context("spawn")) as pool:
        solved = [pool.submit(solve, seed, options.largest) for seed in missing]
        for future in tqdm(as_completed(solved), total=len(missing), unit="case"):
            row = future.result()
            rows[row["seed"]] = row
            with options.rows.open("a") as file:
                file.write(json.dumps(row) + "\n")
            if row["error"] > row["tol"]:
                print(row, file=sys.stderr, flush=True)
    lines = [
        "# Asked and achieved errors\n",
        f"{len(rows)} random sums by `Plan(kernel, tol=...)`: kernels, sets of 10 to",
        f"{options.largest} points, strengths that are random, without a net force, or pairs that",
        "push against each other, and tolerances from 1e-10 to 1e-2. Errors, K eq. (8.1), by the",
        "oracle of the tests or, where that is too slow, by direct sums at 2000 targets, over the",
        "norm of all values.\n",
        machine_today() + ".\n",
        *table(list(rows.values())),
    ]
    publish(lines, options.output)


if __name__ == "__main__":
    main()
