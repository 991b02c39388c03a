"""Set the points once, sum many strengths."""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from treecode import auto, check
from treecode._jit import require_unchanged
from treecode.accuracy import Parts
from treecode.backends.walk import PRECISIONS, Walk
from treecode.fmm import multipole
from treecode.fmm.operators import MAX_DEGREE
from treecode.kernels.base import MEMBERS, Kernel, require_counts
from treecode.locks import Lock, one_at_a_time
from treecode.threads import thread_count

BACKENDS = ("auto", *auto.WALKS, "fmm")
_DEGREES = {name: (module.MIN_DEGREE, 40) for name, module in auto.WALKS.items()}
_DEGREES["fmm"] = multipole.MIN_DEGREE, MAX_DEGREE
_TOLERANCE = 1e-5
_OPTIONS = "backend", "theta", "degree", "leaf_size", "precision", "tol", "progress"
_Number = TypeVar("_Number", int, float)


class Plan:
    """A sum over fixed points: ``out(x_i) = sum_j K(x_i, y_j) q_j``.

    Parameters
    ----------
    kernel : Kernel
        For example ``RegularizedStokeslet(epsilon=0.02)``.
    backend : {"auto", "direct", "kitc", "taylor", "fmm"}, optional
        Direct summation, kernel-independent treecode, Taylor treecode, fast multipole method; or
        "auto", what should be the fastest of these for `tol`.
    theta : float, optional
        For treecodes: a cluster of radius r is far from a target at distance R of its centre if
        ``r / R <= theta`` (K eq. 6.1, T eq. 32). Between 0 and 1; smaller is more accurate. By
        default 0.7, or what suits `tol`.
    degree : int, optional
        Degree n of the interpolation ("kitc") or order p of the expansion ("taylor"), by default
        7, or what `tol` asks for; polynomials in each direction ("fmm"), by default as many as
        `tol` asks for.
    leaf_size : int, optional
        Most points in a leaf of the tree, N0 in the papers: 2000 by default, or what suits `tol`;
        for "fmm" what balances its two halves.
    precision : {"float64", "float32"}, optional
        Of the arithmetic with points and proxies for "direct", "kitc" and "taylor" (not of its
        expansions): float64 by default, or what suits `tol`. float32 is up to twice as fast;
        distances are rounded to 1e-7 of the cluster they are in, and third powers of inverse
        lengths, times strengths, must be within 1e38.
    tol : float, optional
        Relative error in the Euclidean norm, K eq. (8.1), over the targets of each group, for
        values of each unit (velocities, angular velocities) apart; 1e-5 by default for "auto" and
        "fmm", between 1e-13 and 1. The sum is chosen at the first `execute`, which samples its
        error, and stays for as many points and any strengths as long as a few targets, at which
        every longer `execute` looks, show no larger error; or until `refine` samples it again.
        "fmm" by name with a `degree` only aims at it.
    progress : bool, optional
        Show a progress bar while summing.

    Raises
    ------
    ValueError, TypeError
        For an argument out of its range; the message names it and says what is allowed.

    Notes
    -----
    The sums use as many threads as ``numba.get_num_threads()``, and do not depend on how many.
    A plan may be used by several threads, one at a time: others wait. It can be copied and pickled.
    "direct" takes none of `theta`, `degree`, `leaf_size` and `tol` into account, and "auto" chooses
    all but the last itself.

    Examples
    --------
    >>> import numpy as np, treecode as tc
    >>> points = np.random.default_rng(0).random((1000, 3))
    >>> plan = tc.Plan(tc.RegularizedStokeslet(epsilon=0.01), tol=1e-4)
    >>> velocity = plan.set_points(points).execute(np.ones((1000, 3)))
    """

    def __init__(
        self,
        kernel: Kernel,
        backend: str = "auto",
        *,
        theta: float | None = None,
        degree: int | None = None,
        leaf_size: int | None = None,
        precision: str | None = None,
        tol: float | None = None,
        progress: bool = False,
    ) -> None:
        self.backend = check.one_of("backend", backend, BACKENDS)
        self.kernel = check.kernel(kernel, backend, _members(backend))
        require_counts(kernel)
        require_unchanged(type(kernel))
        theta, degree, leaf_size, precision, tol = _check_options(
            "", backend, theta, degree, leaf_size, precision, tol
        )
        self.lock = Lock()
        self._progress = progress
        self._search: auto.Search | None = None
        self._first: auto.Choice | None = None  # of a search, where it does not look for it
        self._sum: Walk | multipole.Multipole | None = None
        self._choice: auto.Choice | None = None
        self._parts: Parts | None = None
        self._counts, self._groups = (0, 0), None
        self._unsorted: tuple[np.ndarray, np.ndarray | None] | None = None
        self._points_set = False
        if backend == "auto":
            chosen = {"theta": theta, "degree": degree, "leaf_size": leaf_size}
            check.absent("with backend 'auto', which chooses it", **chosen, precision=precision)
            backends = auto.able(kernel)
            self._search = auto.Search(kernel, backends, _or(tol, _TOLERANCE), progress=progress)
        elif backend == "fmm":
            check.absent("with backend 'fmm', where tol decides", precision=precision)
            aim = auto.Choice("fmm", None, degree, leaf_size, tol=_or(tol, _TOLERANCE))
            if degree is None:
                self._search = auto.Search(
                    kernel, ("fmm",), _or(tol, _TOLERANCE), None, leaf_size, progress
                )
                self._first, self._sum = aim, aim.sum(kernel, progress)
            else:
                self.use(aim)
        elif backend in auto.DEGREES and tol is not None:
            check.absent("with tol, which chooses it", degree=degree, precision=precision)
            self._search = auto.Search(kernel, (backend,), tol, theta, leaf_size, progress)
        else:
            options = _or(theta, 0.7), _or(degree, 7), _or(leaf_size, 2000)
            self.use(auto.Choice(backend, *options, precision or "float64"))

    def __copy__(self) -> Plan:
        """Return a plan that shares nothing: points of one are not those of the other."""
        return copy.deepcopy(self)

    @property
    def choice(self) -> auto.Choice | None:
        """What sums; None until `tol` has been met for some strengths."""
        if self._choice and isinstance(self._sum, multipole.Multipole):
            return self._choice._replace(width=self._sum.width)
        return self._choice

    @one_at_a_time
    def use(self, choice: auto.Choice) -> None:
        """Sum by an earlier `choice` from the next `set_points` on.

        Raises
        ------
        ValueError, TypeError
            If it is not a choice, or not one for this kernel.
        """
        _check_choice(self.kernel, choice)
        self._choice = choice
        self._sum = choice.sum(self.kernel, self._progress)
        self._parts, self._points_set = None, False

    @one_at_a_time
    def set_points(self, sources: Any, targets: Any = None, groups: Any = None) -> Plan:
        """Sort the points and keep all that does not depend on the strengths.

        Parameters
        ----------
        sources : (N, 3) array_like
            Where the strengths act.
        targets : (M, 3) array_like, optional
            Where the sum is wanted; the sources by default.
        groups : (M,) array_like of int, optional
            The group of each target: `tol` is kept for the targets of each. One by default.

        Returns
        -------
        Plan
            Itself.

        Raises
        ------
        ValueError, TypeError
            If an array has a wrong shape or type, has masked entries, is not finite, or is beyond
            1e60: the plan keeps the points it had. If "fmm" by name does not take the kernel, or
            its operators do not fit in memory: the plan has no points.
        """
        sources = check.points("sources", sources)
        targets = None if targets is None else check.points("targets", targets)
        counts = len(sources), len(sources if targets is None else targets)
        groups = None if groups is None else check.groups(groups, counts[1])
        self._points_set = False  # until all is done
        if self._parts is None or not self._same(counts, groups):
            if self._search and self._parts:
                self._choice = None
                self._sum = self._first and self._first.sum(self.kernel, self._progress)
            self._counts, self._groups = counts, groups
            self._parts = Parts.of(self.kernel, counts[1], groups)
            self._watched = self._parts.watch(auto.WATCHED)
        self._at_watched = (sources if targets is None else targets)[self._watched].T
        columns = _columns(sources), None if targets is None else _columns(targets)
        if self._sum:
            self._sum.set_points(*columns)
            self._unsorted = None
        else:
            self._unsorted = columns
        self._points_set = True
        return self

    def _same(self, counts: tuple[int, int], groups: np.ndarray | None) -> bool:
        """Tell whether these are as many points, in the same groups, as before."""
        if groups is None or self._groups is None:
            return counts == self._counts and groups is self._groups
        return counts == self._counts and np.array_equal(groups, self._groups)

    @one_at_a_time
    def execute(self, strengths: Any) -> np.ndarray:
        """Return the sum for one set of strengths.

        Parameters
        ----------
        strengths : (N, strength_size) array_like
            One row for each source.

        Returns
        -------
        (M, value_size) float64 ndarray
            One row for each target.

        Raises
        ------
        RuntimeError
            If no points have been set.
        ValueError, TypeError
            If the array has a wrong shape or type or is not finite.
        ToleranceError
            If nothing that may be chosen is accurate enough; `CancellationError` if direct sums in
            doubles are not.
        FloatingPointError
            If the sum leaves the range of float64.
        """
        strengths, parts = self._checked(strengths)
        if self._sum is None and not (strengths.any() and len(parts.groups)):
            return np.zeros((len(parts.groups), self.kernel.value_size))  # nothing to choose by
        if self._sum is None:
            return self._choose(self._search, strengths)
        values, weights = self._sum.run(strengths)
        check.finite("the sum", values)
        if self._search and not self._seems_kept(self._search, strengths, weights, values, parts):
            return self._choose(self._search, strengths)
        return values

    @one_at_a_time
    def refine(self, strengths: Any, tol: float | None = None, values: Any = None) -> bool:
        """Sample the error for `strengths`; if it is too large choose anew, and return that.

        Parameters
        ----------
        strengths : (N, strength_size) array_like
        tol : float, optional
            How large it may be, as where the sum is a part of another; that of the plan by default.
        values : (M, value_size) ndarray, optional
            What `execute` has given, if it is known.

        Raises
        ------
        ToleranceError
            If nothing that may be chosen is accurate enough.
        """
        strengths, parts = self._checked(strengths)
        search = self._search
        if not (search and self._sum and strengths.any() and len(parts.groups)):
            return False
        if tol is not None:
            search = replace(search, tolerance=check.number("tol", tol, 1e-13, 1.0))
        if values is None:
            values = self._sum.execute(strengths)
        if search.bound(self._sum, strengths, values, parts) <= search.tolerance:
            self._choice = self._choice or self._first
            return False
        self._choose(search, strengths)
        return True

    def _seems_kept(
        self,
        search: auto.Search,
        strengths: np.ndarray,
        weights: np.ndarray,
        values: np.ndarray,
        parts: Parts,
    ) -> bool:
        """Tell from a few targets, and in doubt from a sample, whether `tol` is kept."""
        assert self._sum is not None
        if self._choice is None:  # never sampled
            if not (strengths.any() and len(parts.groups)):
                return True
        elif auto.is_exact(self._choice) or search.seems_kept(
            self._sum, weights, values, parts, self._watched, self._at_watched
        ):
            return True
        if search.bound(self._sum, strengths, values, parts) > search.tolerance:
            return False
        self._choice = self._choice or self._first
        return True

    def _choose(self, search: auto.Search | None, strengths: np.ndarray) -> np.ndarray:
        assert search is not None
        assert self._parts is not None
        points = self._unsorted or _unsorted(self._sum)
        self._choice, self._sum, values = search(*points, strengths, self._parts)
        self._unsorted = None
        return check.finite("the sum", values)

    @one_at_a_time
    def info(self) -> dict[str, Any]:
        """Return what was done: parameters, tree, pair counts, bytes and seconds by stage.

        `near_pairs` (target and source) and `far_pairs` (target and term of an expansion; for
        "fmm" cube and translation) are those of the last `execute`, None before it. `bytes` is
        what the plan holds between calls.
        """
        self._require_points()
        sources, targets = self._counts
        done = {"near_pairs": None, "far_pairs": None} if self._sum is None else self._sum.info()
        return {
            "kernel": self.kernel,
            "backend": self._choice.backend if self._choice else self.backend,
            "threads": thread_count(),
            "sources": sources,
            "targets": targets,
            **done,
            **({"tol": self._search.tolerance} if self._search else {}),
            "seconds": dict(self._sum.seconds) if self._sum else {},
        }

    @one_at_a_time
    def estimate_error(
        self, strengths: Any, samples: int = 1000, seed: int = 0, *, by_unit: bool = False
    ) -> float:
        """Return the relative error, K eq. (8.1), at randomly drawn targets.

        Of several groups it is the largest.

        Parameters
        ----------
        strengths : (N, strength_size) array_like
        samples : int, optional
            Targets to draw, all of them if there are fewer; of many groups at least 50 of each.
        seed : int, optional
            Of the draw.
        by_unit : bool, optional
            Take velocities and angular velocities apart, and return the larger error.
        """
        check.integer("samples", samples, 1)
        strengths, parts = self._checked(strengths)
        values = self.execute(strengths)
        if self._sum is None:
            return 0.0
        error = auto.sampled_error(self.kernel, self._sum, strengths, values, parts, samples, seed)
        return error.by_unit if by_unit else error.norm

    def _checked(self, strengths: Any) -> tuple[np.ndarray, Parts]:
        parts = self._require_points()
        rows = check.rows("strengths", strengths, self.kernel.strength_size, self._counts[0])
        return rows, parts

    def _require_points(self) -> Parts:
        if not self._points_set or self._parts is None:
            raise RuntimeError("set_points must be called first")
        return self._parts


def _unsorted(
    done: Walk | multipole.Multipole | None,
) -> tuple[np.ndarray, np.ndarray | None]:
    """Return the points of a sum, (3, N) and (3, M), in the order in which they were set."""
    assert done is not None
    sources, targets = np.empty_like(done.sources), np.empty_like(done.targets)
    sources[:, done.source_order] = done.sources
    targets[:, done.target_order] = done.targets
    return sources, None if done.targets is done.sources else targets


def _members(backend: str) -> tuple[str, ...]:
    """Return what a kernel must have for a backend."""
    return auto.WALKS[backend].KERNEL_MEMBERS if backend in auto.WALKS else MEMBERS


def _check_options(
    prefix: str, backend: str, theta: Any, degree: Any, leaf_size: Any, precision: Any, tol: Any
) -> tuple[Any, ...]:
    """Return parameters, all but the first two, as numbers in their range; None is not given."""
    if theta is not None:
        theta = check.number(f"{prefix}theta", theta, 0.0, 1.0)
    if degree is not None:
        degrees = _DEGREES.get(backend, _DEGREES["kitc"])
        degree = check.integer(f"{prefix}degree", degree, *degrees)
    if leaf_size is not None:
        leaf_size = check.integer(f"{prefix}leaf_size", leaf_size, 1)
    if precision is not None:
        check.one_of(f"{prefix}precision", precision, PRECISIONS)
    if tol is not None:
        tol = check.number(f"{prefix}tol", tol, 1e-13, 1.0)
    return theta, degree, leaf_size, precision, tol


def _check_choice(kernel: Kernel, choice: Any) -> None:
    """Refuse what is not a choice, lacks a parameter, or is not for a kernel."""
    if not isinstance(choice, auto.Choice):
        raise TypeError(f"choice must be a treecode.Choice, such as Plan.choice, got {choice!r}")
    backend = check.one_of("choice.backend", choice.backend, BACKENDS[1:])
    check.kernel(kernel, backend, _members(backend))
    needed = {"fmm": ("tol",), "direct": ()}.get(backend, ("theta", "degree", "leaf_size"))
    for name in needed:
        if getattr(choice, name) is None:
            raise ValueError(f"choice.{name} must be given for backend {backend!r}, got {choice!r}")
    _check_options("choice.", *choice[:-1])
    if choice.width is not None:
        check.number("choice.width", choice.width, 0.0, np.inf, low_inclusive=True)


def _columns(points: np.ndarray) -> np.ndarray:
    """Return a copy by coordinates, (3, N): the sums sort it."""
    return np.array(points.T, order="C")


def _or(value: _Number | None, default: _Number) -> _Number:
    return default if value is None else value


def evaluate(
    kernel: Kernel, points: Any, strengths: Any, targets: Any = None, **options: Any
) -> np.ndarray:
    """Return ``sum_j K(x_i, y_j) q_j`` once; see `Plan` for the options and what is raised.

    Parameters
    ----------
    kernel : Kernel
    points : (N, 3) array_like
        Sources.
    strengths : (N, strength_size) array_like
    targets : (M, 3) array_like, optional
        The sources by default.
    **options
        `backend`, `theta`, `degree`, `leaf_size`, `precision`, `tol`, `progress`.

    Returns
    -------
    (M, value_size) float64 ndarray
    """
    if unknown := set(options).difference(_OPTIONS):
        raise TypeError(
            f"evaluate() has the options {', '.join(_OPTIONS)}, got {', '.join(sorted(unknown))}"
        )
    plan = Plan(kernel, **options)
    if plan._search:
        plan._search.sums = 1
    points = check.points("points", points)
    strengths = check.rows("strengths", strengths, kernel.strength_size, len(points))
    return plan.set_points(points, targets).execute(strengths)


def relative_error(values: np.ndarray, exact: np.ndarray) -> float:
    """Return the relative error in the Euclidean norm over all rows and columns, K eq. (8.1)."""
    scale = float(np.linalg.norm(exact))
    error = float(np.linalg.norm(values - exact))
    return error / scale if scale > 0.0 else error
