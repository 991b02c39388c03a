"""Our error beside the error that the papers print, at the papers' parameters, as Markdown.

    python -m benchmarks.papers [--quick] [--only k1 t1] [--figures] [--output FILE]

"K" is Wang, Krasny and Tlupova (2020), "T" is Wang, Tlupova and Krasny (2019).
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterable, Iterator
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import numpy as np

import treecode as tc
from benchmarks import point_sets, printed
from benchmarks.methods import KITC, TAYLOR
from benchmarks.sums import Problem
from benchmarks.tables import error
from mrs import markdown

TITLES = {
    "k1": "K table 1: organisms in a cube, eps = 0.02",
    "k3": "K table 3: organisms of length eps, N = 640K",
    "k5": "K table 5 and figure 5a: rods, eps = 0.3 (printed for 80 x 80 only, else plotted)",
    "t1": "T table 1: Stokeslets and stresslets on a sphere",
    "t3": "T table 3: Stokeslets in a cube",
    "k2": "K figure 2: organisms in a cube, N = 640K (plotted, not printed)",
    "k3a": "K figure 3a: organisms in a cube (plotted, not printed)",
}
FIGURES = ("k2", "k3a")
LIMIT, QUICK_LIMIT = 1_000_000, 82_000  # most points; quick keeps "80K": 80,000 and 81,920
HEADER = (
    "set", "N", "targets", "theta", "degree", "printed", "E", "ratio", "E, no self", "ratio",
    "near/target", "far/target",
)  # fmt: skip


class Row(NamedTuple):
    """One line of a table."""

    label: str
    problem: Problem
    backend: str
    theta: float
    degree: int
    leaf_size: int
    printed: float | None

    def cells(self) -> list[str]:
        """Sum, and return the cells of the line."""
        problem, exact, own = self.problem, self.problem.exact, self.problem.self_terms
        options = {"theta": self.theta, "degree": self.degree, "leaf_size": self.leaf_size}
        plan = tc.Plan(problem.kernel, self.backend, **options)
        values = plan.set_points(problem.points, problem.targets).execute(problem.strengths)
        ours = tc.relative_error(values, exact)
        without = tc.relative_error(values - own, exact - own) if own.any() else None
        count, drawn = len(problem.points), len(problem.rows)
        cells = [self.label, f"{count:,}", "all" if drawn == count else f"{drawn:,} sampled"]
        cells += [f"{self.theta:g}", str(self.degree), error(self.printed)]
        cells += [error(ours), ratio(ours, self.printed)]
        cells += [error(without), ratio(without, self.printed)]
        return cells + [f"{plan.info()[key] / drawn:,.0f}" for key in ("near_pairs", "far_pairs")]


def ratio(value: float | None, printed: float | None) -> str:
    """Return ours over printed, with a star where they differ by more than a factor of two."""
    if value is None or printed is None:
        return ""
    quotient = value / printed
    return f"{quotient:.2f}" + ("" if 0.5 <= quotient <= 2.0 else " *")


class Tables:
    """Each method yields the rows of the table of its name."""

    def __init__(self, limit: int, samples: int, seed: int) -> None:
        self.limit = limit
        self.samples = samples
        self.seed = seed

    def problem(self, kernel: tc.Kernel, points: np.ndarray, strengths: np.ndarray) -> Problem:
        rows = np.random.default_rng(self.seed + 1).permutation(len(points))[: self.samples]
        return Problem(kernel, points, strengths, rows)

    def organisms(self, n: int, epsilon: float, octant: bool, shuffle: bool = False) -> Problem:
        """Return K example 1 with the length of the organisms equal to epsilon.

        `shuffle` gives every force to some other particle. The published program
        (Treecodes/stokes-treecode, code_RegStokes_BLTC_case_1.cpp) does so by sorting the
        particles into the tree and not their strengths: force k then acts at the particle that
        the sort puts at place k. Which one that is depends on the order of a file of points that
        is not published, so a random permutation stands for it. It tears the pairs apart. The
        printed errors are not errors of torn pairs: at 10K they are far smaller.
        """
        points, forces = point_sets.organisms(n, epsilon, self.seed, octant=octant)
        if shuffle:
            forces = np.random.default_rng(self.seed + 2).permutation(forces)
        return self.problem(tc.RegularizedStokeslet(epsilon), points, forces)

    def k1(self) -> Iterator[Row]:
        for n, theirs in printed.K1.items():
            for octant in (False, True) if n <= self.limit else ():
                for shuffle in (False, True):
                    label = "one octant" if octant else "isotropic"
                    label += ", shuffled" if shuffle else ""
                    problem = self.organisms(n, 0.02, octant, shuffle)
                    yield Row(label, problem, KITC, 0.7, 7, 2000, theirs.error)

    def k3(self) -> Iterator[Row]:
        for epsilon, theirs in printed.K3.items() if self.limit >= 640_000 else ():
            for octant in (False, True):
                label = f"eps {epsilon:g}, " + ("one octant" if octant else "isotropic")
                problem = self.organisms(640_000, epsilon, octant)
                yield Row(label, problem, KITC, 0.7, 7, 2000, theirs)

    def k5(self) -> Iterator[Row]:
        for side in (15, 20, 30, 40, 60, 80):
            if side**2 * point_sets.ROD_POINTS <= self.limit:
                kernel = tc.RegularizedStokesletRotlet(0.3)
                problem = self.problem(kernel, *point_sets.rods(side, self.seed))
                theirs = printed.K5.get(side)
                their_error = theirs.error if theirs else None
                yield Row(f"{side} x {side}", problem, KITC, 0.7, 7, 1000, their_error)

    def t1(self) -> Iterator[Row]:
        for level in (6, 7):
            for outward in (True, False) if 20 * 4**level <= self.limit else ():
                points, strengths = point_sets.sphere(level, self.seed, outward=outward)
                problem = self.problem(tc.StokesletStresslet(), points, strengths)
                label = "nu outward" if outward else "nu shuffled"
                yield from self.taylor(level, label, problem)

    def t3(self) -> Iterator[Row]:
        if self.limit >= 125_000:
            problem = self.problem(tc.Stokeslet(), *point_sets.cube(125_000, self.seed))
            yield from self.taylor(125_000, "cube", problem)

    def taylor(self, size: int, label: str, problem: Problem) -> Iterator[Row]:
        for theta in (0.2, 0.5, 0.8):
            for order in printed.ORDERS:
                theirs = printed.taylor(size, theta, order)[1]
                yield Row(label, problem, TAYLOR, theta, order, 2000, theirs)

    def k2(self) -> Iterator[Row]:
        if self.limit >= 640_000:
            problem = self.organisms(640_000, 0.02, octant=True)
            for theta in (0.4, 0.5, 0.6, 0.7, 0.8):
                for degree in range(1, 11):
                    yield Row("one octant", problem, KITC, theta, degree, 2000, None)

    def k3a(self) -> Iterator[Row]:
        for n in printed.K1:
            if n <= self.limit:
                problem = self.organisms(n, 0.02, octant=True)
                for degree in (1, 3, 5, 7, 9):
                    yield Row("one octant", problem, KITC, 0.7, degree, 2000, None)

    def sampling(self) -> float:
        """Return the relative difference of values at sampled targets from values of a full run."""
        problem = self.organisms(10_000, 0.02, octant=True)
        options = {"theta": 0.7, "degree": 7, "leaf_size": 2000}
        plan = tc.Plan(problem.kernel, KITC, **options)
        full = plan.set_points(problem.points).execute(problem.strengths)[problem.rows]
        sampled = plan.set_points(problem.points, problem.targets).execute(problem.strengths)
        return float(np.abs(full - sampled).max() / np.abs(full).max())


def notes(tables: Tables) -> Iterator[str]:
    """Yield the notes at the head of the page."""
    yield "# Errors beside the printed ones"
    yield ""
    yield f"Points have seed {tables.seed}. E is K eq. (8.1), at {tables.samples:,} random targets"
    yield "at most. A target decides for itself which clusters are far, so that its value does not"
    yield "depend on the other targets: the largest relative difference to a full run at N = 10K is"
    yield f"{tables.sampling():.1e}."
    yield ""
    yield '"No self" leaves the term j = i out of both sums, as the published program does. This'
    yield "changes the norm only. Regularized sums include the term, singular ones never do. A"
    yield "ratio is ours over the printed one, with a star outside [0.5, 2]. Pairs are for each"
    yield "target. A near pair is a target and a source, a far pair a target and a term of an"
    yield "expansion."
    yield ""
    yield 'Organisms have isotropic directions, or directions from [0, 1]^3, normalised ("one'
    yield 'octant"). "Shuffled" gives the forces to other particles. On the sphere normals are'
    yield "outward, or given to other particles. See benchmarks/point_sets.py."


def summed(name: str, rows: Iterable[Row]) -> Iterator[list[str]]:
    """Yield the cells of rows, and tell how it is going."""
    start = time.perf_counter()
    for count, row in enumerate(rows, 1):
        yield row.cells()
        seconds = time.perf_counter() - start
        print(f"{name}: {count} rows, {seconds:.0f} s", file=sys.stderr, flush=True)


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="+", choices=TITLES, metavar="NAME", help=", ".join(TITLES))
    parser.add_argument("--figures", action="store_true", help=f"add {', '.join(FIGURES)}")
    parser.add_argument("--quick", action="store_true", help=f"at most {QUICK_LIMIT:,} points")
    parser.add_argument("--limit", type=int, default=LIMIT, help="most points (%(default)s)")
    parser.add_argument("--samples", type=int, default=2000, help="most targets (%(default)s)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--output", type=Path, help="also write the tables to this file")
    return parser.parse_args()


def main() -> None:
    options = parse()
    limit = min(options.limit, QUICK_LIMIT) if options.quick else options.limit
    tables = Tables(limit, options.samples, options.seed)
    names = options.only or [name for name in TITLES if options.figures or name not in FIGURES]
    output = options.output.open("w", encoding="utf-8") if options.output else None

    def write(line: str) -> None:
        for file in (sys.stdout, output):
            if file:
                print(line, file=file, flush=True)

    for line in notes(tables):
        write(line)
    for name in names:
        write(f"\n## {TITLES[name]}\n")
        rows = getattr(tables, name)()
        first = next(rows, None)
        if first is None:
            write(f"All of it is beyond {limit:,} points.")
            continue
        for line in markdown.table(HEADER, summed(name, chain([first], rows))):
            write(line)


if __name__ == "__main__":
    main()
