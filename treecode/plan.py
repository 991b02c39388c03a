"""Set the points once, sum many strengths."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numba
import numpy as np

from treecode import check
from treecode.backends import direct, kitc, taylor
from treecode.backends.walk import Walk
from treecode.fmm import multipole
from treecode.fmm.operators import MAX_DEGREE
from treecode.kernels.base import Kernel

_WALKS: dict[str, ModuleType] = {"direct": direct, "kitc": kitc, "taylor": taylor}
BACKENDS = (*_WALKS, "fmm")
_MAX_DEGREE = 40


class Plan:
    """A sum over fixed points: ``out(x_i) = sum_j K(x_i, y_j) q_j``.

    Parameters
    ----------
    kernel : Kernel
        For example ``RegularizedStokeslet(epsilon=0.02)``.
    backend : {"kitc", "taylor", "direct", "fmm"}, optional
        Kernel-independent treecode, Taylor treecode, direct summation, or fast multipole method.
    theta : float, optional
        For treecodes: a cluster of radius r is far from a target at distance R of its centre if
        ``r / R <= theta`` (K eq. 6.1, T eq. 32). Between 0 and 1; smaller is more accurate.
    degree : int, optional
        Degree n of the interpolation ("kitc") or order p of the expansion ("taylor"), 7 by default;
        polynomials in each direction ("fmm"), by default as many as `tol` asks for.
    leaf_size : int, optional
        Most points in a leaf of the tree, N0 in the papers: 2000 by default, for "fmm" what
        balances its two halves.
    tol : float, optional
        For "fmm": the relative error, K eq. (8.1), to aim at. Between 1e-13 and 1.
    progress : bool, optional
        Show a progress bar while summing.

    Raises
    ------
    ValueError, TypeError
        For an argument out of its range; the message names it and says what is allowed.

    Notes
    -----
    The sums use as many threads as ``numba.get_num_threads()``, and do not depend on how many.
    "direct" takes none of `theta`, `degree`, `leaf_size` and `tol` into account.

    Examples
    --------
    >>> import numpy as np, treecode as tc
    >>> points = np.random.default_rng(0).random((1000, 3))
    >>> plan = tc.Plan(tc.RegularizedStokeslet(epsilon=0.01), backend="kitc")
    >>> velocity = plan.set_points(points).execute(np.ones((1000, 3)))
    """

    def __init__(
        self,
        kernel: Kernel,
        backend: str = "kitc",
        *,
        theta: float = 0.7,
        degree: int | None = None,
        leaf_size: int | None = None,
        tol: float = 1e-5,
        progress: bool = False,
    ) -> None:
        self.backend = check.one_of("backend", backend, BACKENDS)
        theta = check.number("theta", theta, 0.0, 1.0)
        tol = check.number("tol", tol, 1e-13, 1.0)
        module = _WALKS.get(backend)
        members = (module or multipole).KERNEL_MEMBERS
        self.kernel = check.kernel(kernel, backend, members)
        if degree is not None:
            low, high = (
                (module.MIN_DEGREE, _MAX_DEGREE) if module else (multipole.MIN_DEGREE, MAX_DEGREE)
            )
            degree = check.integer("degree", degree, low, high)
        if leaf_size is not None:
            leaf_size = check.integer("leaf_size", leaf_size, 1)
        self._sum: Walk | multipole.Multipole
        if module:
            self._sum = Walk(module, kernel, theta, _or(degree, 7), _or(leaf_size, 2000), progress)
        else:
            self._sum = multipole.Multipole(kernel, tol, degree, leaf_size, progress)

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
        self._sum.set_points(_columns(sources), None if targets is None else _columns(targets))
        self._counts = len(sources), len(sources if targets is None else targets)
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
        FloatingPointError
            If the sum leaves the range of float64.
        """
        self._require_points()
        size = self.kernel.strength_size
        strengths = check.rows("strengths", strengths, size, self._counts[0])
        return check.finite("the sum", self._sum.execute(strengths))

    def info(self) -> dict[str, Any]:
        """Return what was done: parameters, tree, pair counts, bytes and seconds by stage.

        `near_pairs` (target and source) and `far_pairs` (target and term of an expansion; for
        "fmm" cube and translation) are those of the last `execute`, None before it. `bytes` is
        what the plan holds between calls.
        """
        self._require_points()
        return {
            "kernel": self.kernel,
            "backend": self.backend,
            "threads": numba.get_num_threads(),
            "sources": self._counts[0],
            "targets": self._counts[1],
            **self._sum.info(),
            "seconds": dict(self._sum.seconds),
        }

    def estimate_error(self, strengths: Any, samples: int = 1000, seed: int = 0) -> float:
        """Return the relative error, K eq. (8.1), at randomly drawn targets.

        Parameters
        ----------
        strengths : (N, strength_size) array_like
        samples : int, optional
            Targets to draw, all of them if there are fewer.
        seed : int, optional
            Of the draw.
        """
        check.integer("samples", samples, 1)
        values = self.execute(strengths)
        drawn = np.random.default_rng(seed).permutation(self._counts[1])[:samples]
        done = self._sum
        direct_plan = Plan(self.kernel, "direct").set_points(
            done.sources.T, done.targets[:, drawn].T
        )
        exact = direct_plan.execute(np.asarray(strengths)[done.source_order])
        return relative_error(values[done.target_order[drawn]], exact)

    def _require_points(self) -> None:
        if not hasattr(self, "_counts"):
            raise RuntimeError("set_points must be called first")


def _columns(points: np.ndarray) -> np.ndarray:
    """Return a copy by coordinates, (3, N): the sums sort it."""
    return np.array(points.T, order="C")


def _or(value: int | None, default: int) -> int:
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
        `backend`, `theta`, `degree`, `leaf_size`, `tol`, `progress`.

    Returns
    -------
    (M, value_size) float64 ndarray
    """
    plan = Plan(kernel, **options)
    points = check.points("sources", points)
    strengths = check.rows("strengths", strengths, kernel.strength_size, len(points))
    return plan.set_points(points, targets).execute(strengths)


def relative_error(values: np.ndarray, exact: np.ndarray) -> float:
    """Return the relative error in the Euclidean norm over all rows and columns, K eq. (8.1)."""
    scale = float(np.linalg.norm(exact))
    error = float(np.linalg.norm(values - exact))
    return error / scale if scale > 0.0 else error
