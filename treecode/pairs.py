"""The pair loop: the only place where a target meets a source, a proxy or itself."""

from __future__ import annotations

import numpy as np
from numba import types
from numpy import uintp

from treecode._jit import Driver, inlined, overloaded, stack_array, standalone, wide_vectors
from treecode._lanes import LANES, lane_count, lane_sum, load, store
from treecode.kernels.base import pair, weight_column, weight_lanes, zero

# Sources summed before their sum is added to the rest: long sums round little more than short
# ones, and the sources stay in the first-level cache meanwhile.
BLOCK = 1024
# Of singles: the error of a direct sum was 9.0e-7 with 1024, 4.0e-7 with 256, 2.3e-7 with 64.
BLOCK_SINGLE = 128


@standalone
def accumulate(kernel, targets, first, last, sources, weights, begin, end, out):
    """Add to the targets ``first:last`` of `out` what the sources ``begin:end`` do to them.

    `targets`, `sources` and `weights` have one precision, that of the arithmetic.

    Parameters
    ----------
    kernel : Kernel
    targets, sources : (3, M) and (3, N) float32 or float64
        Structures of arrays. Up to `LANES` - 1 columns of `targets` behind `last` are read, so that
        many must be there; what they hold does not matter.
    first, last, begin, end : int
        Ranges of targets and sources.
    weights : (weight_size, N) float32 or float64
    out : (value_size, M) float64
    """
    wide_vectors()
    sums = stack_array(targets, out.shape[0], LANES)
    block = BLOCK_SINGLE if targets.itemsize == 4 else BLOCK
    for low in range(begin, end, block):
        high = min(low + block, end)
        for i in range(first, last, LANES):
            x, y, z = load(targets, 0, i), load(targets, 1, i), load(targets, 2, i)
            acc = zero(kernel, targets)
            for j in range(uintp(low), uintp(high)):  # a signed index is tested for its sign
                w = weight_column(kernel, weights, j)
                acc = pair(kernel, x - sources[0, j], y - sources[1, j], z - sources[2, j], w, acc)
            for c in range(len(acc)):
                store(sums, c, 0, acc[c])
                for t in range(min(LANES, last - i)):
                    out[c, i + t] += sums[c, t]


def accumulate_near(like, center, kernel, targets, first, last, sources, weights, begin, end, out):
    """As `accumulate`, for doubles, in the precision of `like`.

    For singles coordinates are relative to `center`, (3,): the nearer it is, the more of a distance
    is kept. Doubles stay where they are: copied as well, treecodes took 1.03 to 1.09 times as long.
    """
    single = like.dtype == np.float32
    function = _in_singles if single else _in_doubles
    function(like, center, kernel, targets, first, last, sources, weights, begin, end, out)


@overloaded(accumulate_near)
def _(like, center, kernel, targets, first, last, sources, weights, begin, end, out):
    function = _in_singles if like.dtype is types.float32 else _in_doubles

    def call(like, center, kernel, targets, first, last, sources, weights, begin, end, out):
        function(like, center, kernel, targets, first, last, sources, weights, begin, end, out)

    return call


@inlined
def _in_doubles(like, center, kernel, targets, first, last, sources, weights, begin, end, out):
    accumulate(kernel, targets, first, last, sources, weights, begin, end, out)


@standalone
def _in_singles(like, center, kernel, targets, first, last, sources, weights, begin, end, out):
    near = stack_array(like, 3, BLOCK)
    near_weights = stack_array(like, weights.shape[0], BLOCK)
    block = np.zeros((3, last - first + LANES - 1), like.dtype)
    for d in range(3):
        for i in range(last - first):
            block[d, i] = targets[d, first + i] - center[d]
    for low in range(begin, end, BLOCK):
        count = min(BLOCK, end - low)
        for d in range(3):
            for j in range(count):
                near[d, j] = sources[d, low + j] - center[d]
        for c in range(weights.shape[0]):
            for j in range(count):
                near_weights[c, j] = weights[c, low + j]
        accumulate(kernel, block, 0, last - first, near, near_weights, 0, count, out[:, first:last])


@standalone
def accumulate_row(kernel, targets, i, sources, weights, count, out):
    """Add to ``out[:, i]`` what the first `count` of a row of sources do to target `i`.

    The lanes are sources: this serves few targets that share many sources. `targets`, `sources`
    and `weights` have one precision; rows of the last two are read, in whole lanes, up to less
    than one lane behind `count`, and the weights there must be zero.
    """
    wide_vectors()
    acc = zero(kernel, sources)
    for j in range(uintp(0), uintp(count), uintp(lane_count(sources))):
        dx = targets[0, i] - load(sources, 0, j)
        dy = targets[1, i] - load(sources, 1, j)
        dz = targets[2, i] - load(sources, 2, j)
        acc = pair(kernel, dx, dy, dz, weight_lanes(kernel, weights, j), acc)
    for c in range(len(acc)):
        out[c, i] += lane_sum(acc[c])


@Driver
def sum_few(kernel, targets, begin, end, sources, weights, out):
    """Add to the targets ``begin:end``, which are few, what all sources do to them.

    Parameters
    ----------
    kernel : Kernel
    targets : (3, M + LANES - 1) float64
    begin, end : int
    sources, weights : (3, N) and (weight_size, N) float64
    out : (value_size, M) float64
    """
    count = sources.shape[1]
    whole = count - count % lane_count(sources)
    for i in range(begin, end):
        accumulate_row(kernel, targets, i, sources, weights, whole, out)
    accumulate(kernel, targets, begin, end, sources, weights, whole, count, out)
