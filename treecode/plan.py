"""Set the points once, sum many strengths."""

from __future__ import annotations

import copy
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from treecode import check
from treecode._jit import require_unchanged
from treecode.accuracy import Parts
from treecode.boundaries.base import Boundary, FreeSpace, columns
from treecode.choice.sampling import WATCHED, in_given_order, sampled_error, seems_kept
from treecode.choice.search import Search
from treecode.choice.spread import SpreadSearch
from treecode.kernels.base import Kernel, require_counts
from treecode.locks import Lock, one_at_a_time
from treecode.methods import registry
from treecode.methods.base import KEYWORDS, Sum
from treecode.methods.direct import EXACT
from treecode.methods.registry import AUTO, Choice
from treecode.ranks import in_step, ranks_of
from treecode.shared_sum import made, require_all_or_none, require_spread, spread
from treecode.shown import Shown
from treecode.threads import thread_count


class Plan(Shown):
    """A sum over fixed points: ``out(x_i) = sum_j K(x_i, y_j) q_j``.

    Parameters
    ----------
    kernel : Kernel
        For example ``RegularizedStokeslet(epsilon=0.02)``.
    backend : str, optional
        One of `treecode.backends()`: the name of a method (direct summation, kernel-independent
        treecode, Taylor treecode, fast multipole method, Ewald's method for a periodic kernel, or
        one that was registered), or "auto", what should be the fastest of these for `tol`.
    theta : float, optional
        For treecodes: a cluster of radius r is far from a target at distance R of its centre if
        ``r / R <= theta`` (K eq. 6.1, T eq. 32). Between 0 and 1; smaller is more accurate. By
        default 0.7, or what suits `tol`.
    degree : int, optional
        Degree n of the interpolation or order p of the Taylor expansion, by default 7, or what
        `tol` asks for; of the fast multipole method the polynomials in each direction, by default
        as many as `tol` asks for.
    leaf_size : int, optional
        Most points in a leaf of the tree, N0 in the papers: 2000 by default, or what suits `tol`;
        for the fast multipole method what balances its two halves.
    precision : {"float64", "float32"}, optional
        Of the arithmetic with points and proxies in direct sums and treecodes (not of Taylor
        expansions): float64 by default, or what suits `tol`. float32 is up to twice as fast;
        distances are rounded to 1e-7 of the cluster they are in, and third powers of inverse
        lengths, times strengths, must be within 1e38.
    tol : float, optional
        Relative error in the Euclidean norm, K eq. (8.1), over the targets of each group, for
        values of each unit (velocities, angular velocities) apart; between 1e-13 and 1, by default
        1e-5 for "auto", the fast multipole method and Ewald's. The sum is chosen at the first
        `execute`, which samples its error, and stays for as many points and any strengths as long
        as a few targets, at which every longer `execute` looks, show no larger error; or until
        `refine` samples it again. Periodic sums are sampled by the first `execute` and `refine`.
        The fast multipole method by name with a `degree` only aims at it.
    progress : bool, optional
        Show a progress bar while summing.
    comm : mpi4py.MPI.Comm, optional
        Ranks of MPI that share the sum. All of them make the same calls with the same arguments,
        and get the same values, or the same error. See docs/mpi.md.
    boundary : Boundary, optional
        Of the fluid, for example `Wall`; free space by default.
    distributed : bool, optional
        Whether each rank gives points and strengths of its own, and gets the values at its own
        targets: for the fast multipole method by name. `tol` is kept over the targets of all.

    Raises
    ------
    ValueError, TypeError
        For an argument out of its range; the message names it and says what is allowed.

    Notes
    -----
    The sums use as many threads as ``numba.get_num_threads()``, and do not depend on how many.
    A plan may be used by several threads, one at a time: others wait. It can be copied and pickled;
    one that ranks share can be copied only.
    A method looks at the parameters that it declares (`treecode.methods.parameters`): direct
    summation takes none of `theta`, `degree`, `leaf_size` and `tol` into account, and "auto"
    chooses all but the last itself.

    Examples
    --------
    >>> import numpy as np
    >>> import treecode as tc
    >>> points = np.random.default_rng(0).random((1000, 3))
    >>> plan = tc.Plan(tc.RegularizedStokeslet(epsilon=0.01), tol=1e-4).set_points(points)
    >>> velocity = plan.execute(np.ones((1000, 3)))
    >>> plan.estimate_error(np.ones((1000, 3))) < 1e-4
    True
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
        boundary: Boundary | None = None,
        comm: Any = None,
        distributed: bool = False,
    ) -> None:
        self.ranks = ranks_of(comm)
        self.backend = check.one_of("backend", backend, registry.backends())
        if distributed:
            require_spread(backend)
        self._spread = bool(distributed) and self.ranks.size > 1
        self.boundary = FreeSpace() if boundary is None else boundary
        if not isinstance(self.boundary, Boundary):
            raise TypeError(f"boundary must be a treecode.Boundary, got {boundary!r}")
        free = isinstance(self.boundary, FreeSpace)
        self.kernel = registry.require_kernel(kernel, backend if free else AUTO)
        require_counts(kernel)
        require_unchanged(type(kernel))
        self._bounded = self.boundary.bounded(kernel)
        registry.require_within(self._bounded, backend, self.boundary)
        self.lock = Lock()
        self._progress = progress
        self._search: Search | None = None
        self._first: Choice | None = None  # where a search does not begin with offers
        self._choice: Choice | None = None
        self._sum: Sum | None = None
        self._parts: Parts | None = None
        self._counts, self._groups = (0, 0), None
        self._unsorted: tuple[np.ndarray, np.ndarray | None] | None = None
        self._points_set = False
        given = {"theta": theta, "degree": degree, "leaf_size": leaf_size, "precision": precision}
        self._begin(registry.checked_keywords(backend, {**given, "tol": tol}))

    def _begin(self, given: dict[str, Any]) -> None:
        """Make the sum that is given, or prepare the search for one."""
        tol = given.get("tol", KEYWORDS["tol"].default)
        kind = SpreadSearch if self._spread else Search
        search = partial(kind, self._bounded, progress=self._progress, ranks=self.ranks)
        if self.backend == AUTO:
            chosen = {name: given.get(name) for name in KEYWORDS if name != "tol"}
            check.absent(f"with backend {AUTO!r}, which chooses it", **chosen)
            self._search = search(registry.able(self._bounded), tol)
            return
        method = registry.method_for(self._bounded, self.backend)
        method.refuse(given)
        first = method.first(given)
        if method.seeks(given):
            given = {**given, "tol": tol}
            self._search = search((method,), tol, given)
        if first is not None:
            registry.require_complete(method, first)
            self._first = Choice(method.name, **first)
            self._sum = self._made(self._first)
            self._choice = None if self._search else self._first

    def _made(self, choice: Choice) -> Sum:
        kind = spread if self._spread else made
        return kind(choice, self._bounded, self.ranks, self._progress)

    def __copy__(self) -> Plan:
        """Return a plan that shares nothing: points of one are not those of the other."""
        return copy.deepcopy(self)

    @property
    def choice(self) -> Choice | None:
        """What sums; None until `tol` has been met for some strengths."""
        if self._choice is None or self._sum is None:
            return None
        return Choice(self._choice.backend, **self._sum.parameters)

    @one_at_a_time
    @in_step
    def use(self, choice: Choice) -> None:
        """Sum by an earlier `choice` from the next `set_points` on.

        Raises
        ------
        ValueError, TypeError
            If it is not a choice, or not one for this kernel.
        """
        self._choice = registry.require_choice(choice, self._bounded)
        self._sum = self._made(choice)
        self._parts, self._points_set = None, False

    @one_at_a_time
    @in_step
    def set_points(
        self, sources: Any, targets: Any = None, groups: Any = None, boundary: Any = None
    ) -> Plan:
        """Sort the points and keep all that does not depend on the strengths.

        Parameters
        ----------
        sources : (N, 3) array_like
            Where the strengths act.
        targets : (M, 3) array_like, optional
            Where the sum is wanted; the sources by default.
        groups : (M,) array_like of int, optional
            The group of each target: `tol` is kept for the targets of each. One by default.
        boundary : Boundary, optional
            Where that of the plan is now, of the same kind: a box that is sheared. It stays until
            another is given, and so does the choice of a method.

        Returns
        -------
        Plan
            Itself.

        Raises
        ------
        ValueError, TypeError
            If an array has a wrong shape or type, has masked entries, is not finite, or is beyond
            1e60, or the boundary is of another kind: the plan keeps the points it had. If a method
            by name does not take the kernel,
            or what it builds does not fit in memory: the plan has no points.
        """
        boundary = self.boundary if boundary is None else boundary
        if type(boundary) is not type(self.boundary):
            raise TypeError(f"boundary must be of the kind of {self.boundary}, got {boundary!r}")
        sources = check.points("sources", sources)
        boundary.require_inside("sources", sources)
        if targets is not None:
            targets = check.points("targets", targets)
            boundary.require_inside("targets", targets)
        counts = len(sources), len(sources if targets is None else targets)
        groups = None if groups is None else check.groups(groups, counts[1])
        if self._spread:
            check.absent("with distributed=True", groups=groups)
            require_all_or_none(self.ranks, targets)
        else:
            self.ranks.require_same(sources=sources, targets=targets, groups=groups)
        self._points_set = False  # until all is done
        if boundary is not self.boundary:
            self._move(boundary)
        same = self._parts is not None and self._same(counts, groups)
        if self._spread:
            same = all(self.ranks.exchange(same))
        if not same:
            if self._search and self._parts:
                self._choice = None
                self._sum = self._made(self._first) if self._first else None
            self._counts, self._groups = counts, groups
            over = self.ranks if self._spread else None
            self._parts = Parts.of(self.kernel, counts[1], groups, over)
            self._watched = self._parts.watch(WATCHED)
        self._at_watched = (sources if targets is None else targets)[self._watched].T
        points = columns(sources), None if targets is None else columns(targets)
        if self._sum:
            self._sum.set_points(*points)
            self._unsorted = None
        else:
            self._unsorted = points
        self._points_set = True
        return self

    def _move(self, boundary: Boundary) -> None:
        """Take another boundary of the same kind, and sum by the same choice within it."""
        choice = self.choice or self._first
        self.boundary, self._bounded = boundary, boundary.bounded(self.kernel)
        if self._search:
            self._search = replace(self._search, kernel=self._bounded)
        if self._sum and choice:
            self._sum = self._made(choice)

    def _same(self, counts: tuple[int, int], groups: np.ndarray | None) -> bool:
        """Tell whether these are as many points, in the same groups, as before."""
        if groups is None or self._groups is None:
            return counts == self._counts and groups is self._groups
        return counts == self._counts and np.array_equal(groups, self._groups)

    @one_at_a_time
    @in_step
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
        if self._sum is None and not self._any(strengths, parts):
            return np.zeros((len(parts.groups), self.kernel.value_size))  # nothing to choose by
        if self._sum is None:
            return self._choose(self._search, strengths)
        values = check.finite("the sum", self._sum.execute(strengths))
        if self._search and not self._seems_kept(self._search, strengths, values, parts):
            return self._choose(self._search, strengths)
        return values

    @one_at_a_time
    @in_step
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
        if not (search and self._sum and self._any(strengths, parts)):
            return False
        if tol is not None:
            search = replace(search, tol=KEYWORDS["tol"].check("tol", tol))
        if values is None:
            values = self._sum.execute(strengths)
        if search.bound(self._sum, strengths, values, parts) <= search.tol:
            self._choice = self._choice or self._first
            return False
        self._choose(search, strengths)
        return True

    def _any(self, strengths: np.ndarray, parts: Parts) -> bool:
        """Tell whether there is anything to sum, and anywhere."""
        some = [bool(strengths.any()), len(parts.groups) > 0]
        return all(np.any(self.ranks.exchange(some), axis=0) if self._spread else some)

    def _seems_kept(
        self, search: Search, strengths: np.ndarray, values: np.ndarray, parts: Parts
    ) -> bool:
        """Tell from a few targets, and in doubt from a sample, whether `tol` is kept."""
        assert self._sum is not None
        if self._choice is None:  # never sampled
            if not self._any(strengths, parts):
                return True
        elif self._choice == EXACT:
            return True
        else:
            watched = self._watched, self._at_watched, self.ranks
            if seems_kept(self._bounded, self._sum, search.tol, strengths, values, parts, *watched):
                return True
        if search.bound(self._sum, strengths, values, parts) > search.tol:
            return False
        self._choice = self._choice or self._first
        return True

    def _choose(self, search: Search | None, strengths: np.ndarray) -> np.ndarray:
        assert search is not None
        assert self._parts is not None
        points = self._unsorted
        if points is None:
            assert self._sum is not None
            points = in_given_order(self._sum)
        self._choice, self._sum, values = search(*points, strengths, self._parts)
        self._unsorted = None
        return check.finite("the sum", values)

    @one_at_a_time
    def info(self) -> dict[str, Any]:
        """Return what was done: parameters, tree, pair counts, bytes and seconds by stage.

        `near_pairs` (target and source) and `far_pairs` (target and term of an expansion; in the
        fast multipole method cube and translation) are those of the last `execute`, None before it.
        `bytes` is what the plan holds between calls, `received_bytes` what other ranks have sent.
        """
        self._require_points()
        of_sum = {"near_pairs": None, "far_pairs": None} if self._sum is None else self._sum.info()
        return {
            "kernel": self.kernel,
            "backend": self._choice.backend if self._choice else self.backend,
            "threads": thread_count(),
            **dict(zip(("sources", "targets"), self._counts, strict=True)),
            **of_sum,
            **({"tol": self._search.tol} if self._search else {}),
            "seconds": dict(self._sum.seconds) if self._sum else {},
        }

    def shown(self) -> dict[str, Any]:
        counts = dict(zip(("sources", "targets"), self._counts, strict=True))
        return {"kernel": self.kernel, "backend": self.choice or self.backend, **counts}

    @one_at_a_time
    @in_step
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
        error = sampled_error(
            self._bounded, self._sum, strengths, values, parts, samples, seed, ranks=self.ranks
        )
        return error.by_unit if by_unit else error.norm

    def _checked(self, strengths: Any) -> tuple[np.ndarray, Parts]:
        parts = self._require_points()
        rows = check.rows("strengths", strengths, self.kernel.strength_size, self._counts[0])
        if not self._spread:
            self.ranks.require_same(strengths=rows)
        return rows, parts

    def _require_points(self) -> Parts:
        if not self._points_set or self._parts is None:
            raise RuntimeError("set_points must be called first")
        return self._parts
