"""Set the points once, sum many strengths."""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np

from treecode import auto, check
from treecode._jit import require_unchanged
from treecode.backends.walk import PRECISIONS, Walk
from treecode.fmm import multipole
from treecode.fmm.operators import MAX_DEGREE
from treecode.kernels.base import MEMBERS, Kernel, require_counts
from treecode.threads import thread_count

BACKENDS = ("auto", *auto.WALKS, "fmm")
_DEGREES = {name: (module.MIN_DEGREE, 40) for name, module in auto.WALKS.items()}
_DEGREES["fmm"] = multipole.MIN_DEGREE, MAX_DEGREE
_TOLERANCE = 1e-5
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
        Relative error, K eq. (8.1), of the sum, and of velocities and angular velocities each;
        1e-5 by default for "auto" and "fmm". Between 1e-13 and 1. "fmm" by name aims at it; else
        the sum is chosen at the first `execute`, which samples its error, and stays for as many
        points and any strengths until `refine` samples it again.
    progress : bool, optional
        Show a progress bar while summing.

    Raises
    ------
    ValueError, TypeError
        For an argument out of its range; the message names it and says what is allowed.

    Notes
    -----
    The sums use as many threads as ``numba.get_num_threads()``, and do not depend on how many.
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
        members = auto.WALKS[backend].KERNEL_MEMBERS if backend in auto.WALKS else MEMBERS
        self.kernel = check.kernel(kernel, backend, members)
        require_counts(kernel)
        require_unchanged(type(kernel))
        if theta is not None:
            theta = check.number("theta", theta, 0.0, 1.0)
        if degree is not None:
            degree = check.integer("degree", degree, *_DEGREES.get(backend, _DEGREES["kitc"]))
        if leaf_size is not None:
            leaf_size = check.integer("leaf_size", leaf_size, 1)
        if precision is not None:
            check.one_of("precision", precision, PRECISIONS)
        if tol is not None:
            tol = check.number("tol", tol, 1e-13, 1.0)
        self._progress = progress
        self._search: auto.Search | None = None
        self._sum: Walk | multipole.Multipole | None = None
        self._choice: auto.Choice | None = None
        self._counts: tuple[int, int] | None = None
        if backend == "auto":
            chosen = {"theta": theta, "degree": degree, "leaf_size": leaf_size}
            check.absent("with backend 'auto', which chooses it", **chosen, precision=precision)
            backends = auto.able(kernel)
            self._search = auto.Search(kernel, backends, _or(tol, _TOLERANCE), progress=progress)
        elif backend in auto.DEGREES and tol is not None:
            check.absent("with tol, which chooses it", degree=degree, precision=precision)
            self._search = auto.Search(kernel, (backend,), tol, theta, leaf_size, progress)
        elif backend == "fmm":
            check.absent("with backend 'fmm', where tol decides", precision=precision)
            self.use(auto.Choice("fmm", None, degree, leaf_size, tol=_or(tol, _TOLERANCE)))
        else:
            options = _or(theta, 0.7), _or(degree, 7), _or(leaf_size, 2000)
            self.use(auto.Choice(backend, *options, precision or "float64"))

    @property
    def choice(self) -> auto.Choice | None:
        """What sums; None until `tol` has been met for some strengths."""
        if self._choice and isinstance(self._sum, multipole.Multipole):
            return self._choice._replace(width=self._sum.width)
        return self._choice

    def use(self, choice: auto.Choice) -> None:
        """Sum by an earlier `choice` from the next `set_points` on."""
        self._choice = choice
        self._sum = choice.sum(self.kernel, self._progress)

    def set_points(self, sources: Any, targets: Any = None) -> Plan:
        """Sort the points and keep all that does not depend on the strengths.

        Parameters
        ----------
        sources : (N, 3) array_like
            Where the strengths act.
        targets : (M, 3) array_like, optional
            Where the sum is wanted; the sources by default.

        Returns
        -------
        Plan
            Itself.

        Raises
        ------
        ValueError, TypeError
            If an array has a wrong shape or type, is not finite, or is beyond 1e60.
        """
        sources = check.points("sources", sources)
        targets = None if targets is None else check.points("targets", targets)
        counts = len(sources), len(sources if targets is None else targets)
        if self._search and self._counts not in (None, counts):
            self._choice = self._sum = None
        self._counts = counts
        columns = _columns(sources), None if targets is None else _columns(targets)
        if self._sum:
            self._sum.set_points(*columns)
        else:
            self._unsorted = columns
        return self

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
            If nothing that may be chosen is accurate enough.
        FloatingPointError
            If the sum leaves the range of float64.
        """
        strengths = self._checked(strengths)
        if self._sum:
            values = self._sum.execute(strengths)
        elif self._search and strengths.any() and self._require_points()[1]:
            values = self._choose(self._search, strengths)
        else:  # nothing to choose by
            values = np.zeros((self._require_points()[1], self.kernel.value_size))
        return check.finite("the sum", values)

    def refine(self, strengths: Any) -> bool:
        """Sample the error for `strengths`; if it is beyond `tol` choose anew, and return that.

        Raises
        ------
        ToleranceError
            If nothing that may be chosen is accurate enough.
        """
        strengths = self._checked(strengths)
        if not (self._search and self._sum and strengths.any()):
            return False
        values = self._sum.execute(strengths)
        if self._search.bound(self._sum, strengths, values) <= self._search.tolerance:
            return False
        self._unsorted = _unsorted(self._sum)
        self._choose(self._search, strengths)
        return True

    def _choose(self, search: auto.Search, strengths: np.ndarray) -> np.ndarray:
        self._choice, self._sum, values = search(*self._unsorted, strengths)
        del self._unsorted
        return values

    def info(self) -> dict[str, Any]:
        """Return what was done: parameters, tree, pair counts, bytes and seconds by stage.

        `near_pairs` (target and source) and `far_pairs` (target and term of an expansion; for
        "fmm" cube and translation) are those of the last `execute`, None before it. `bytes` is
        what the plan holds between calls.
        """
        sources, targets = self._require_points()
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

    def estimate_error(
        self, strengths: Any, samples: int = 1000, seed: int = 0, *, by_unit: bool = False
    ) -> float:
        """Return the relative error, K eq. (8.1), at randomly drawn targets.

        Parameters
        ----------
        strengths : (N, strength_size) array_like
        samples : int, optional
            Targets to draw, all of them if there are fewer.
        seed : int, optional
            Of the draw.
        by_unit : bool, optional
            Take velocities and angular velocities apart, and return the larger error.
        """
        check.integer("samples", samples, 1)
        strengths = self._checked(strengths)
        values = self.execute(strengths)
        if self._sum is None:
            return 0.0
        error = auto.sampled_error(self.kernel, self._sum, strengths, values, samples, seed)
        return error.by_unit if by_unit else error.norm

    def _checked(self, strengths: Any) -> np.ndarray:
        size = self.kernel.strength_size
        return check.rows("strengths", strengths, size, self._require_points()[0])

    def _require_points(self) -> tuple[int, int]:
        if self._counts is None:
            raise RuntimeError("set_points must be called first")
        return self._counts


def _unsorted(
    done: Walk | multipole.Multipole,
) -> tuple[np.ndarray, np.ndarray | None]:
    """Return the points of a sum, (3, N) and (3, M), in the order in which they were set."""
    sources, targets = np.empty_like(done.sources), np.empty_like(done.targets)
    sources[:, done.source_order] = done.sources
    targets[:, done.target_order] = done.targets
    return sources, None if done.targets is done.sources else targets


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
    plan = Plan(kernel, **options)
    if plan._search:
        plan._search.sums = 1
    points = check.points("sources", points)
    strengths = check.rows("strengths", strengths, kernel.strength_size, len(points))
    return plan.set_points(points, targets).execute(strengths)


def relative_error(values: np.ndarray, exact: np.ndarray) -> float:
    """Return the relative error in the Euclidean norm over all rows and columns, K eq. (8.1)."""
    scale = float(np.linalg.norm(exact))
    error = float(np.linalg.norm(values - exact))
    return error / scale if scale > 0.0 else error
