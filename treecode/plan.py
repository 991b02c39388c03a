"""Set the points once, sum many strengths."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType
from typing import Any

import numba
import numpy as np
from tqdm import tqdm

from treecode import check
from treecode.backends import direct, kitc, taylor
from treecode.kernels.base import Kernel
from treecode.traversal import BATCH_SIZE, evaluate_batches, load_weights
from treecode.tree import build_tree

_BACKENDS: dict[str, ModuleType] = {"direct": direct, "kitc": kitc, "taylor": taylor}
_MAX_DEGREE = 40
_SLAB_SECONDS = 0.5  # how long compiled code runs before Python may report, or be interrupted


class Plan:
    """A sum over fixed points: ``out(x_i) = sum_j K(x_i, y_j) q_j``.

    Parameters
    ----------
    kernel : Kernel
        For example ``RegularizedStokeslet(epsilon=0.02)``.
    backend : {"kitc", "taylor", "direct"}, optional
        Kernel-independent treecode, Taylor treecode, or direct summation.
    theta : float, optional
        A cluster of radius r is far from a target at distance R of its centre if
        ``r / R <= theta`` (K eq. 6.1, T eq. 32). Between 0 and 1; smaller is more accurate.
    degree : int, optional
        Degree n of the interpolation ("kitc") or order p of the expansion ("taylor").
    leaf_size : int, optional
        Most points in a leaf of the tree, N0 in the papers.
    progress : bool, optional
        Show a progress bar while summing.

    Raises
    ------
    ValueError, TypeError
        For an argument out of its range; the message names it and says what is allowed.

    Notes
    -----
    The sums use as many threads as ``numba.get_num_threads()``, and do not depend on how many.
    "direct" takes none of `theta`, `degree` and `leaf_size` into account.

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
        degree: int = 7,
        leaf_size: int = 2000,
        progress: bool = False,
    ) -> None:
        self.backend = check.one_of("backend", backend, _BACKENDS)
        self.theta = check.number("theta", theta, 0.0, 1.0)
        self._module = _BACKENDS[backend]
        self.kernel = check.kernel(kernel, backend, self._module.KERNEL_MEMBERS)
        self.degree = check.integer("degree", degree, self._module.MIN_DEGREE, _MAX_DEGREE)
        self.leaf_size = check.integer("leaf_size", leaf_size, 1)
        self.progress = progress
        self._seconds: dict[str, float] = {}
        self._pairs: np.ndarray | None = None

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
        self._seconds = {}
        with self._stage("tree"):
            self._sources = np.array(sources.T, order="C")  # a copy: the tree sorts it
            self._tree, self._order = self._module.build(self._sources, self.leaf_size)
            if targets is None:
                self._targets, self._target_order = self._sources, self._order
            else:
                self._targets = np.array(targets.T, order="C")
                _, self._target_order = build_tree(self._targets, BATCH_SIZE, shrink=False)
            self._distance2 = self._module.distance2(self._tree, self.theta)
            self._expansion = self._module.prepare(self.kernel, self._tree, self.degree)
            self._pairs = None
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
        strengths = check.rows(
            "strengths", strengths, self.kernel.strength_size, self._sources.shape[1]
        )
        values = np.zeros((self._targets.shape[1], self.kernel.value_size))
        batches = -(-len(values) // BATCH_SIZE)
        self._pairs = np.zeros((batches, 2), np.int64)
        if len(strengths) and len(values):
            with self._stage("weights"), _threads_for(len(strengths)):
                weights = np.empty((self.kernel.weight_size, len(strengths)))
                load_weights(self.kernel, strengths, self._order, weights)
                self._module.update(self._expansion, self._tree, self._sources, weights)
            with self._stage("sum"), _threads_for(len(values)):
                for first, last in self._slabs(batches):
                    evaluate_batches(
                        self.kernel,
                        self._expansion,
                        self._tree,
                        self._distance2,
                        self._sources,
                        weights,
                        self._targets,
                        self._target_order,
                        first,
                        last,
                        values,
                        self._pairs,
                    )
        return check.finite("the sum", values)

    def info(self) -> dict[str, Any]:
        """Return what was done: parameters, tree, pair counts, bytes and seconds by stage.

        `near_pairs` (target and source) and `far_pairs` (target and term of an expansion) are
        those of the last `execute`, None before it. `bytes` is what the plan holds between calls.
        """
        self._require_points()
        held = [self._sources, self._order, self._distance2, *self._tree]
        held += [a for a in self._expansion if isinstance(a, np.ndarray)]
        if self._targets is not self._sources:
            held += [self._targets, self._target_order]
        pairs = (None, None) if self._pairs is None else map(int, self._pairs.sum(axis=0))
        near_pairs, far_pairs = pairs
        return {
            "kernel": self.kernel,
            "backend": self.backend,
            "theta": self.theta,
            "degree": self.degree,
            "leaf_size": self.leaf_size,
            "threads": numba.get_num_threads(),
            "sources": self._sources.shape[1],
            "targets": self._targets.shape[1],
            "depth": self._tree.depth,
            "clusters": len(self._tree.radius),
            "near_pairs": near_pairs,
            "far_pairs": far_pairs,
            "bytes": sum(array.nbytes for array in held),
            "seconds": dict(self._seconds),
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
        count = self._targets.shape[1]
        drawn = np.random.default_rng(seed).permutation(count)[:samples]
        exact = (
            Plan(self.kernel, "direct")
            .set_points(self._sources.T, self._targets[:, drawn].T)
            .execute(np.asarray(strengths)[self._order])
        )
        return relative_error(values[self._target_order[drawn]], exact)

    def _require_points(self) -> None:
        if not hasattr(self, "_sources"):
            raise RuntimeError("set_points must be called first")

    @contextmanager
    def _stage(self, name: str) -> Iterator[None]:
        start = time.perf_counter()
        yield
        self._seconds[name] = time.perf_counter() - start

    def _slabs(self, batches: int) -> Iterator[tuple[int, int]]:
        """Cut the batches into slabs of about `_SLAB_SECONDS`."""
        size = numba.get_num_threads()
        first = 0
        with tqdm(total=batches, disable=not self.progress, unit="batch") as bar:
            while first < batches:
                last = min(first + size, batches)
                start = time.perf_counter()
                yield first, last
                elapsed = time.perf_counter() - start
                size = max(size, int((last - first) * min(4.0, _SLAB_SECONDS / elapsed)))
                bar.update(last - first)
                first = last


@contextmanager
def _threads_for(points: int) -> Iterator[None]:
    """Wake no more threads than there are batches of points.

    A sum of 76 points took 0.19 ms on one thread and 10 ms on two while another process computed.
    """
    threads = numba.get_num_threads()
    numba.set_num_threads(min(threads, -(-points // BATCH_SIZE)))
    try:
        yield
    finally:
        numba.set_num_threads(threads)


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
        `backend`, `theta`, `degree`, `leaf_size`, `progress`.

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
