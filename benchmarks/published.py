"""The papers' own programs beside ours: the same points, in turns, one thread.

    git clone https://github.com/Treecodes/stokes-treecode
    python -m benchmarks.published stokes-treecode [--turns 1] [--output FILE]

The sums are K example 1 (theta 0.7, n = 7) and T example 2 (theta 0.5, p = 6), with N0 = 2000.
Ours are also made with the parameters that keep E below the 3.17e-5 that K prints. The command
needs g++. It sets constants of their programs, and lets them end before their direct sum. Their
seconds are those that they print. Their programs sort the points but not the forces, and leave
out the self term. E is K eq. (8.1) at 2000 targets, against direct sums that do the same.
"""

from __future__ import annotations

import argparse
import inspect
import re
import subprocess
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numba
import numpy as np

import treecode as tc
from benchmarks import sums
from benchmarks.machine import machine_today, publish
from benchmarks.methods import KITC, TAYLOR
from benchmarks.point_sets import CUBE_DENSITY, CUBE_SIDE
from mrs import markdown

LEAF_SIZE = 2000
HEADER = "sum", "N", "program", "s", "E", "over the first"
# In place of their direct sum: writes their values and their order.
END = """
    FILE *out = fopen("values", "wb");
    fwrite(particles.old_index, sizeof(size_t), N_cube, out);
    fwrite(velo, sizeof(vec_3d), N_cube, out);
    fclose(out);
    return 0;
"""


@dataclass
class Published:
    """A program of theirs and the sum that it does.

    Attributes
    ----------
    source : str
        Its file.
    case : dict
        Of `sums.Sum`, for ours.
    constants : dict
        Of theirs, by name.
    ours : list of dict
        Of ours, the options that differ from `case`.
    origin : tuple
        Of our points in their coordinates.
    factor : float
        Their values times this are ours.
    """

    source: str
    case: dict[str, Any]
    constants: dict[str, float]
    ours: list[dict[str, Any]]
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    factor: float = 1.0

    def build(self, code: Path, folder: Path, flags: list[str]) -> Path:
        """Return their program, compiled."""
        text = (code / self.source).read_text()
        n = self.case["size"]
        constants = {"N": n, "N_cube": n, "N0": LEAF_SIZE, "P": self.case["degree"]}
        constants |= {"sq_theta": self.case["theta"] ** 2, **self.constants}
        for name, value in constants.items():
            declared = rf"(static const (?:int|double) {name}\s*=)[^;]*;"
            text = re.sub(declared, rf"\g<1> {value!r};", text)
        start, mark, _ = text.partition("//***************** Director summation")
        if not mark:
            raise ValueError(f"{self.source} has no direct sum to end before")
        source, program = folder / "program.cpp", folder / f"program{''.join(flags)}"
        source.write_text(start + END + "}\n")
        command = ["g++", *flags, "-w", "-include", "ctime", str(source), "-o", str(program)]
        subprocess.run(command, check=True)
        return program

    def write_points(self, problem: sums.Problem, folder: Path) -> None:
        """Write points and forces where their program reads them."""
        (folder / "data").symlink_to(folder)  # one of them looks there
        n = len(problem.points)
        np.savetxt(folder / f"rand_{n}.txt", problem.points + self.origin, fmt="%.17g")
        np.savetxt(folder / f"lambda_{n}.txt", problem.strengths, fmt="%.17g")

    def run(self, program: Path, problem: sums.Problem) -> tuple[float, float]:
        """Return their seconds and their error."""
        done = subprocess.run(
            [program], cwd=program.parent, check=True, capture_output=True, text=True
        )
        ticks = re.search(r"treecode_cpu_time (\d+)", done.stdout)
        if ticks is None:
            raise ValueError(f"{self.source} printed no time: {done.stdout}")
        n, rows = len(problem.points), problem.rows
        raw = (program.parent / "values").read_bytes()
        points = problem.points[np.frombuffer(raw, np.uint64, n)]
        values = self.factor * np.frombuffer(raw, np.float64, 3 * n, 8 * n).reshape(n, 3)
        theirs = sums.Problem(problem.kernel, points, problem.strengths, rows)
        error = tc.relative_error(values[rows], theirs.exact - theirs.self_terms)
        return int(ticks[1]) / 100.0, error  # of times(2)


def programs(points: int) -> dict[str, Published]:
    """Return their programs by our backend."""
    half, n = 0.5 * CUBE_SIDE, points
    precisions = [{"precision": bits} for bits in ("float32", "float64")]
    below = {"theta": 0.62, "degree": 6, "precision": "float32"}
    organisms = {"points": "organisms", "size": n, "epsilon": 0.02, "theta": 0.7, "degree": 7}
    cube = {"points": "cube", "size": n, "theta": 0.5, "degree": 6}
    return {
        KITC: Published(
            "code_RegStokes_BLTC_case_1.cpp",
            organisms,
            {"DEL": 0.02},
            [*precisions, below],
            (-half, -half, 0.0),
            1.0 / (8.0 * np.pi),
        ),
        TAYLOR: Published(
            "code_SingStokes_TTC_case_1.cpp",
            cube,
            {"L": (n / CUBE_DENSITY) ** (1.0 / 3.0)},
            precisions,
        ),
    }


def compare(
    backend: str, published: Published, code: Path, flags: list[list[str]], turns: int
) -> Iterator[list[str]]:
    """Yield the cells of a row for each program, ours first."""
    ours = [
        sums.Sum(backend=backend, leaf_size=LEAF_SIZE, **published.case | options)
        for options in published.ours
    ]
    names = [f"treecode, {run.plan.choice}" for run in ours] + [" ".join(flag) for flag in flags]
    rows: list[list[tuple[float, float | None]]] = [[] for _ in names]
    problem = ours[0].problem
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        published.write_points(problem, folder)
        theirs = [published.build(code, folder, flag) for flag in flags]
        for _ in range(turns):
            for row, run in zip(rows, ours, strict=False):
                row.append((sum(run.lap()), run.error()))
            for row, program in zip(rows[len(ours) :], theirs, strict=True):
                row.append(published.run(program, problem))
    n = len(problem.points)
    for title, row in zip(names, rows, strict=True):
        seconds = np.array([seconds for seconds, _ in row])
        ratio = np.median(seconds / np.array([s for s, _ in rows[0]]))
        cells = [backend, f"{n:,}", title, f"{np.median(seconds):.3g}", f"{row[-1][1]:.2e}"]
        yield [*cells, f"{ratio:.2f}"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("code", type=Path, help="a clone of their programs")
    parser.add_argument("--sums", nargs="+", choices=(KITC, TAYLOR), default=[KITC, TAYLOR])
    parser.add_argument("--points", type=int, help="640,000 and 1,000,000 by default, as they have")
    parser.add_argument("--flags", nargs="+", default=["-O2", "-O3 -march=native -ffast-math"])
    parser.add_argument("--turns", type=int, default=1)
    parser.add_argument("--output", type=Path, help="a file; the terminal by default")
    options = parser.parse_args()
    numba.set_num_threads(1)
    title, _, *explained = inspect.cleandoc(__doc__ or "").split("\n\n")
    lines = [f"# {title.rstrip('.')}\n", *explained]
    lines.append(f"\n{machine_today()}; medians of {options.turns} turns.\n")
    flags = [flag.split() for flag in options.flags]
    rows: list[list[str]] = []
    for backend in options.sums:
        points = options.points or {KITC: 640_000, TAYLOR: 1_000_000}[backend]
        published = programs(points)[backend]
        rows += compare(backend, published, options.code, flags, options.turns)
    lines += markdown.table(HEADER, rows)
    publish(lines, options.output)


if __name__ == "__main__":
    main()
