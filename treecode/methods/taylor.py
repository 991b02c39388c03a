"""Taylor treecode: Cartesian expansions about the centres of clusters (T sections 3 to 5).

All kernels here are made of derivatives of one function, psi = 1/R with R^2 = |x - y|^2 + eps^2
(eps = 0 gives the singular kernels of T). The recurrence T eq. (15) gives the derivatives
of psi, because it holds with R in place of the distance. With chi = psi + eps^2 psi^3 / 2 and
nabla = d/dy, r = x - y::

    regularized Stokeslet  u = (2 chi - psi) f + (r . f) nabla psi
    rotlet, and w from f   n x nabla chi,  f x nabla chi
    w from n               [(n . nabla) nabla chi - n nabla^2 chi] / 2

and chi = [3 psi - (r . nabla) psi] / 2 needs no power of psi but the first. Derivatives are not
divided by factorials here; the moments are.

A factor r = (x - centre) - (y - centre) in front of a derivative splits into a factor of the
target and one that goes into moments of the next order ("contractions" below). This is T eqs. (26)
and (31) with their sums over shifted derivatives done once a cluster, not once a target.
"""

from __future__ import annotations

from functools import cache, partial
from itertools import product
from math import comb
from typing import Any, NamedTuple, Protocol

import numpy as np

from treecode import check
from treecode._jit import (
    inlined,
    method_hook,
    stack_array,
    standalone,
    wide_vectors,
)
from treecode._lanes import inverse_sqrt
from treecode.kernels.base import COLUMNS, MEMBERS, Kernel
from treecode.methods.base import KEYWORDS
from treecode.methods.treecode import Treecode
from treecode.tree import Tree, build_tree

NAME = "taylor"

# A Taylor polynomial may be a constant.
_ORDER = KEYWORDS["degree"]._replace(check=partial(check.integer, low=0, high=40))


class TaylorKernel(Kernel, Protocol):
    """The members that a kernel needs besides `Kernel` to have Taylor expansions.

    Attributes
    ----------
    derivatives : int
        Highest derivative of psi in the kernel.
    contractions : tuple of (int, int, int)
        For each triple (a, b, c) of weights, the factor ``w_a r_1 + w_b r_2 + w_c r_3`` is needed.
    weight_lengths, value_lengths : tuple of int
        With lengths L times larger, value i of weight j is
        ``L**(value_lengths[i] + weight_lengths[j])`` times smaller.
    """

    derivatives: int
    contractions: tuple[tuple[int, int, int], ...]
    weight_lengths: tuple[int, ...]
    value_lengths: tuple[int, ...]

    def taylor(self, k, up, psi, chi, x, m, out) -> None:
        """Add the terms of multi-index number `k` to ``out[:, :COLUMNS]``.

        ``up[i, k]`` is the number of k + e_i; `psi` and `chi` hold the derivatives (number of
        the multi-index, column); `x` the vectors from the centre to the targets (3, COLUMNS); `m`
        the moments (weights, then contractions; number of the multi-index).
        """


@method_hook
def taylor(self: Any, k, up, psi, chi, x, m, out) -> None:
    """Add the terms of one multi-index to the sums of all columns."""
    self.taylor(k, up, psi, chi, x, m, out)


class Expansion(NamedTuple):
    """Moments of the clusters and the tables of multi-indices.

    Multi-indices k = (k1, k2, k3) are numbered by increasing ``k1 + k2 + k3`` (the "flattened"
    arrays of T section 6.1.1).

    Attributes
    ----------
    summed, inner, outer : int
        Numbers of multi-indices with a sum up to the order, one for each term that is summed; up to
        the highest derivative of chi; and up to the highest derivative of psi.
    epsilon : float
        In the unit of length.
    scale : float
        One over the unit of length, a power of two near the radius of the root: powers of distances
        stay in the range of doubles in any unit of the user.
    weight_scale, value_scale : (weight_size,) and (value_size,) float64
        Factors of weights and values due to the unit.
    exponents : (outer, 3) int64
        The multi-indices.
    rows : (inner,) uintp
        0, 1, 2, ...
    up : (3, inner) uintp
        Number of k + e_i.
    down, down2 : (3, outer) uintp
        Numbers of k - e_i and k - 2 e_i; 0, with factor 0, where they do not exist.
    factor, factor2 : (3, outer) float64
        Their factors in T eq. (15).
    number : (order + 1, order + 1, order + 1) int64
        Number of a multi-index.
    slot : (C,) int64
        Row of a cluster in `moments`; -1 for a cluster that no target is far from, or of no more
        points than terms.
    contractions : (n, 3) int64
    moments : (clusters with a slot, weight_size + n, summed) float64
    """

    summed: int
    inner: int
    outer: int
    epsilon: float
    scale: float
    weight_scale: np.ndarray
    value_scale: np.ndarray
    exponents: np.ndarray
    rows: np.ndarray
    up: np.ndarray
    down: np.ndarray
    down2: np.ndarray
    factor: np.ndarray
    factor2: np.ndarray
    number: np.ndarray
    slot: np.ndarray
    contractions: np.ndarray
    moments: np.ndarray

    @property
    def data(self) -> np.ndarray:
        """What is filled: the moments, T eqs. (8) and (11), divided by factorials."""
        return self.moments

    def holds(self, cluster):
        return self.slot[cluster] >= 0

    def approximate(self, kernel, tree, cluster, targets, first, last, out):
        moments = self.moments[self.slot[cluster]]
        center = tree.center[:, cluster]
        for low in range(first, last, COLUMNS):
            _evaluate(self, kernel, center, moments, targets, low, min(low + COLUMNS, last), out)

    def terms(self):
        return self.summed

    def gather_particles(self, tree, cluster, sources, weights, start, stop):
        _gather_particles(self, tree, cluster, sources, weights, start, stop)

    def gather_child(self, tree, cluster, child):
        _gather_child(self, tree, cluster, child)

    def finish(self, cluster):
        _contract(self, cluster)


@cache
def _tables(degree: int, derivatives: int) -> dict[str, Any]:
    """Return tables of multi-indices for an expansion; they take a millisecond at order 7."""
    outer_order = degree + derivatives
    summed, inner, outer = (comb(n + 3, 3) for n in (degree, outer_order - 1, outer_order))
    indices = product(range(outer_order + 1), repeat=3)
    exponents = np.array(sorted((k for k in indices if sum(k) <= outer_order), key=sum)).reshape(
        -1, 3
    )
    numbers = {tuple(k): n for n, k in enumerate(exponents.tolist())}
    unit = np.eye(3, dtype=np.int64)
    total = np.maximum(exponents.sum(axis=1), 1)
    number = np.full((degree + 1,) * 3, -1)
    number[tuple(exponents[:summed].T)] = np.arange(summed)

    def shifted(rows: np.ndarray, steps: int) -> np.ndarray:
        return np.array(
            [[numbers.get(tuple(k), 0) for k in (rows + steps * e).tolist()] for e in unit],
            np.uintp,  # a signed index is tested for its sign at every access
        )

    return {
        "summed": summed,
        "inner": inner,
        "outer": outer,
        "exponents": exponents,
        "rows": np.arange(inner, dtype=np.uintp),
        "up": shifted(exponents[:inner], 1),
        "down": shifted(exponents, -1),
        "down2": shifted(exponents, -2),
        "factor": np.ascontiguousarray((exponents * ((2 * total - 1) / total)[:, None]).T),
        "factor2": np.ascontiguousarray(
            (exponents * (exponents - 1) * ((total - 1) / total)[:, None]).T
        ),
        "number": number,
    }


class TaylorTreecode(Treecode):
    """The treecode with Taylor expansions, for kernels that provide their terms."""

    name = NAME
    parameters = Treecode.parameters | {"degree": _ORDER}
    members = (*MEMBERS, "derivatives", "contractions", "weight_lengths", "value_lengths", "taylor")
    any_kernel = False
    degrees = range(19)

    def terms(self, degree: Any) -> Any:
        """Return the multi-indices up to an order."""
        return (degree + 1) * (degree + 2) * (degree + 3) // 6

    def build(self, points: np.ndarray, leaf_size: int) -> tuple[Tree, np.ndarray]:
        """Sort `points` into boxes that are shrunk to their points (T section 6.1.1)."""
        return build_tree(points, leaf_size, shrink=True)

    def prepare(
        self, kernel: TaylorKernel, tree: Tree, degree: int, wanted: np.ndarray, dtype: type
    ) -> Expansion:
        """Choose the unit; make room for moments of `wanted` clusters of more points than terms.

        They are doubles for any `dtype`: high derivatives leave the range of singles.
        """
        tables = _tables(degree, kernel.derivatives)
        expanded = wanted & (tree.stop - tree.start > tables["summed"])
        radius = tree.radius.max(initial=0.0)
        scale = 2.0 ** -np.frexp(radius)[1] if radius > 0.0 else 1.0
        contractions = np.array(kernel.contractions, np.int64).reshape(-1, 3)
        rows = kernel.weight_size + len(contractions)
        return Expansion(
            **tables,
            epsilon=float(getattr(kernel, "epsilon", 0.0)) * scale,
            scale=scale,
            weight_scale=scale ** np.array(kernel.weight_lengths, np.float64),
            value_scale=scale ** np.array(kernel.value_lengths, np.float64),
            slot=np.where(expanded, np.cumsum(expanded) - 1, -1),
            contractions=contractions,
            moments=np.empty((np.count_nonzero(expanded), rows, tables["summed"])),
        )


METHOD = TaylorTreecode()


@standalone
def _evaluate(expansion, kernel, center, moments, targets, first, last, out):
    """Add the expansion about `center` at up to `COLUMNS` targets."""
    wide_vectors()
    eps2 = expansion.epsilon * expansion.epsilon
    x = stack_array(moments, 3, COLUMNS)
    psi = stack_array(moments, expansion.outer, COLUMNS)
    chi = stack_array(moments, expansion.inner, COLUMNS)
    sums = stack_array(moments, out.shape[0], COLUMNS)
    inverse2 = stack_array(moments, 1, COLUMNS)
    row = stack_array(moments, 1, COLUMNS)
    for t in range(COLUMNS):
        i = min(first + t, last - 1)
        for d in range(3):
            x[d, t] = (targets[d, i] - center[d]) * expansion.scale
    for t in range(COLUMNS):
        inverse = inverse_sqrt(x[0, t] * x[0, t] + x[1, t] * x[1, t] + x[2, t] * x[2, t] + eps2)
        psi[0, t] = inverse
        inverse2[0, t] = inverse * inverse
    for c in range(out.shape[0]):
        for t in range(COLUMNS):
            sums[c, t] = 0.0
    # T eq. (15), for derivatives not divided by factorials.
    for k in range(1, expansion.outer):
        a1, a2, a3 = expansion.factor[0, k], expansion.factor[1, k], expansion.factor[2, k]
        b1, b2, b3 = expansion.factor2[0, k], expansion.factor2[1, k], expansion.factor2[2, k]
        i1, i2, i3 = expansion.down[0, k], expansion.down[1, k], expansion.down[2, k]
        j1, j2, j3 = expansion.down2[0, k], expansion.down2[1, k], expansion.down2[2, k]
        for t in range(COLUMNS):
            first_order = (
                a1 * x[0, t] * psi[i1, t] + a2 * x[1, t] * psi[i2, t] + a3 * x[2, t] * psi[i3, t]
            )
            second_order = b1 * psi[j1, t] + b2 * psi[j2, t] + b3 * psi[j3, t]
            row[0, t] = (first_order - second_order) * inverse2[0, t]
        for t in range(COLUMNS):
            psi[k, t] = row[0, t]
    if eps2 > 0.0:
        for n in range(expansion.inner):
            # Through a table, lest LLVM turn the two loops round and gather over k: 3 times slower.
            k = expansion.rows[n]
            degree = (
                expansion.exponents[k, 0] + expansion.exponents[k, 1] + expansion.exponents[k, 2]
            )
            i1, i2, i3 = expansion.up[0, k], expansion.up[1, k], expansion.up[2, k]
            for t in range(COLUMNS):
                slope = x[0, t] * psi[i1, t] + x[1, t] * psi[i2, t] + x[2, t] * psi[i3, t]
                chi[k, t] = 0.5 * ((3 + degree) * psi[k, t] - slope)
    for k in range(expansion.summed):
        taylor(kernel, k, expansion.up, psi, chi, x, moments, sums)
    for c in range(out.shape[0]):
        for i in range(first, last):
            out[c, i] += sums[c, i - first] * expansion.value_scale[c]


@standalone
def _gather_particles(expansion, tree, cluster, sources, weights, start, stop):
    """Add the particles ``start:stop`` to the moments of `cluster`."""
    wide_vectors()
    moments = expansion.moments[expansion.slot[cluster]]
    x = stack_array(moments, 3, COLUMNS)
    power = stack_array(moments, expansion.summed, COLUMNS)
    row = stack_array(moments, 1, COLUMNS)
    for low in range(start, stop, COLUMNS):
        size = min(COLUMNS, stop - low)
        for d in range(3):
            for t in range(COLUMNS):
                offset = sources[d, low + t] - tree.center[d, cluster] if t < size else 0.0
                x[d, t] = offset * expansion.scale
        for t in range(COLUMNS):
            power[0, t] = 1.0 if t < size else 0.0
        for k in range(1, expansion.summed):
            axis = 0
            while expansion.exponents[k, axis] == 0:
                axis += 1
            inverse = 1.0 / expansion.exponents[k, axis]
            below = expansion.down[axis, k]
            for t in range(COLUMNS):
                row[0, t] = power[below, t] * x[axis, t] * inverse
            for t in range(COLUMNS):
                power[k, t] = row[0, t]
        for c in range(weights.shape[0]):
            for t in range(size):
                row[0, t] = weights[c, low + t] * expansion.weight_scale[c]
            for t in range(size, COLUMNS):
                row[0, t] = 0.0
            for k in range(expansion.summed):
                total = 0.0
                for t in range(COLUMNS):
                    total += row[0, t] * power[k, t]
                moments[c, k] += total


@standalone
def _gather_child(expansion, tree, cluster, child):
    """Add a child's moments to its parent's: sum_{j <= k} shift^(k - j) / (k - j)! m_child^j."""
    moments = expansion.moments[expansion.slot[cluster]]
    below = expansion.moments[expansion.slot[child]]
    weight_size = moments.shape[0] - len(expansion.contractions)
    shift = np.ones(expansion.summed)
    for k in range(1, expansion.summed):
        axis = 0
        while expansion.exponents[k, axis] == 0:
            axis += 1
        step = (tree.center[axis, child] - tree.center[axis, cluster]) * expansion.scale
        shift[k] = shift[expansion.down[axis, k]] * step / expansion.exponents[k, axis]
    for k in range(expansion.summed):
        k1, k2, k3 = expansion.exponents[k, 0], expansion.exponents[k, 1], expansion.exponents[k, 2]
        for j1 in range(k1 + 1):
            for j2 in range(k2 + 1):
                for j3 in range(k3 + 1):
                    j = expansion.number[j1, j2, j3]
                    power = shift[expansion.number[k1 - j1, k2 - j2, k3 - j3]]
                    for c in range(weight_size):
                        moments[c, k] += power * below[c, j]


@inlined
def _contract(expansion, cluster):
    """Fill the contracted moments, of ``w_a d_1 + w_b d_2 + w_c d_3`` with d from the centre."""
    moments = expansion.moments[expansion.slot[cluster]]
    weight_size = moments.shape[0] - len(expansion.contractions)
    for n in range(len(expansion.contractions)):
        for k in range(expansion.summed):
            total = 0.0
            for d in range(3):
                above = expansion.up[d, k]
                if above < expansion.summed:
                    total += (
                        expansion.exponents[above, d] * moments[expansion.contractions[n, d], above]
                    )
            moments[weight_size + n, k] = total
