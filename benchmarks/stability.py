"""Extreme cases, the numbers found, and their bounds: the cases of tests/cases/stability.

python -m benchmarks.stability [--quick] [--output FILE]
"""

from __future__ import annotations

import argparse
import inspect
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from benchmarks.machine import machine_today, publish
from mrs import markdown
from tests.cases.stability import CASES
from tests.cases.stability.findings import Case
from tests.cases.stability.sums import THETA


def section(case: Case, explained: bool) -> Iterator[str]:
    """Yield the lines of one case; cases of one function are `explained` once."""
    start = time.perf_counter()
    findings = case.findings()
    print(f"{case.name}: {time.perf_counter() - start:.0f} s", file=sys.stderr, flush=True)
    yield f"\n## {case.heading}\n"
    if not explained:
        yield inspect.cleandoc(case.function.__doc__ or "") + "\n"
    rows = ([*f.cells(), *([] if f.holds() else ["**out of bounds**"])] for f in findings)
    yield from markdown.table(["asked", "found", "bound"], rows)


def main() -> None:
    parser = argparse.ArgumentParser(description="Ask at the limits; print a table for each case.")
    parser.add_argument("--quick", action="store_true", help="leave out cases that take minutes")
    parser.add_argument("--output", type=Path, help="a file; the terminal by default")
    options = parser.parse_args()
    lines = [
        "# Stability\n",
        "Each case asks for something at a limit. The tables have the number that was found, and",
        "its bound. A rounding is 2^-53. Theta is",
        f"{THETA} where no other is named.\n",
        f"{machine_today()}.",
    ]
    functions = []
    for case in CASES:
        if not (options.quick and case.slow):
            lines += section(case, case.function in functions)
            functions.append(case.function)
    publish(lines, options.output)


if __name__ == "__main__":
    main()
