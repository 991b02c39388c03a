"""The pair loop: the only place where a target meets a source, a proxy or itself."""

from __future__ import annotations

from numpy import uintp

from treecode._jit import standalone, wide_vectors
from treecode.kernels.base import pair, weight_column, zero

# Sources summed for every target before the next ones: they stay in the first-level cache.
BLOCK = 1024


@standalone
def accumulate(kernel, targets, first, last, sources, weights, begin, end, out):
    """Add to the targets ``first:last`` of `out` what the sources ``begin:end`` do to them.

    Parameters
    ----------
    kernel : Kernel
    targets, sources : (3, M) and (3, N) float64
        Structure of arrays: with (N, 3) the loop is 2.4 times slower.
    first, last, begin, end : int
        Ranges of targets and sources.
    weights : (weight_size, N) float64
    out : (value_size, M) float64
    """
    wide_vectors()
    for low in range(begin, end, BLOCK):
        high = min(low + BLOCK, end)
        for i in range(first, last, 2):
            # Two targets share each load of a source; an odd last one is computed twice.
            k = min(i + 1, last - 1)
            xi, yi, zi = targets[0, i], targets[1, i], targets[2, i]
            xk, yk, zk = targets[0, k], targets[1, k], targets[2, k]
            acc_i = zero(kernel)
            acc_k = zero(kernel)
            for j in range(uintp(low), uintp(high)):  # signed bounds are 1.8 times slower
                x, y, z = sources[0, j], sources[1, j], sources[2, j]
                w = weight_column(kernel, weights, j)
                acc_i = pair(kernel, xi - x, yi - y, zi - z, w, acc_i)
                acc_k = pair(kernel, xk - x, yk - y, zk - z, w, acc_k)
            for c in range(len(acc_i)):
                out[c, i] += acc_i[c]
            if k > i:
                for c in range(len(acc_k)):
                    out[c, k] += acc_k[c]
