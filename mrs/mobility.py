"""Forces and torques to velocities: the one place where the simulator calls `treecode`."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

import treecode as tc
from mrs import check

BACKENDS = ("auto", "direct", "kitc", "taylor", "fmm")
_SMALL = 2000  # sources, up to which a tree never pays
_SAMPLES = 1000  # targets at which "auto" measures errors
_MAX_DEGREE = 12  # that "auto" tries
_MANY = 8000  # sources, from which "auto" tries the fast multipole method


@dataclass(frozen=True)
class Backend:
    """How the sums are done.

    Parameters
    ----------
    name : {"auto", "direct", "kitc", "taylor", "fmm"}
        "auto" measures at the first sum of a simulation: the fastest of those that reach
        `tolerance` is kept, and made more accurate when a later sample asks for it.
    theta, degree, leaf_size : optional
        Of treecodes, as in `treecode.Plan`. "auto" chooses `degree` itself.
    tolerance : float, optional
        Relative error (K eq. 8.1): the largest of "auto", the aim of "fmm".
    """

    __pydantic_config__: ClassVar[dict[str, str]] = {"extra": "forbid"}

    name: str = "auto"
    theta: float = 0.7
    degree: int = 6
    leaf_size: int = 1000
    tolerance: float = 1e-4

    def __str__(self) -> str:
        if self.name in ("auto", "direct"):
            return self.name
        return f"{self.name}({self.tolerance if self.name == 'fmm' else self.degree:g})"

    def plan(self, kernel: tc.Kernel) -> tc.Plan:
        """Return an empty plan."""
        if self.name == "fmm":
            return tc.Plan(kernel, "fmm", tol=self.tolerance)
        return tc.Plan(
            kernel, self.name, theta=self.theta, degree=self.degree, leaf_size=self.leaf_size
        )


class _Sum:
    """One fast sum: sources of one blob size, all with torques or all without, to some targets."""

    def __init__(self, kernel: tc.Kernel, sources: np.ndarray, targets: np.ndarray) -> None:
        self.kernel, self.sources, self.targets = kernel, sources, targets
        self.same = np.array_equal(sources, targets)
        self.backend: Backend | None = None

    def use(self, backend: Backend) -> None:
        """Sum by `backend` from now on."""
        self.backend, self.plan = backend, backend.plan(self.kernel)

    def strengths(self, loads: np.ndarray) -> np.ndarray:
        """Return the part of the loads, (N, 6), that the kernel takes."""
        return loads[self.sources, : self.kernel.strength_size]

    def __call__(self, points: np.ndarray, loads: np.ndarray) -> np.ndarray:
        targets = None if self.same else points[self.targets]
        return self.plan.set_points(points[self.sources], targets).execute(self.strengths(loads))


class Mobility:
    """The linear map from forces and torques at points to velocities and angular velocities there.

    Each channel is computed only where there is something to put in and somebody who wants it:
    sources without torques and targets without angular velocity meet in a regularized Stokeslet, 3
    by 3.

    Parameters
    ----------
    viscosity : float
    epsilons : (N,) ndarray
        Blob sizes.
    forced, torqued, spinning : (N,) bool ndarray
        Whether there is a force, and a torque, at a point, and whether its angular velocity is
        wanted.
    backend : Backend
        For each sum.
    """

    def __init__(
        self,
        viscosity: float,
        epsilons: np.ndarray,
        forced: np.ndarray,
        torqued: np.ndarray,
        spinning: np.ndarray,
        backend: Backend,
    ) -> None:
        check.one_of("backend", backend.name, BACKENDS)
        check.number("tolerance", backend.tolerance, 1e-12, 1.0)
        self.backend = backend
        self.evaluations = 0
        self.seconds = 0.0
        self._sums = []
        for epsilon in np.unique(epsilons[forced]):
            for torque in (False, True):
                sources = np.flatnonzero(forced & (epsilons == epsilon) & (torqued == torque))
                for spin in (False, True) if not torque else (None,):
                    wanted = np.ones_like(spinning) if spin is None else spinning == spin
                    targets = np.flatnonzero(wanted)
                    if len(sources) and len(targets):
                        rotlet = torque or spin
                        kind = tc.RegularizedStokesletRotlet if rotlet else tc.RegularizedStokeslet
                        self._sums.append(_Sum(kind(float(epsilon), viscosity), sources, targets))

    def __call__(self, points: np.ndarray, loads: np.ndarray) -> np.ndarray:
        """Return velocities and angular velocities, (N, 6), of forces and torques, (N, 6).

        Both are (N, 3) where there are neither torques nor angular velocities. The latter mean
        nothing at points that do not want them.
        """
        values = np.zeros_like(loads)
        start = time.perf_counter()
        for term in self._sums:
            if term.backend is None:
                term.use(self._choose(term, points, loads))
            out = term(points, loads)
            values[term.targets, : out.shape[1]] += out
        self.seconds += time.perf_counter() - start
        self.evaluations += 1
        return values

    def velocity(self, points: np.ndarray, loads: np.ndarray, targets: np.ndarray) -> np.ndarray:
        """Return the velocity, (M, 3), at any targets, (M, 3)."""
        values = np.zeros_like(targets)
        groups = {term.sources[0]: term for term in self._sums}
        for term in groups.values():
            plan = (term.backend or Backend("direct")).plan(term.kernel)
            out = plan.set_points(points[term.sources], targets).execute(term.strengths(loads))
            values += out[:, :3]
        return values

    @property
    def pairs(self) -> int:
        """Pairs of targets with sources, or terms of expansions, in the last evaluation."""
        infos = self.infos()
        return sum((info["near_pairs"] or 0) + (info["far_pairs"] or 0) for info in infos)

    def infos(self) -> list[dict[str, Any]]:
        """Return `treecode.Plan.info` of each sum in the last evaluation."""
        return [term.plan.info() for term in self._sums if term.backend is not None]

    @property
    def choices(self) -> list[Backend]:
        """What each sum is done by, of those that have been done."""
        return [term.backend for term in self._sums if term.backend is not None]

    def history(self) -> list[dict[str, Any]]:
        """Return the choices made so far."""
        return [asdict(choice) for choice in self.choices]

    def restore(self, history: list[dict[str, Any]]) -> None:
        """Use earlier choices of "auto" again: a run that is resumed must not measure anew."""
        for term, choice in zip(self._sums, history, strict=False):
            term.use(Backend(**choice))

    def sampled_error(self, points: np.ndarray, loads: np.ndarray) -> float:
        """Return the largest relative error of the sums at randomly drawn targets."""
        done = ((term, term.backend) for term in self._sums if term.backend is not None)
        return max((_Trial(term, points, loads).error(used) for term, used in done), default=0.0)

    def correct(self, points: np.ndarray, loads: np.ndarray) -> bool:
        """Raise the degree where "auto" does not reach its tolerance any more; return if so.

        What is chosen depends on points and loads alone, not on times measured.
        """
        corrected = False
        if self.backend.name == "auto":
            for term in self._sums:
                trial = _Trial(term, points, loads)
                while (
                    term.backend is not None and trial.error(term.backend) > self.backend.tolerance
                ):
                    term.use(_sharper(term.backend))
                    corrected = True
        return corrected

    def _choose(self, term: _Sum, points: np.ndarray, loads: np.ndarray) -> Backend:
        """Return the fastest backend that reaches the tolerance at sampled targets."""
        direct = replace(self.backend, name="direct")
        if self.backend.name != "auto":
            return self.backend
        if len(term.sources) <= _SMALL:
            return direct
        trial = _Trial(term, points, loads)
        seconds = {direct: trial.seconds(direct)}
        for name in ("kitc", "taylor"):
            degrees = range(2, _MAX_DEGREE + 1)
            tries = [replace(self.backend, name=name, degree=degree) for degree in degrees]
            self._time_first(trial, tries, seconds)
        if len(term.sources) >= _MANY:
            sharper = [self.backend.tolerance / factor for factor in (1.0, 4.0, 16.0)]
            tries = [replace(self.backend, name="fmm", tolerance=tol) for tol in sharper]
            self._time_first(trial, tries, seconds)
        return min(seconds, key=lambda backend: seconds[backend])

    def _time_first(
        self, trial: _Trial, tries: list[Backend], seconds: dict[Backend, float]
    ) -> None:
        """Time the first of some backends that reaches the tolerance."""
        for backend in tries:
            if trial.error(backend) <= self.backend.tolerance:
                seconds[backend] = trial.seconds(backend)
                return


class _Trial:
    """One sum at randomly drawn targets, by any backend."""

    def __init__(self, term: _Sum, points: np.ndarray, loads: np.ndarray) -> None:
        self._term, self._points = term, points
        self._sample = np.random.default_rng(0).permutation(term.targets)[:_SAMPLES]
        self._strengths = term.strengths(loads)
        if not self._strengths.any():  # everything at rest
            shape = self._strengths.shape
            self._strengths = np.random.default_rng(0).standard_normal(shape)

    @cached_property
    def _exact(self) -> np.ndarray:
        return self._evaluate(Backend("direct"), self._sample)

    def error(self, backend: Backend) -> float:
        """Return the relative error of velocities or of angular velocities, if that is larger."""
        if backend.name == "direct":
            return 0.0
        values = self._evaluate(backend, self._sample)
        parts = (slice(0, 3), slice(3, 6))  # in different units
        return max(tc.relative_error(values[:, part], self._exact[:, part]) for part in parts)

    def seconds(self, backend: Backend) -> float:
        """Return how long the whole sum takes once compiled; of direct sums a sample is scaled."""
        targets = self._sample if backend.name == "direct" else self._term.targets
        self._evaluate(backend, self._sample)
        start = time.perf_counter()
        self._evaluate(backend, targets)
        return (time.perf_counter() - start) * len(self._term.targets) / len(targets)

    def _evaluate(self, backend: Backend, targets: np.ndarray) -> np.ndarray:
        plan = backend.plan(self._term.kernel)
        plan.set_points(self._points[self._term.sources], self._points[targets])
        return plan.execute(self._strengths)


def _sharper(backend: Backend) -> Backend:
    """Return the next more accurate backend."""
    if backend.name == "fmm":
        return replace(backend, tolerance=0.25 * backend.tolerance)
    if backend.degree >= _MAX_DEGREE:
        return replace(backend, name="direct")
    return replace(backend, degree=backend.degree + 1)
