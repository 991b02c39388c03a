"""The short part of a periodic sum: its kernels, and the sum over pairs within the cut-off."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from treecode._elements import erf, exp
from treecode._jit import Driver, inlined
from treecode._lanes import inverse_sqrt, lane_count, where
from treecode.pairs import accumulate_row

_ROOM = 1024  # sources that are copied side by side: they stay in the first-level cache
_UNIT = 2.0 / math.sqrt(math.pi)


class _Parameters(NamedTuple):
    epsilon: float
    xi: float
    cut_off: float


class ShortStokeslet(_Parameters):
    """The short part of `RegularizedStokeslet`; the formulas are in `split`."""

    __slots__ = ()
    strength_size = 3
    weight_size = 3
    value_size = 3
    value_lengths = (1, 1, 1)

    def weights(self, q):
        return q[0], q[1], q[2]

    def pair(self, dx, dy, dz, w, acc):
        r2 = dx * dx + dy * dy + dz * dz
        R2 = r2 + self.epsilon * self.epsilon
        psi = inverse_sqrt(R2)
        x = self.xi * R2 * psi
        a0 = (1.0 - erf(x)) * psi
        a1 = (a0 + _UNIT * self.xi * exp(-x * x)) * psi * psi
        near = r2 < self.cut_off * self.cut_off
        h = where(near, 2.0 * a0 - r2 * a1, 0.0 * psi)
        s = where(near, a1, 0.0 * psi) * (w[0] * dx + w[1] * dy + w[2] * dz)
        return acc[0] + w[0] * h + s * dx, acc[1] + w[1] * h + s * dy, acc[2] + w[2] * h + s * dz


class ShortStokesletRotlet(_Parameters):
    """The short part of `RegularizedStokesletRotlet`; the formulas are in `split`."""

    __slots__ = ()
    strength_size = 6
    weight_size = 6
    value_size = 6
    value_lengths = (1, 1, 1, 2, 2, 2)

    def weights(self, q):
        return q[0], q[1], q[2], q[3], q[4], q[5]

    def pair(self, dx, dy, dz, w, acc):
        f1, f2, f3, n1, n2, n3 = w
        r2 = dx * dx + dy * dy + dz * dz
        R2 = r2 + self.epsilon * self.epsilon
        psi = inverse_sqrt(R2)
        psi2 = psi * psi
        x = self.xi * R2 * psi
        slope = 2.0 * self.xi * self.xi
        gaussian = _UNIT * self.xi * exp(-x * x)
        a0 = (1.0 - erf(x)) * psi
        a1 = (a0 + gaussian) * psi2
        a2 = (3.0 * a1 + slope * gaussian) * psi2
        a3 = (5.0 * a2 + slope * slope * gaussian) * psi2
        near = r2 < self.cut_off * self.cut_off
        h = where(near, 2.0 * a0 - r2 * a1, 0.0 * psi)
        q = where(near, 2.5 * a1 - 0.5 * r2 * a2, 0.0 * psi)
        d = where(near, 1.75 * a2 - 0.25 * r2 * a3, 0.0 * psi)
        s = where(near, a1, 0.0 * psi) * (f1 * dx + f2 * dy + f3 * dz)
        d1 = q - r2 * d
        d2 = d * (n1 * dx + n2 * dy + n3 * dz)
        return (
            acc[0] + f1 * h + s * dx + q * (n2 * dz - n3 * dy),
            acc[1] + f2 * h + s * dy + q * (n3 * dx - n1 * dz),
            acc[2] + f3 * h + s * dz + q * (n1 * dy - n2 * dx),
            acc[3] + n1 * d1 + d2 * dx + q * (f2 * dz - f3 * dy),
            acc[4] + n2 * d1 + d2 * dy + q * (f3 * dx - f1 * dz),
            acc[5] + n3 * d1 + d2 * dz + q * (f1 * dy - f2 * dx),
        )


@inlined
def _copy(vectors, places, weights, begin, count, shift, near, near_weights, filled):
    """Write sources behind the first `filled`, in coordinates; `shift` is added to their places."""
    for j in range(count):
        p1 = places[0, begin + j] + shift[0]
        p2 = places[1, begin + j] + shift[1]
        p3 = places[2, begin + j] + shift[2]
        for d in range(3):
            near[d, filled + j] = p1 * vectors[0, d] + p2 * vectors[1, d] + p3 * vectors[2, d]
    for c in range(weights.shape[0]):
        for j in range(count):
            near_weights[c, filled + j] = weights[c, begin + j]


@inlined
def _flush(kernel, block, near, near_weights, filled, out):
    """Add what the first `filled` sources do to all targets of a block."""
    for c in range(near_weights.shape[0]):
        for j in range(filled, filled + lane_count(near)):
            near_weights[c, j] = 0.0
    for i in range(block.shape[1]):
        accumulate_row(kernel, block, i, near, near_weights, filled, out)


@Driver
def sum_neighbours(kernel, grid, sources, weights, start, targets, order, groups, like, values):
    """Add what neighbours do to some groups of targets; return the number of pairs.

    Parameters
    ----------
    kernel : Kernel
        A short part, which vanishes beyond its cut-off.
    grid : cells.Grid
    sources, targets : (3, N) and (3, M) float64
        In parts of the lattice vectors, sorted along rows.
    weights : (weight_size, N) float64
    start : (small cells + 1,) int64
        The first source of each small cell.
    order : (M,) int64
        Row of `values` for each target.
    groups : (n, 6) int64
        See `cells.find_groups`.
    like : (0,) float32 or float64
        Of the precision of the arithmetic. Coordinates are relative to the middle of the group.
    values : (M, value_size) float64
        Added to.
    """
    vectors = grid.vectors
    n1, n2, n3 = grid.shape[0], grid.shape[1], grid.shape[2]
    near = np.zeros((3, _ROOM + lane_count(like)), like.dtype)
    near_weights = np.zeros((weights.shape[0], near.shape[1]), like.dtype)
    middle, shift = np.empty(3), np.empty(3)
    pairs = 0
    for g in range(len(groups)):
        i1, i2, low, high, first, last = groups[g]
        middle[0], middle[1] = (i1 + 0.5) / n1, (i2 + 0.5) / n2
        middle[2] = 0.5 * (low + high + 1) / n3
        block = np.empty((3, last - first), like.dtype)
        _copy(vectors, targets, weights[:0], first, last - first, -middle, block, block, 0)
        out = np.zeros((values.shape[1], last - first))
        filled = 0
        for o in range(len(grid.rows)):
            r1, r2 = i1 + grid.rows[o, 0], i2 + grid.rows[o, 1]
            shift[0], shift[1] = r1 // n1 - middle[0], r2 // n2 - middle[1]
            row = ((r1 % n1) * n2 + r2 % n2) * n3
            a, b = low + grid.reach[o, 0], high + grid.reach[o, 1]
            for image in range(a // n3, b // n3 + 1):
                shift[2] = image - middle[2]
                begin = start[row + max(a - image * n3, 0)]
                end = start[row + min(b - image * n3, n3 - 1) + 1]
                pairs += (end - begin) * (last - first)
                while begin < end:
                    count = min(end - begin, _ROOM - filled)
                    _copy(
                        vectors, sources, weights, begin, count, shift, near, near_weights, filled
                    )
                    begin += count
                    filled += count
                    if filled == _ROOM:
                        _flush(kernel, block, near, near_weights, filled, out)
                        filled = 0
        _flush(kernel, block, near, near_weights, filled, out)
        for i in range(last - first):
            for c in range(values.shape[1]):
                values[order[first + i], c] += out[c, i]
    return pairs
