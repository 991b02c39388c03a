"""The pair loop: the only place where a target meets a source, a proxy or itself."""

from __future__ import annotations

from numpy import uintp

from treecode._jit import stack_array, standalone, wide_vectors
from treecode._lanes import LANES, lane_count, lane_sum, load, store
from treecode.kernels.base import pair, weight_column, weight_lanes, zero

# Sources summed before their sum is added to the rest: long sums round little more than short
# ones, and the sources stay in the first-level cache meanwhile.
BLOCK = 1024


@standalone
def accumulate(kernel, targets, first, last, sources, weights, begin, end, out):
    """Add to the targets ``first:last`` of `out` what the sources ``begin:end`` do to them.

    Parameters
    ----------
    kernel : Kernel
    targets, sources : (3, M) and (3, N) float64
        Structures of arrays. Up to `LANES` - 1 columns of `targets` behind `last` are read, so that
        many must be there; what they hold does not matter.
    first, last, begin, end : int
        Ranges of targets and sources.
    weights : (weight_size, N) float64
    out : (value_size, M) float64
    """
    wide_vectors()
    sums = stack_array(out.shape[0], LANES)
    for low in range(begin, end, BLOCK):
        high = min(low + BLOCK, end)
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
