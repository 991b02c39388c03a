"""One sum, measured: seconds from points to values, its error, threads, memory."""

from __future__ import annotations

import gc
import importlib.util
import tempfile
import time
import tracemalloc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any
from unittest import mock

import numba
import numpy as np

import treecode as tc
from benchmarks import point_sets
from benchmarks.machine import mpirun
from benchmarks.methods import DIRECT
from benchmarks.rows import Row
from treecode.methods.fmm import store
from treecode.ranks import ranks_of

SAMPLES = 2000  # targets at which errors are taken, as in K 8.1.2
DIRECT_PAIRS, SAMPLED_PAIRS = 7e9, 3e9  # of direct sums; beyond the first, the second stand for all
REPEATS, ENOUGH = 3, 6.0  # a sum is repeated so often, if that takes no more than so many seconds
TURNS = 60.0  # the same of one thread and two in turns, whose ratio is wanted
FEW = 4000  # points with which compiled code is warmed up
ALL = slice(None)


@dataclass
class Problem:
    """A sum, and the targets at which its error is taken."""

    kernel: tc.Kernel
    points: np.ndarray
    strengths: np.ndarray
    rows: np.ndarray

    @property
    def targets(self) -> np.ndarray:
        return self.points[self.rows]

    @cached_property
    def exact(self) -> np.ndarray:
        """The direct sum."""
        return tc.evaluate(
            self.kernel, self.points, self.strengths, targets=self.targets, backend=DIRECT
        )

    @cached_property
    def self_terms(self) -> np.ndarray:
        """K(0) q: the part of each target in its own sum, 0 for a singular kernel."""
        origin = np.zeros((1, 3))
        units = np.eye(self.kernel.strength_size)[:, None]
        columns = [tc.evaluate(self.kernel, origin, unit, backend=DIRECT)[0] for unit in units]
        return self.strengths[self.rows] @ np.array(columns)


class Fmm3d:
    """FMM3D (fmm3dpy) with the methods of a plan, for singular Stokeslets, on one thread."""

    def __init__(self, tol: float) -> None:
        self.tol = tol

    def set_points(self, sources: np.ndarray, targets: None = None) -> Fmm3d:
        assert targets is None
        self.sources = np.asfortranarray(sources.T)
        return self

    def execute(self, strengths: np.ndarray) -> np.ndarray:
        import fmm3dpy

        forces = np.asfortranarray(8.0 * np.pi * strengths.T)  # theirs has the prefactor
        out = fmm3dpy.stfmm3d(eps=self.tol, sources=self.sources, stoklet=forces, ifppreg=1)
        return out.pot.reshape(3, -1).T

    def info(self) -> dict[str, Any]:
        return {"seconds": {}}


def can_measure(case: Row) -> bool:
    """Tell whether the packages that a case needs are installed."""
    if "ranks" in case and not (mpirun() and importlib.util.find_spec("mpi4py")):
        return False
    return case.get("backend") != "fmm3d" or importlib.util.find_spec("fmm3dpy") is not None


def draw(n: int, count: int) -> np.ndarray:
    """Return random rows out of n; of fewer and of more of them the first agree."""
    return np.random.default_rng(1).permutation(n)[:count]


def make_plan(kernel: tc.Kernel, backend: str, **options: Any) -> Any:
    """Return a plan of treecode, or an object with the same members."""
    return Fmm3d(**options) if backend == "fmm3d" else tc.Plan(kernel, backend, **options)


@lru_cache(maxsize=1)
def make_problem(points: str, size: int, epsilon: float | None, singular: bool = False) -> Problem:
    """Return a point set of the papers, or one of `point_sets.uneven`, with its kernel."""
    kernel: tc.Kernel
    if points == "organisms":
        assert epsilon is not None
        kernel = tc.RegularizedStokeslet(epsilon)
        sources, strengths = point_sets.organisms(size, epsilon, 0, octant=True)
    elif points == "rods":
        kernel = tc.RegularizedStokesletRotlet(0.3)
        sources, strengths = point_sets.rods(size, 0)
    elif points == "sphere":
        kernel = tc.StokesletStresslet()
        sources, strengths = point_sets.sphere(size, 0, outward=False)
    elif points == "cube":
        kernel = tc.Stokeslet()
        sources, strengths = point_sets.cube(size, 0)
    else:
        sources, strengths = point_sets.uneven(points, size, 0)
        kernel = tc.RegularizedStokeslet(1e-3 * float(np.ptp(sources)))
    rows = draw(len(sources), SAMPLES)
    return Problem(tc.Stokeslet() if singular else kernel, sources, strengths, rows)


@contextmanager
def no_operators_kept() -> Iterator[None]:
    """Operators come neither from memory nor from disk, so that building them is seen."""
    with (
        tempfile.TemporaryDirectory() as folder,
        mock.patch.object(store, "folder", return_value=Path(folder)),
    ):
        store._memory.clear()
        yield


def warm_up(problem: Problem, backend: str, options: dict[str, Any], own: slice = ALL) -> None:
    """Compile, by a small sum with every kind of step."""
    if backend != "fmm3d":
        plan = make_plan(problem.kernel, backend, **options | {"degree": 2, "leaf_size": 40})
        plan.set_points(problem.points[own][:FEW]).execute(problem.strengths[own][:FEW])


class Sum:
    """A sum that is ready to be timed: code compiled, operators built.

    Parameters
    ----------
    points, size, epsilon
        The point set.
    backend : str
        One of treecode's, or "fmm3d".
    sampled : bool, optional
        Only at the targets where the error is taken.
    comm : mpi4py.MPI.Comm, optional
        Ranks that share the sum.
    distributed : bool, optional
        Each rank has a slice of the points, and gets their values. It needs `comm`.
    **options
        Of the backend.
    """

    def __init__(
        self,
        points: str,
        size: int,
        backend: str,
        epsilon: float | None = None,
        sampled: bool = False,
        comm: Any = None,
        distributed: bool = False,
        **options: Any,
    ) -> None:
        self.problem = make_problem(points, size, epsilon, backend == "fmm3d")
        self.backend, n = backend, len(self.problem.points)
        if comm is not None:
            options["comm"] = comm
        self._comm, self._own = None, ALL
        if distributed:
            self._comm, self._own = comm, ranks_of(comm).share(n)
            options["distributed"] = True
        wanted = SAMPLES if sampled else n
        if backend == DIRECT and n * n > DIRECT_PAIRS:
            wanted = int(SAMPLED_PAIRS / n)
        self.share = min(wanted / n, 1.0)  # of all targets
        self.targets = self.problem.points[draw(n, wanted)] if wanted < n else None
        self.plan = make_plan(self.problem.kernel, backend, **options)
        with no_operators_kept():
            warm_up(self.problem, backend, options, self._own)
            self._set_points()
        self.build = self.plan.info()["seconds"].get("operators", 0.0)

    def lap(self) -> tuple[float, float]:
        """Return the seconds of setting the points and of summing."""
        start = time.perf_counter()
        self._set_points()
        middle = time.perf_counter()
        self.values = self.plan.execute(self.problem.strengths[self._own])
        return middle - start, time.perf_counter() - middle

    def _set_points(self) -> None:
        self.plan.set_points(self.problem.points[self._own], self.targets)

    def collect(self) -> None:
        """Let each rank have all values of the last lap; all of them call this."""
        if self._comm is not None:
            self.values = np.concatenate(self._comm.allgather(self.values))

    def error(self) -> float | None:
        """Return E of the last lap, K eq. (8.1); None for direct sums, the reference."""
        if self.backend == DIRECT:
            return None
        rows = self.problem.rows if self.targets is None else slice(SAMPLES)
        return tc.relative_error(self.values[rows], self.problem.exact)

    def row(self) -> Row:
        """Return size, error, pairs for each target and the info of the backend."""
        info = self.plan.info()
        targets = len(self.values)
        pairs = {
            name: info[f"{name}_pairs"] / targets if f"{name}_pairs" in info else None
            for name in ("near", "far")
        }
        return {
            "n": len(self.problem.points),
            "error": self.error(),
            **pairs,
            "precision": info.get("precision", "float64"),
        }


def repeat(run: Callable[[], Any], enough: float = ENOUGH) -> np.ndarray:
    """Return the results of `run`, seconds, `REPEATS` of them if they take at most `enough`."""
    laps = [run()]
    while len(laps) < REPEATS and np.sum(laps) < enough:
        laps.append(run())
    return np.array(laps)


def one_sum(**case: Any) -> Row:
    """Measure on one thread; the time of a sum at fewer targets is scaled up to all."""
    numba.set_num_threads(1)
    run = Sum(**case)
    laps = repeat(run.lap)
    setting, summing = np.median(laps, axis=0)
    seconds = setting + summing / run.share
    return {
        "build": run.build,
        "setting": setting,
        "seconds": seconds,
        "repeats": len(laps),
        "extrapolated": run.share < 1.0,
        **run.row(),
    }


def on_threads(**case: Any) -> Row:
    """Measure on one thread and on two, in turns."""
    run = Sum(**case)

    def turn() -> list[float]:
        seconds = []
        for threads in (1, 2):
            numba.set_num_threads(threads)
            setting, summing = run.lap()
            seconds.append(setting + summing / run.share)
        return seconds

    laps = repeat(turn, TURNS)
    one, two = np.median(laps, axis=0)
    efficiency = float(np.median(laps[:, 0] / laps[:, 1])) / 2.0
    return {
        "seconds": one,
        "seconds2": two,
        "efficiency": efficiency,
        "repeats": len(laps),
        "extrapolated": run.share < 1.0,
        **run.row(),
    }


def peak_memory(points: str, size: int, backend: str, **options: Any) -> Row:
    """Measure the most memory that NumPy holds, with the caller's arrays and the result.

    The memory of a direct sum is in proportion to its points; it is measured with few of them.
    """
    numba.set_num_threads(numba.config.NUMBA_NUM_THREADS)
    problem = make_problem(points, size, options.pop("epsilon", None))
    n = len(problem.points)
    count = min(n, 10_000) if backend == DIRECT else n
    sources, strengths = problem.points[:count], problem.strengths[:count]
    warm_up(problem, backend, options)  # compilers use memory too
    tc.Plan(problem.kernel, backend, **options).set_points(sources)  # operators to the disk
    store._memory.clear()
    gc.collect()
    tracemalloc.start()
    tc.Plan(problem.kernel, backend, **options).set_points(sources).execute(strengths)
    peak = tracemalloc.get_traced_memory()[1] + sources.nbytes + strengths.nbytes
    tracemalloc.stop()
    return {"n": n, "bytes": peak * n / count, "extrapolated": count < n}
