"""Sums as matrices, of few points: for direct solvers and preconditioners."""

from __future__ import annotations

from typing import Any

import numpy as np

from treecode import check
from treecode._jit import Driver, wide_vectors
from treecode._lanes import LANES, load, store
from treecode.boundaries.base import Boundary, FreeSpace, Term
from treecode.kernels.base import Kernel, pair, weight_column, zero
from treecode.traversal import write_weights


def matrix(
    kernel: Kernel, points: Any, targets: Any = None, *, boundary: Boundary | None = None
) -> np.ndarray:
    """Return the sum over a kernel as a matrix.

    Its product with ``strengths.ravel()`` is ``evaluate(kernel, points, strengths, ...).ravel()``.

    Parameters
    ----------
    kernel : Kernel
    points : (N, 3) array_like
        Sources.
    targets : (M, 3) array_like, optional
        The sources by default.
    boundary : Boundary, optional

    Returns
    -------
    (M * value_size, N * strength_size) float64 ndarray

    Raises
    ------
    ValueError, TypeError
        As by `evaluate`; and if the boundary is periodic, since a lattice sum is none over pairs.

    Examples
    --------
    The drag on a pair of spheres of radius 0.1 that move side by side, with a Stokeslet of that
    blob size at each:

    >>> import numpy as np, treecode as tc
    >>> kernel = tc.RegularizedStokeslet(epsilon=0.1)
    >>> mobility = tc.matrix(kernel, [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    >>> force = np.linalg.solve(mobility, [0.0, 0.0, 1.0, 0.0, 0.0, 1.0])
    >>> print((force.reshape(2, 3).round(3) + 0.0).tolist())
    [[0.0, 0.0, 1.197], [0.0, 0.0, 1.197]]
    """
    boundary = FreeSpace() if boundary is None else boundary
    if not isinstance(boundary, Boundary):
        raise TypeError(f"boundary must be a treecode.Boundary, got {boundary!r}")
    sources = check.points("points", points)
    boundary.require_inside("points", sources)
    wanted = sources if targets is None else check.points("targets", targets)
    boundary.require_inside("targets", wanted)
    shape = len(sources), kernel.strength_size, len(wanted), kernel.value_size
    transpose = np.zeros(shape)
    for term in boundary.terms(kernel):
        if not hasattr(term.kernel, "pair"):
            raise ValueError(
                f"boundary must not be periodic, since a lattice sum is none over pairs of points; "
                f"got {boundary}"
            )
        _add(term, sources, wanted, transpose)
    return transpose.reshape(shape[0] * shape[1], -1).T


def _add(term: Term, sources: np.ndarray, targets: np.ndarray, out: np.ndarray) -> None:
    """Add a term to a transposed matrix, (N, strength_size, M, value_size)."""
    own, there = term.columns_of(sources, targets)
    assert there is not None
    count, strength_size = own.shape[1], out.shape[1]
    weights = np.empty((strength_size, term.kernel.weight_size, count))
    for unit, row in zip(np.eye(strength_size), weights, strict=True):
        strengths = term.strengths_of(sources, np.tile(unit, (len(sources), 1)))
        write_weights(term.kernel, strengths, np.arange(count), 0, count, row)
    flows = None
    if term.values is not None:
        units = np.eye(term.kernel.value_size)
        each = [term.flow_of(targets, np.tile(unit, (len(targets), 1))) for unit in units]
        flows = np.stack(each, axis=1)
    padded = np.pad(there, ((0, 0), (0, LANES - 1)))
    row = np.empty((term.kernel.value_size, padded.shape[1]))
    fill(term.kernel, padded, own, weights, flows, row, out)


@Driver
def fill(kernel, targets, sources, weights, flows, row, out):
    """Add what each source with each of its weights does to each target.

    Parameters
    ----------
    kernel : Kernel
    targets : (3, M + LANES - 1) float64
    sources : (3, n) float64
        All points once, and then again if several sources stand for one.
    weights : (S, weight_size, n) float64
    flows : (M, value_size of the kernel, value_size) float64, or None
        The flow at each target for each value there; None if it is the value.
    row : (value_size of the kernel, M + LANES - 1) float64
        Space for the values of one source.
    out : (N, S, M, value_size) float64
    """
    wide_vectors()
    count, _, wanted, size = out.shape
    for j in range(sources.shape[1]):
        for s in range(weights.shape[0]):
            w = weight_column(kernel, weights[s], j)
            for i in range(0, wanted, LANES):
                dx = load(targets, 0, i) - sources[0, j]
                dy = load(targets, 1, i) - sources[1, j]
                dz = load(targets, 2, i) - sources[2, j]
                acc = pair(kernel, dx, dy, dz, w, zero(kernel, targets))
                for c in range(len(acc)):
                    store(row, c, i, acc[c])
            total = out[j % count, s]
            for i in range(wanted):
                for c in range(size):
                    if flows is None:
                        total[i, c] += row[c, i]
                    else:
                        for d in range(row.shape[0]):
                            total[i, c] += row[d, i] * flows[i, d, c]
