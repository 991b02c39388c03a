"""Forces and torques to velocities: the one place where the simulator calls `treecode`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

import treecode as tc
from mrs import check
from treecode import Boundary, FreeSpace
from treecode.accuracy import Parts
from treecode.ranks import ranks_of

DIRECT = tc.EXACT.backend  # the name of sums of which none are more accurate
_KINDS: tuple[Any, ...] = tc.RegularizedStokeslet, tc.RegularizedStokesletRotlet  # without, with
_BOX = tc.Periodic((1.0, 1.0, 1.0))  # some methods sum in boxes only
_SAMPLES = 1000  # points at which errors are sampled for the log
_LEAST_TOLERANCE = 2e-13  # that can be asked of a sum


@check.spelling
@dataclass(frozen=True)
class Backend:
    """How the sums are done.

    Parameters
    ----------
    name : str
        One of `names`: a method of summation, or "auto", which takes the method that should be the
        fastest for `tolerance`; see `treecode.Plan`.
    theta, degree, leaf_size : optional
        Of treecodes, as in `treecode.Plan`; by default chosen for `tolerance`.
    precision : {"float64", "float32"}, optional
        Of direct sums, and of treecodes with a `degree`, as in `treecode.Plan`; by default chosen
        for `tolerance`.
    tolerance : float, optional
        Relative error in the Euclidean norm (K eq. 8.1), of the velocities of each body, and of
        its angular velocities. It is met at the first evaluation of a simulation, watched in
        every longer sum, and sampled again every 50 steps. A given `degree` replaces it; for "fmm"
        both can be given, and `tolerance` is then its aim.

    Examples
    --------
    >>> import mrs
    >>> positions, directions = mrs.lattice_suspension((5, 5, 5), spacing=2.0)
    >>> swimmers = mrs.Swimmers(positions, directions, length=1.0, force=1.0, epsilon=0.1)
    >>> sim = mrs.Simulation(mrs.Fluid(), [swimmers], backend=mrs.Backend(tolerance=1e-6))
    >>> speeds = sim.now.rates[:125]
    >>> bool(sim.scene.sampled_error(sim.time, sim.state) < 1e-6)
    True
    """

    __pydantic_config__: ClassVar[dict[str, str]] = {"extra": "forbid"}

    name: str = "auto"
    theta: float | None = None
    degree: int | None = None
    leaf_size: int | None = None
    precision: str | None = None
    tolerance: float = 1e-4

    def __post_init__(self) -> None:
        check.one_of("name", self.name, self.names())
        check.number("tolerance", self.tolerance, 1e-12, 1.0)
        kernel, options = _KINDS[0](epsilon=1.0), self.options(self.tolerance)
        anywhere = self.name == "auto" or tc.methods.get(self.name).takes(kernel)
        tc.Plan(kernel, **options, boundary=None if anywhere else _BOX)  # refuses the rest

    @staticmethod
    def names() -> tuple[str, ...]:
        """Return the allowed values of `name`."""
        return tc.backends()

    def options(self, tolerance: float) -> dict[str, Any]:
        """Return the options of a sum with this tolerance."""
        by_hand = self.degree is not None and "tol" not in tc.methods.parameters(self.name)
        return {
            "backend": self.name,
            "theta": self.theta,
            "degree": self.degree,
            "leaf_size": self.leaf_size,
            "precision": self.precision,
            "tol": None if by_hand else tolerance,
        }


class _Sources(NamedTuple):
    """Points of one blob size, all with torques or all without, in the fluid."""

    kernel: Any
    rows: np.ndarray

    def strengths(self, loads: np.ndarray) -> np.ndarray:
        """Return the columns of their loads that the kernel takes: forces, and torques."""
        return loads[self.rows, : self.kernel.strength_size]

    def flow(
        self, points: np.ndarray, loads: np.ndarray, targets: np.ndarray, **options: Any
    ) -> np.ndarray:
        """Return the part of the flow at any targets, (M, value_size), by one sum."""
        arguments = self.kernel, points[self.rows], self.strengths(loads), targets
        return tc.evaluate(*arguments, **options)


class _Sum:
    """One fast sum, over some sources at some of the points."""

    def __init__(
        self,
        sources: _Sources,
        targets: np.ndarray,
        bodies: np.ndarray,
        backend: Backend,
        boundary: Boundary,
        comm: Any,
    ) -> None:
        self.sources, self.targets = sources, targets
        self._same = np.array_equal(sources.rows, targets)
        own = bodies[targets]
        self._groups = own if (own != own[0]).any() else None
        self._backend, self._boundary, self._comm = backend, boundary, comm
        self.begin(None)

    def begin(self, choice: tc.Choice | None) -> None:
        """Sum by a choice from now on, or choose anew."""
        options = self._backend.options(self._backend.tolerance)
        where = {"boundary": self._boundary, "comm": self._comm}
        self.plan = tc.Plan(self.sources.kernel, **options, **where)
        if choice is not None:
            self.plan.use(choice)
        self._placed: np.ndarray | None = None

    def __call__(self, points: np.ndarray, loads: np.ndarray, boundary: Boundary) -> np.ndarray:
        strengths = self.sources.strengths(loads)
        if self._placed is None or points is not self._placed or boundary != self._boundary:
            self._boundary = boundary  # an iteration sums many loads at the same points
            self._place(points)
        try:
            return self.plan.execute(strengths)
        except tc.CancellationError:
            self._sum_directly(points)
            return self.plan.execute(strengths)

    def refine(
        self, points: np.ndarray, loads: np.ndarray, tolerance: float, flow: np.ndarray
    ) -> None:
        """Sample the error of the last sum, and choose another way to sum if it is too large."""
        try:
            self.plan.refine(self.sources.strengths(loads), tolerance, flow)
        except tc.CancellationError:
            self._sum_directly(points)

    def _place(self, points: np.ndarray) -> None:
        """Set the sources and the targets among all points."""
        targets = None if self._same else points[self.targets]
        self.plan.set_points(points[self.sources.rows], targets, self._groups, self._boundary)
        self._placed = points

    def _sum_directly(self, points: np.ndarray) -> None:
        """Nothing is more accurate. Bodies at rest have loads that are nothing but rounding."""
        self.plan.use(tc.EXACT)
        self._place(points)


class Mobility:
    """The linear map from forces and torques at points to velocities and angular velocities there.

    A channel is computed only if its load occurs and its motion is wanted: between sources without
    torques and targets without angular velocity the kernel is a regularized Stokeslet, 3 by 3.

    Parameters
    ----------
    viscosity : float
    epsilons : (N,) ndarray
        Blob sizes.
    forced, torqued, spinning : (N,) bool ndarray
        Whether there is a force, and a torque, at a point, and whether its angular velocity is
        wanted.
    bodies : (N,) int ndarray
        The body of each point: the motion of each body, not only of all, is within tolerance.
    backend : Backend
        For each sum.
    boundary : treecode.Boundary, optional
        Of the fluid.
    comm : mpi4py.MPI.Comm, optional
        Ranks that share the sums.

    Attributes
    ----------
    ranks : treecode.ranks.OneRank
    lock : treecode.Lock
        Held by each user of this object and of its parts.
    """

    def __init__(
        self,
        viscosity: float,
        epsilons: np.ndarray,
        forced: np.ndarray,
        torqued: np.ndarray,
        spinning: np.ndarray,
        bodies: np.ndarray,
        backend: Backend,
        boundary: Boundary | None = None,
        comm: Any = None,
    ) -> None:
        self._backend = backend
        self.ranks, self._comm = ranks_of(comm), comm
        self._boundary = boundary or FreeSpace()
        self.lock = tc.Lock()
        self.evaluations = 0
        self._bodies, self._spinning = bodies, spinning
        self._viscosity, self._epsilons, self._torqued = viscosity, epsilons, torqued
        self._sums: list[_Sum] = []
        self._sources: list[_Sources] = []
        # Bodies without forces have their own sums: among the sources their error would not count.
        together = np.where(forced, -1, bodies)
        for epsilon in np.unique(epsilons[forced]):
            for torque in (False, True):
                sources = np.flatnonzero(forced & (epsilons == epsilon) & (torqued == torque))
                if not len(sources):
                    continue
                kernels = [kind(float(epsilon), viscosity) for kind in _KINDS]
                self._sources.append(_Sources(kernels[torque], sources))
                rotlet = spinning | torque
                for body in np.unique(together):
                    for spin in np.unique(rotlet[together == body]):
                        targets = np.flatnonzero((together == body) & (rotlet == spin))
                        part = _Sources(kernels[int(spin)], sources)
                        among = targets, bodies, backend, self._boundary, comm
                        self._sums.append(_Sum(part, *among))

    def __call__(
        self, points: np.ndarray, loads: np.ndarray, boundary: Boundary | None = None
    ) -> np.ndarray:
        """Return velocities and angular velocities, (N, 6), of forces and torques, (N, 6).

        Both are (N, 3) where there are neither torques nor angular velocities. The latter mean
        nothing at points that do not want them. In this method and the others `boundary` is where
        that of the fluid has moved to.
        """
        outs = self._outs(points, loads, boundary or self._boundary)
        self.evaluations += 1
        return self._total(loads, outs)

    def _outs(self, points: np.ndarray, loads: np.ndarray, boundary: Boundary) -> list[np.ndarray]:
        """Return the values of each sum. After a new choice, their total is within tolerance."""
        undecided = [part.plan.choice is None for part in self._sums]
        outs = [part(points, loads, boundary) for part in self._sums]
        if len(outs) == 1 or not any(
            new and part.plan.choice for new, part in zip(undecided, self._sums, strict=True)
        ):
            return outs
        for k, tolerance in enumerate(self._needed(loads, outs)):
            if tolerance < self._backend.tolerance:  # it was sampled for that
                before = self._sums[k].plan.choice
                self._sums[k].refine(points, loads, tolerance, outs[k])
                if self._sums[k].plan.choice != before:
                    outs[k] = self._sums[k](points, loads, boundary)
        return outs

    def _total(self, loads: np.ndarray, outs: list[np.ndarray]) -> np.ndarray:
        values = np.zeros_like(loads)
        for part, out in zip(self._sums, outs, strict=True):
            values[part.targets, : out.shape[1]] += out
        return values

    def _needed(self, loads: np.ndarray, outs: list[np.ndarray]) -> np.ndarray:
        """Return the tolerance of each sum that keeps their total within the backend's tolerance.

        For each body: bodies of two blob sizes, or with and without torques, may cancel.
        """
        total = self._squares(self._total(loads, outs))
        terms = [
            self._squares(out, part.targets) for part, out in zip(self._sums, outs, strict=True)
        ]
        return _shares(self._backend.tolerance, np.array(terms), total)

    def _squares(self, values: np.ndarray, rows: Any = slice(None)) -> np.ndarray:
        """Return the squares of the norms, by body, of velocities and of wanted spins."""
        bodies, spinning = self._bodies[rows], self._spinning[rows]
        count = self._bodies.max() + 1
        velocities = np.bincount(bodies, (values[:, :3] ** 2).sum(axis=1), count)
        spins = np.bincount(bodies, (values[:, 3:] ** 2).sum(axis=1) * spinning, count)
        return np.append(velocities, spins)

    def velocity(
        self,
        points: np.ndarray,
        loads: np.ndarray,
        targets: np.ndarray,
        boundary: Boundary | None = None,
    ) -> np.ndarray:
        """Return the velocity, (M, 3), at any targets, (M, 3).

        The sums are chosen, and their errors sampled, for these targets; a given `degree` is used
        as it is. If contributions cancel to little more than the rounding of doubles, the sums are
        direct ones for any tolerance, since no others are more accurate.
        """
        return self._anywhere(self._sources, slice(0, 3), (points, loads, targets), boundary)

    def vorticity(
        self,
        points: np.ndarray,
        loads: np.ndarray,
        targets: np.ndarray,
        boundary: Boundary | None = None,
    ) -> np.ndarray:
        """Return the curl of the velocity, (M, 3), likewise, of forces and torques, (N, 6)."""
        spinning = [part._replace(kernel=_KINDS[True](*part.kernel)) for part in self._sources]
        flow = points, loads, targets
        return 2.0 * self._anywhere(spinning, slice(3, 6), flow, boundary)

    def pressure(
        self,
        points: np.ndarray,
        loads: np.ndarray,
        targets: np.ndarray,
        boundary: Boundary | None = None,
    ) -> np.ndarray:
        """Return the pressure, (M,), likewise; zero far away.

        Raises
        ------
        ValueError
            If the boundary knows no images of the pressure, as a wall and a periodic box.
        """
        pressing = [
            part._replace(kernel=tc.RegularizedPressure(part.kernel.epsilon))
            for part in self._sources
        ]
        return self._anywhere(pressing, slice(0, 1), (points, loads, targets), boundary)[:, 0]

    def _anywhere(
        self,
        sources: list[_Sources],
        columns: slice,
        flow: tuple[np.ndarray, np.ndarray, np.ndarray],
        boundary: Boundary | None,
    ) -> np.ndarray:
        """Return some columns of the total of sums at any targets, within tolerance."""
        tolerance, where = self._backend.tolerance, boundary or self._boundary

        def once(part: _Sources, tolerance: float) -> np.ndarray:
            options = self._backend.options(tolerance) | {"boundary": where, "comm": self._comm}
            try:
                values = part.flow(*flow, **options)
            except tc.CancellationError:
                values = part.flow(*flow, backend=DIRECT, boundary=where, comm=self._comm)
            return values[:, columns]

        outs = [once(part, tolerance) for part in sources]
        if len(outs) > 1 and self._backend.degree is None:
            squares = np.array([[np.vdot(out, out)] for out in outs])
            total = np.sum(outs, axis=0)
            shares = _shares(tolerance, squares, np.array([np.vdot(total, total)]))
            for k, share in enumerate(shares):
                if share < tolerance:
                    outs[k] = once(sources[k], share)
        return sum(outs, np.zeros((len(flow[2]), columns.stop - columns.start)))

    def matrix(self, rows: np.ndarray, places: np.ndarray, boundary: Boundary) -> np.ndarray:
        """Return the mobility of some of the points alone, a matrix over forces and torques.

        In a periodic box without their images.

        Parameters
        ----------
        rows : (m,) int ndarray
        places : (m, 3) ndarray
        boundary : Boundary

        Returns
        -------
        (6 m, 6 m) ndarray
            (3 m, 3 m) if none of the points has a torque.
        """
        kind = _KINDS[bool(self._torqued[rows].any())]
        within = FreeSpace() if isinstance(boundary, tc.Periodic) else boundary
        size, epsilons = kind.strength_size, self._epsilons[rows]
        out = np.empty((len(rows) * size, len(rows), size))
        for epsilon in np.unique(epsilons):
            own = epsilons == epsilon
            kernel = kind(float(epsilon), self._viscosity)
            columns = tc.matrix(kernel, places[own], places, boundary=within)
            if own.all():
                return columns
            out[:, own] = columns.reshape(len(out), -1, size)
        return out.reshape(len(out), -1)

    def infos(self) -> list[dict[str, Any]]:
        """Return `treecode.Plan.info` of each sum in the last evaluation."""
        return [part.plan.info() for part in self._sums if part.plan.choice is not None]

    @property
    def choices(self) -> list[tc.Choice]:
        """The choice of each sum that has one."""
        choices = (part.plan.choice for part in self._sums)
        return [choice for choice in choices if choice is not None]

    def history(self) -> list[dict[str, Any] | None]:
        """Return the choices made so far, None for sums whose strengths have been zero."""
        choices = (part.plan.choice for part in self._sums)
        return [None if choice is None else choice.as_dict() for choice in choices]

    def restore(self, history: list[dict[str, Any] | None]) -> None:
        """Use earlier choices again: a run that is resumed must not choose by another state."""
        if len(history) != len(self._sums):
            raise ValueError(
                f"checkpoint: {len(history)} sums, those of the scene are {len(self._sums)}"
            )
        for part, choice in zip(self._sums, history, strict=True):
            part.begin(None if choice is None else tc.Choice(**choice))

    def sampled_error(
        self, points: np.ndarray, loads: np.ndarray, boundary: Boundary | None = None
    ) -> float:
        """Return the relative error at randomly drawn points of each body, the largest.

        Of the velocities and of the angular velocities that are wanted.
        """
        if not self._sums:
            return 0.0
        wanted = np.ones_like(loads)
        wanted[~self._spinning, 3:] = 0.0
        where: dict[str, Any] = {"boundary": boundary or self._boundary, "comm": self._comm}
        outs = [part(points, loads, where["boundary"]) for part in self._sums]
        values = wanted * self._total(loads, outs)

        def exact_at(rows: np.ndarray) -> np.ndarray:
            exact = np.zeros((len(rows), loads.shape[1]))
            for part in self._sums:
                own = np.isin(rows, part.targets)
                some = points, loads, points[rows[own]]
                out = part.sources.flow(*some, backend=DIRECT, **where)
                exact[own, : out.shape[1]] += out
            return wanted[rows] * exact

        kernel = _KINDS[loads.shape[1] == 6]
        parts = Parts.of(kernel, len(points), self._bodies)
        return parts.sampled_error(values, exact_at, _SAMPLES).by_unit

    def correct(
        self, points: np.ndarray, loads: np.ndarray, boundary: Boundary | None = None
    ) -> bool:
        """Choose anew where a sum does not reach its tolerance any more; return if so."""
        before = self.choices
        outs = [part(points, loads, boundary or self._boundary) for part in self._sums]
        needed = self._needed(loads, outs) if len(outs) > 1 else [self._backend.tolerance]
        for part, tolerance, out in zip(self._sums, needed, outs, strict=False):
            part.refine(points, loads, tolerance, out)
        return self.choices != before


def _shares(tolerance: float, terms: np.ndarray, total: np.ndarray) -> np.ndarray:
    """Return the relative error that each of several sums may have, at most `tolerance`.

    Their errors are independent and add up in squares: the total is then within tolerance.

    Parameters
    ----------
    tolerance : float
    terms : (sums, parts) ndarray
        Squares of the norms of parts of each sum.
    total : (parts,) ndarray
        Squares of the norms of parts of their total.
    """
    count = np.count_nonzero(terms, axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.sqrt(np.where(terms > 0.0, total / (count * terms), 1.0))
    return np.clip(tolerance * share.min(axis=1), _LEAST_TOLERANCE, tolerance)
