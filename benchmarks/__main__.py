"""Measure, and write a page with a table and a picture for each experiment.

    python -m benchmarks [NAME ...] [--quick] [--draw] [--output FOLDER]

Measurements stay in FOLDER/rows.json. A run can be stopped at any time, and the next one continues:
rows that are there for this machine and these versions are not measured again.
"""

from __future__ import annotations

import argparse
import inspect
import sys
import time
from pathlib import Path
from types import ModuleType

from threadpoolctl import threadpool_limits

from benchmarks import sums
from benchmarks.experiments import ALL
from benchmarks.rows import Row, Rows

FULL, QUICK = Path("docs/benchmarks"), Path("outputs/benchmarks")


def find(experiment: ModuleType, rows: Rows, quick: bool, anywhere: bool) -> list[Row]:
    """Return the rows of an experiment that are there."""
    cases = experiment.cases(quick)
    found = [rows.find(experiment.measure, case, anywhere=anywhere) for case in cases]
    return [row for row in found if row is not None]


def measure(name: str, experiment: ModuleType, rows: Rows, quick: bool) -> None:
    """Measure the rows of an experiment that are not there."""
    cases = list(filter(sums.can_measure, experiment.cases(quick)))
    for i, case in enumerate(cases, 1):
        if rows.find(experiment.measure, case) is None:
            what = ", ".join(f"{key} {value}" for key, value in case.items())
            print(f"{name} {i} of {len(cases)}: {what}", end="", file=sys.stderr, flush=True)
            start = time.perf_counter()
            rows.measure(experiment.measure, case)
            print(f": {time.perf_counter() - start:.1f} s", file=sys.stderr, flush=True)


def write(name: str, experiment: ModuleType, rows: list[Row], folder: Path) -> None:
    """Write the page of an experiment, and its picture if matplotlib is installed."""
    title, _, text = inspect.cleandoc(experiment.__doc__ or "").partition("\n")
    machines = dict.fromkeys(row["machine"] for row in rows)
    dates = sorted({row["date"] for row in rows})
    when = dates[0] if len(dates) == 1 else f"{dates[0]} to {dates[-1]}"
    parts = [f"# {title}", text.strip(), *(f"{machine}; {when}." for machine in machines)]
    if draw(experiment, rows, folder / f"{name}.png"):
        parts.append(f"![{title}]({name}.png)")
    parts.append("\n".join(experiment.table(rows)))
    (folder / f"{name}.md").write_text("\n\n".join(parts) + "\n")


def draw(experiment: ModuleType, rows: list[Row], path: Path) -> bool:
    """Draw the picture of an experiment; return whether matplotlib is there to do it."""
    try:
        from matplotlib.figure import Figure
    except ImportError:
        print('no pictures: python -m pip install ".[benchmark]"', file=sys.stderr)
        return False
    figure = Figure(layout="constrained", dpi=110)
    experiment.plot(rows, figure)
    figure.savefig(path)
    return True


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks", description="Measure; write tables and pictures."
    )
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(ALL)}")
    parser.add_argument("--quick", action="store_true", help="few points, to see that it works")
    parser.add_argument("--draw", action="store_true", help="only draw earlier measurements")
    parser.add_argument("--output", type=Path, help=f"a folder; {FULL}, or {QUICK} with --quick")
    options = parser.parse_args(arguments)
    unknown = [name for name in options.names if name not in ALL]
    if unknown:
        parser.error(f"NAME must be one of {', '.join(ALL)}, got {', '.join(unknown)}")
    folder = options.output or (QUICK if options.quick else FULL)
    rows = Rows(folder / "rows.json")
    for name in options.names or ALL:
        experiment = ALL[name]
        if not options.draw:
            with threadpool_limits(1):  # of BLAS; the experiment sets the threads of the sums
                measure(name, experiment, rows, options.quick)
        found = find(experiment, rows, options.quick, anywhere=options.draw)
        if found:
            write(name, experiment, found, folder)


if __name__ == "__main__":
    main()
