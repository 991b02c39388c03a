"""Fit the model of cost and error by which backend "auto" chooses, treecode/costs.json.

    python -m benchmarks.fit_costs [--kernels Stokeslet ...] [--output treecode/costs.json]

Random strengths in a cube and in clumps, one thread. Processor time, the least of several runs, is
fitted by non-negative least squares of relative deviations, errors by lines in degree and digits.
Operators of the fast multipole method are built in an empty folder, to see what that takes.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numba
import numpy as np
from scipy.optimize import nnls

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from test_tolerance import SETS

import treecode as tc
from treecode import auto
from treecode.fmm import multipole, store

KERNELS = {
    "RegularizedStokeslet": tc.RegularizedStokeslet(epsilon=0.01),
    "RegularizedStokesletRotlet": tc.RegularizedStokesletRotlet(epsilon=0.05),
    "Stokeslet": tc.Stokeslet(),
    "StokesletStresslet": tc.StokesletStresslet(),
}
SIZES = 4000, 24_000
DEGREES = {"kitc": (2, 4, 6, 8), "taylor": (2, 5, 8, 12)}
TOLERANCES = [10.0**-k for k in (1, 2, 3, 4, 5, 6, 8)]
ENOUGH = 0.5  # seconds of laps
LONGEST = 20.0  # seconds to build operators, after which smaller tolerances are left out


def fit(work: list[Any], seconds: list[float]) -> list[float]:
    """Return non-negative rates by least squares of relative deviations."""
    matrix = np.array(work, float) / np.array(seconds)[:, None]
    scale = np.abs(matrix).max(axis=0)
    rates, _ = nnls(matrix / np.where(scale > 0.0, scale, 1.0), np.ones(len(seconds)))
    rates /= np.where(scale > 0.0, scale, 1.0)
    off = np.abs(matrix @ rates - 1.0)
    print(f"    {len(seconds)} runs, deviations {np.median(off):.0%}, at most {off.max():.0%}")
    return [float(f"{rate:.3g}") for rate in rates]


def line(x: list[float], y: list[float]) -> list[float]:
    """Return offset and slope."""
    slope, offset = np.polyfit(x, y, 1)
    return [round(float(offset), 3), round(float(slope), 4)]


class Case:
    """One kernel on one set of points."""

    def __init__(self, kernel: tc.Kernel, name: str, n: int) -> None:
        self.kernel, self.points = kernel, SETS[name](n, np.random.default_rng(0))
        self.strengths = np.random.default_rng(1).standard_normal((n, kernel.strength_size))
        self.exact, self.direct_seconds, _ = self.run("direct")
        self.probe = self.run("kitc", **auto.PROBE)[0]

    def run(self, backend: str, **options: Any) -> tuple[Any, float, tc.Plan]:
        """Return the error (of "direct" the values), seconds and the plan."""
        plan = tc.Plan(self.kernel, backend, **options).set_points(self.points)
        values = plan.execute(self.strengths)
        laps: list[float] = []
        while len(laps) < 2 or (len(laps) < 10 and sum(laps) < ENOUGH):
            start = time.process_time()
            plan.set_points(self.points).execute(self.strengths)
            laps.append(time.process_time() - start)
        if backend == "direct":
            return values, min(laps), plan
        return tc.relative_error(values, self.exact), min(laps), plan


def treecodes(cases: list[Case], backend: str) -> dict[str, Any]:
    """Return the model of a treecode."""
    work, seconds, offsets, slopes = [], [], [], []
    for theta in auto.THETAS:
        degrees, digits = [], []
        for case in cases:
            for i, degree in enumerate(DEGREES[backend]):
                leaf_size = auto.LEAF_SIZES[i % 3]
                error, time_taken, plan = case.run(
                    backend, theta=theta, degree=degree, leaf_size=leaf_size
                )
                info, n = plan.info(), len(case.points)
                terms = int(auto.count_terms(backend, np.array(degree)))
                far = info["far_pairs"]
                work.append([info["near_pairs"], far, far / terms, n * terms, 2 * n])
                seconds.append(time_taken)
                if far and error > 1e-12:
                    degrees.append(degree)
                    digits.append(math.log10(error / case.probe))
        offset, slope = line(degrees, digits)
        offsets.append(offset)
        slopes.append(slope)
    return {"seconds": fit(work, seconds), "offset": offsets, "slope": slopes}


def fast_multipole(cases: list[Case]) -> dict[str, Any]:
    """Return the model of the fast multipole method."""
    work, seconds, asked, digits, tolerances, builds = [], [], [], [], [], []
    for tol in TOLERANCES:
        for case in cases.copy():
            start = time.process_time()
            tc.Plan(case.kernel, "fmm", tol=tol).set_points(case.points)
            build = time.process_time() - start
            error, time_taken, plan = case.run("fmm", tol=tol)
            print(f"    fmm {tol:g}: built in {build:.1f} s", flush=True)
            if build > LONGEST:
                cases.remove(case)
            if not plan.info()["far_pairs"]:
                continue
            price = multipole.Multipole(case.kernel, tol).price(
                np.ascontiguousarray(case.points.T), None
            )
            work.append(auto.multipole_work(tol, price, 2 * len(case.points)))
            seconds.append(time_taken)
            asked.append(math.log10(tol))
            digits.append(math.log10(error / case.probe))
            if build > 0.1:
                tolerances.append(math.log10(tol))
                builds.append(math.log10(build))
    return {
        "seconds": fit(work, seconds),
        "error": line(asked, digits),
        "build": line(tolerances, builds),
    }


def model(kernel: tc.Kernel) -> dict[str, Any]:
    """Return the model of one kernel."""
    print(type(kernel).__name__, flush=True)
    cases = [Case(kernel, name, n) for name in ("cube", "clustered") for n in SIZES]
    pairs = [[len(case.points) ** 2] for case in cases]
    return {
        "size": kernel.weight_size * kernel.value_size,
        "probe": float(f"{cases[1].probe:.2g}"),
        "direct": {"seconds": fit(pairs, [case.direct_seconds for case in cases])},
        **{backend: treecodes(cases[1::2], backend) for backend in DEGREES},
        "fmm": fast_multipole(cases[1::2]),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kernels", nargs="+", choices=KERNELS, default=KERNELS)
    default = Path(auto.__file__).with_name("costs.json")
    parser.add_argument("--output", type=Path, default=default)
    options = parser.parse_args()
    numba.set_num_threads(1)
    fitted = json.loads(options.output.read_text()) if options.output.exists() else {}
    with tempfile.TemporaryDirectory() as folder:
        store.folder = lambda: Path(folder)
        for name in options.kernels:
            fitted[name] = model(KERNELS[name])
            options.output.write_text(json.dumps(fitted, indent=1) + "\n")


if __name__ == "__main__":
    main()
