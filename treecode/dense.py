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
    shape = len(wanted), kernel.value_size, len(sources), kernel.strength_size
    total = np.zeros(shape)
    for term in boundary.terms(kernel):
        if not hasattr(term.kernel, "pair"):
            raise ValueError(
                f"boundary must not be periodic, since a lattice sum is none over pairs of points; "
                f"got {boundary}"
            )
        total += _matrix_of(term, kernel.strength_size, sources, wanted)
    return total.reshape(shape[0] * shape[1], shape[2] * shape[3])


def _matrix_of(
    term: Term, strength_size: int, sources: np.ndarray, targets: np.ndarray
) -> np.ndarray:
    """Return the part of one term, (M, value_size, N, strength_size)."""
    own, there = term.columns_of(sources, targets)
    assert there is not None
    count, wanted = own.shape[1], len(targets)
    weights = np.empty((strength_size, term.kernel.weight_size, count))
    for unit, row in zip(np.eye(strength_size), weights, strict=True):
        strengths = term.strengths_of(sources, np.tile(unit, (len(sources), 1)))
        write_weights(term.kernel, strengths, np.arange(count), 0, count, row)
    padded = np.pad(there, ((0, 0), (0, LANES - 1)))
    values = np.empty((strength_size, count, term.kernel.value_size, padded.shape[1]))
    fill(term.kernel, padded, wanted, own, weights, values)
    flow = values[..., :wanted].swapaxes(2, 3)
    if term.values is not None:
        everywhere = np.broadcast_to(targets, (strength_size, count, wanted, 3)).reshape(-1, 3)
        flow = term.flow_of(everywhere, flow.reshape(len(everywhere), -1))
    # Several sources of a term may stand for one point, a row of the points after the other.
    flow = flow.reshape(strength_size, -1, len(sources), wanted, flow.shape[-1]).sum(axis=1)
    return np.asarray(flow.transpose(2, 3, 1, 0))


@Driver
def fill(kernel, targets, wanted, sources, weights, out):
    """Write what each source with each of its weights does to each target.

    Parameters
    ----------
    kernel : Kernel
    targets : (3, M + LANES - 1) float64
    wanted : int
        M.
    sources : (3, n) float64
    weights : (S, weight_size, n) float64
    out : (S, n, value_size, M + LANES - 1) float64
    """
    wide_vectors()
    for s in range(weights.shape[0]):
        for j in range(sources.shape[1]):
            w = weight_column(kernel, weights[s], j)
            values = out[s, j]
            for i in range(0, wanted, LANES):
                dx = load(targets, 0, i) - sources[0, j]
                dy = load(targets, 1, i) - sources[1, j]
                dz = load(targets, 2, i) - sources[2, j]
                acc = pair(kernel, dx, dy, dz, w, zero(kernel, targets))
                for c in range(len(acc)):
                    store(values, c, i, acc[c])
