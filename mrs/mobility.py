"""Forces and torques to velocities: the one place where the simulator calls `treecode`."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

import treecode as tc
from mrs import check

BACKENDS = ("auto", "direct", "kitc", "taylor", "fmm")


@check.spelling
@dataclass(frozen=True)
class Backend:
    """How the sums are done.

    Parameters
    ----------
    name : {"auto", "direct", "kitc", "taylor", "fmm"}
        "auto" takes what should be the fastest for `tolerance`; see `treecode.Plan`.
    theta, degree, leaf_size : optional
        Of treecodes, as in `treecode.Plan`; by default what suits `tolerance`.
    tolerance : float, optional
        Relative error (K eq. 8.1) of each sum, of velocities and of angular velocities. It is met
        at the first sum of a simulation and sampled again now and then; the aim of "fmm". A given
        `degree` stands in its place.
    """

    __pydantic_config__: ClassVar[dict[str, str]] = {"extra": "forbid"}

    name: str = "auto"
    theta: float | None = None
    degree: int | None = None
    leaf_size: int | None = None
    tolerance: float = 1e-4

    def __post_init__(self) -> None:
        check.one_of("name", self.name, BACKENDS)
        check.number("tolerance", self.tolerance, 1e-12, 1.0)
        self.plan(tc.RegularizedStokeslet(epsilon=1.0))  # refuses the rest

    def plan(self, kernel: tc.Kernel) -> tc.Plan:
        """Return an empty plan."""
        return tc.Plan(
            kernel,
            self.name,
            theta=self.theta,
            degree=self.degree,
            leaf_size=self.leaf_size,
            tol=self.tolerance if self.degree is None or self.name == "fmm" else None,
        )


class _Sum:
    """One fast sum: sources of one blob size, all with torques or all without, to some targets."""

    def __init__(
        self, kernel: tc.Kernel, sources: np.ndarray, targets: np.ndarray, backend: Backend
    ) -> None:
        self.kernel, self.sources, self.targets = kernel, sources, targets
        self.same = np.array_equal(sources, targets)
        self.plan = backend.plan(kernel)
        self._falls_back = backend.name == "auto"

    def strengths(self, loads: np.ndarray) -> np.ndarray:
        """Return the part of the loads, (N, 6), that the kernel takes."""
        return loads[self.sources, : self.kernel.strength_size]

    def __call__(self, points: np.ndarray, loads: np.ndarray) -> np.ndarray:
        self._place(points)
        try:
            return self.plan.execute(self.strengths(loads))
        except tc.ToleranceError as error:
            self._fall_back(points, error)
            return self.plan.execute(self.strengths(loads))

    def refine(self, points: np.ndarray, loads: np.ndarray) -> bool:
        """Sample the error; return whether another way to sum was chosen for it."""
        self._place(points)
        try:
            return self.plan.refine(self.strengths(loads))
        except tc.ToleranceError as error:
            self._fall_back(points, error)
            return True

    def error(self, points: np.ndarray, loads: np.ndarray) -> float:
        """Return the relative error at randomly drawn targets."""
        self._place(points)
        return self.plan.estimate_error(self.strengths(loads), by_unit=True)

    def _place(self, points: np.ndarray) -> None:
        self.plan.set_points(points[self.sources], None if self.same else points[self.targets])

    def _fall_back(self, points: np.ndarray, error: tc.ToleranceError) -> None:
        """Sum directly: bodies at rest have loads, and sums, that are nothing but rounding."""
        if not self._falls_back:
            raise error
        self.plan.use(tc.Choice("direct"))
        self._place(points)


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
                        kernel = kind(float(epsilon), viscosity)
                        self._sums.append(_Sum(kernel, sources, targets, backend))

    def __call__(self, points: np.ndarray, loads: np.ndarray) -> np.ndarray:
        """Return velocities and angular velocities, (N, 6), of forces and torques, (N, 6).

        Both are (N, 3) where there are neither torques nor angular velocities. The latter mean
        nothing at points that do not want them.
        """
        values = np.zeros_like(loads)
        start = time.perf_counter()
        for term in self._sums:
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
            plan = tc.Plan(term.kernel, "direct")
            if term.plan.choice is not None:
                plan.use(term.plan.choice)
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
        return [term.plan.info() for term in self._sums if term.plan.choice is not None]

    @property
    def choices(self) -> list[tc.Choice]:
        """What each sum is done by, of those that are decided."""
        choices = (term.plan.choice for term in self._sums)
        return [choice for choice in choices if choice is not None]

    def history(self) -> list[dict[str, Any] | None]:
        """Return the choices made so far, None for sums whose strengths have been zero."""
        choices = (term.plan.choice for term in self._sums)
        return [None if choice is None else choice._asdict() for choice in choices]

    def restore(self, history: list[dict[str, Any] | None]) -> None:
        """Use earlier choices again: a run that is resumed must not choose by another state."""
        for term, choice in zip(self._sums, history, strict=True):
            if choice is not None:
                term.plan.use(tc.Choice(**choice))

    def sampled_error(self, points: np.ndarray, loads: np.ndarray) -> float:
        """Return the largest relative error of the sums at randomly drawn targets."""
        return max((term.error(points, loads) for term in self._sums), default=0.0)

    def correct(self, points: np.ndarray, loads: np.ndarray) -> bool:
        """Choose anew where a sum does not reach its tolerance any more; return if so."""
        refined = [term.refine(points, loads) for term in self._sums]  # all of them
        return any(refined)
