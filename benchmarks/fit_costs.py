"""Fit the model of cost and error by which backend "auto" chooses, treecode/choice/costs.json.

    python -m benchmarks.fit_costs [--kernels Stokeslet ...] [--output treecode/choice/costs.json]

Random strengths in a cube and in clumps, one thread. Processor time, the least of several runs, is
fitted by non-negative least squares of relative deviations, errors by lines in degree and digits.
Operators of the fast multipole method are built in an empty folder, to measure the time.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Callable
from itertools import product
from pathlib import Path
from typing import Any

import numba
import numpy as np
from scipy.optimize import nnls

import treecode as tc
from benchmarks.methods import DIRECT, TAYLOR
from benchmarks.sums import no_operators_kept
from tests.cases.tolerance import SETS
from treecode import methods
from treecode.choice.model import COSTS
from treecode.choice.probe import PROBE
from treecode.kernels import wall_correction
from treecode.methods.base import PRECISIONS
from treecode.methods.direct import DirectSummation
from treecode.methods.fmm import store
from treecode.methods.fmm.method import FastMultipoleMethod
from treecode.methods.fmm.sizing import precision_for
from treecode.methods.fmm.summation import FastMultipole
from treecode.methods.fmm.symmetry import scale_powers
from treecode.methods.treecode import LEAF_SIZES, THETAS, Treecode

KERNELS = {
    "RegularizedStokeslet": tc.RegularizedStokeslet(epsilon=0.01),
    "RegularizedStokesletRotlet": tc.RegularizedStokesletRotlet(epsilon=0.05),
    "Stokeslet": tc.Stokeslet(),
    "StokesletStresslet": tc.StokesletStresslet(),
    "ForceWallCorrection": wall_correction.ForceWallCorrection(epsilon=0.01),
    "WallCorrection": wall_correction.WallCorrection(epsilon=0.05),
    "StokesletWallCorrection": wall_correction.StokesletWallCorrection(),
}
SIZES = 1500, 4000, 16_000
DEGREES, MORE_DEGREES = (2, 4, 6, 8), {TAYLOR: (2, 5, 8, 12)}
TOLERANCES = [10.0**-k for k in (1, 2, 3, 4, 5, 6, 7, 8)]
ENOUGH = 0.3  # seconds of laps
LONGEST = 40.0  # seconds to build operators, after which smaller tolerances are left out


Runs = dict[str, list[tuple[list[float], float]]]  # work and seconds, for each precision


def fit(runs: Runs) -> dict[str, list[float]]:
    """Return non-negative rates by least squares of relative deviations."""
    fitted = {}
    for precision, measured in runs.items():
        matrix = np.array([work for work, _ in measured]) / np.array([[s] for _, s in measured])
        scale = np.abs(matrix).max(axis=0)
        scale[scale == 0.0] = 1.0
        rates = nnls(matrix / scale, np.ones(len(measured)))[0] / scale
        off = np.abs(matrix @ rates - 1.0)
        print(f"    {len(measured)} runs, deviations {np.median(off):.0%}, at most {off.max():.0%}")
        fitted[precision] = [float(f"{rate:.3g}") for rate in rates]
    return fitted


def line(x: list[float], y: list[float]) -> list[float]:
    """Return offset and slope."""
    slope, offset = np.polyfit(x, y, 1)
    return [round(float(offset), 3), round(float(slope), 4)]


class Case:
    """One kernel on one set of points."""

    def __init__(self, kernel: tc.Kernel, name: str, n: int) -> None:
        self.kernel, self.points = kernel, SETS[name](n, np.random.default_rng(0))
        self.strengths = np.random.default_rng(1).standard_normal((n, kernel.strength_size))
        self.exact = tc.evaluate(kernel, self.points, self.strengths, backend=DIRECT)
        self.probe = self.run(PROBE.backend, **PROBE.parameters)[0]

    def run(self, backend: str, **options: Any) -> tuple[float, float, tc.Plan]:
        """Return error, seconds and the plan."""
        plan = tc.Plan(self.kernel, backend, **options).set_points(self.points)
        values = plan.execute(self.strengths)
        laps: list[float] = []
        while len(laps) < 2 or (len(laps) < 10 and sum(laps) < ENOUGH):
            start = time.process_time()
            plan.set_points(self.points).execute(self.strengths)
            laps.append(time.process_time() - start)
        return tc.relative_error(values, self.exact), min(laps), plan


def direct_sums(cases: list[Case], method: DirectSummation) -> dict[str, Any]:
    """Return the model of direct summation."""
    work: Runs = {precision: [] for precision in PRECISIONS}
    for precision, case in product(PRECISIONS, cases):
        seconds = case.run(method.name, precision=precision)[1]
        work[precision].append(([len(case.points) ** 2], seconds))
    return {"seconds": fit(work)}


def treecodes(cases: list[Case], method: Treecode) -> dict[str, Any]:
    """Return the model of a treecode."""
    tried = MORE_DEGREES.get(method.name, DEGREES)
    work: Runs = {precision: [] for precision in PRECISIONS}
    offsets, slopes = [], []
    for theta in THETAS:
        degrees, digits = [], []
        for case, (i, degree) in product(cases, enumerate(tried)):
            terms, n = method.terms(degree), len(case.points)
            options = {"theta": theta, "degree": degree, "leaf_size": LEAF_SIZES[i % 3]}
            for precision in PRECISIONS:
                error, seconds, plan = case.run(method.name, precision=precision, **options)
                info = plan.info()
                far = info["far_pairs"]
                amounts = [info["near_pairs"], far, far / terms, n * terms, 2 * n]
                work[precision].append((amounts, seconds))
                if precision == "float64" and far and error > 1e-12:
                    degrees.append(degree)
                    digits.append(math.log10(error / case.probe))
        offset, slope = line(degrees, digits)
        offsets.append(offset)
        slopes.append(slope)
    return {"seconds": fit(work), "offset": offsets, "slope": slopes}


def fast_multipole(cases: list[Case], method: FastMultipoleMethod) -> dict[str, Any]:
    """Return the model of the fast multipole method."""
    work: Runs = {precision: [] for precision in PRECISIONS}
    asked, digits = [], []
    builds: dict[float, float] = {}  # seconds for cubes of one size; other cases may load them
    each = scale_powers(cases[0].kernel, [1.0]) is None
    with no_operators_kept():
        for tol in 1e-2, 1e-6:  # compiled for singles and doubles before anything is timed
            cases[0].run(method.name, tol=tol)
    store._memory.clear()
    for tol in TOLERANCES:
        for case in cases.copy():
            start = time.process_time()
            tc.Plan(case.kernel, method.name, tol=tol).set_points(case.points)
            build = time.process_time() - start
            error, seconds, plan = case.run(method.name, tol=tol)
            print(f"    {method.name} {tol:g}: built in {build:.1f} s", flush=True)
            if build > LONGEST:
                cases.remove(case)
            if not plan.info()["far_pairs"]:
                continue
            points = np.ascontiguousarray(case.points.T)
            sum_ = FastMultipole(case.kernel, {"tol": tol}, False)
            amounts, sizes = method.amounts(sum_, points, points)
            work[precision_for(tol)].append((amounts, seconds))
            asked.append(math.log10(tol))
            digits.append(math.log10(error / case.probe))
            build /= sizes if each else 1
            builds[tol] = max(build, builds.get(tol, 0.0))
    return {
        "seconds": fit(work),
        "error": line(asked, digits),
        "build": line(*np.log10([list(builds), list(builds.values())])),
        "each": each,  # whether operators serve cubes of one size only
    }


FITS: dict[type, Callable[[list[Case], Any], dict[str, Any]]] = {
    DirectSummation: direct_sums,
    Treecode: treecodes,
    FastMultipoleMethod: fast_multipole,
}


def model(kernel: tc.Kernel) -> dict[str, Any]:
    """Return the model of one kernel."""
    print(type(kernel).__name__, flush=True)
    cases = [Case(kernel, name, n) for name in ("cube", "clustered") for n in SIZES]
    fitted: dict[str, Any] = {
        "size": kernel.weight_size * kernel.value_size,
        "probe": float(f"{cases[len(SIZES) - 1].probe:.2g}"),
    }
    for method in filter(lambda method: method.takes(kernel), map(methods.get, methods.names())):
        for kind, fit_method in FITS.items():
            if isinstance(method, kind):
                fitted[method.name] = fit_method(cases, method)
    return fitted


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kernels", nargs="+", choices=KERNELS, default=KERNELS)
    parser.add_argument("--output", type=Path, default=COSTS)
    options = parser.parse_args()
    numba.set_num_threads(1)
    fitted = json.loads(options.output.read_text()) if options.output.exists() else {}
    with no_operators_kept():
        for name in options.kernels:
            fitted[name] = model(KERNELS[name])
            options.output.write_text(json.dumps(fitted, indent=1) + "\n")


if __name__ == "__main__":
    main()
