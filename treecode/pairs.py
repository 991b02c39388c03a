"""The pair loop: the only place where a target meets a source, a proxy or itself."""

from __future__ import annotations

from numpy import uintp

from treecode._jit import stack_array, standalone, wide_vectors
from treecode._lanes import LANES, load, store
from treecode.kernels.base import pair, weight_column, zero

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
            acc = zero(kernel)
            for j in range(uintp(low), uintp(high)):  # a signed index is tested for its sign
                w = weight_column(kernel, weights, j)
                acc = pair(kernel, x - sources[0, j], y - sources[1, j], z - sources[2, j], w, acc)
            for c in range(len(acc)):
                store(sums, c, acc[c])
                for t in range(min(LANES, last - i)):
                    out[c, i + t] += sums[c, t]
