"""Kernel-independent treecode: barycentric Lagrange interpolation at Chebyshev points (K)."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from treecode._jit import inlined, standalone, wide_vectors
from treecode._lanes import LANES
from treecode.kernels.base import SMALLEST, Kernel
from treecode.methods.treecode import Treecode
from treecode.pairs import accumulate
from treecode.tree import Tree, build_tree

NAME = "kitc"

_BLOCK = 256  # particles whose Lagrange polynomials are held at a time


class Interpolation(NamedTuple):
    """Modified weights at the Chebyshev points of the clusters (K eq. 4.4).

    Attributes
    ----------
    nodes : (n + 1,) float64
        Chebyshev points of the second kind on [-1, 1] (K eq. 3.2).
    slot : (C,) int64
        Row of a cluster in `weights`; -1 for a cluster that no target is far from, and for one with
        no more points than proxies, which is summed directly: that is cheaper, and exact.
    weights : (clusters with a slot, weight_size, (n + 1)^3) float32 or float64
        In the precision of the sums.
    """

    nodes: np.ndarray
    slot: np.ndarray
    weights: np.ndarray

    @property
    def data(self) -> np.ndarray:
        """What is filled: the modified weights."""
        return self.weights

    def holds(self, cluster):
        return self.slot[cluster] >= 0

    def approximate(self, kernel, tree, cluster, targets, first, last, out):
        # Relative to the centre: far from the origin a proxy would be rounded to the spacing of
        # the coordinates there, which may be coarse for the size of the box.
        weights = self.weights[self.slot[cluster]]
        relative = np.zeros((3, last - first + LANES - 1), weights.dtype)
        for d in range(3):
            for i in range(last - first):
                relative[d, i] = targets[d, first + i] - tree.center[d, cluster]
        proxies = _proxies(self.nodes, tree.half[:, cluster], weights)
        out = out[:, first:last]
        accumulate(kernel, relative, 0, last - first, proxies, weights, 0, proxies.shape[1], out)

    def terms(self):
        return len(self.nodes) ** 3

    def gather_particles(self, tree, cluster, sources, weights, start, stop):
        _gather_particles(self, tree, cluster, sources, weights, start, stop)

    def gather_child(self, tree, cluster, child):
        _gather_child(self, tree, cluster, child)

    def finish(self, cluster):
        pass


class KernelIndependentTreecode(Treecode):
    """The treecode with proxies at Chebyshev points, for any kernel."""

    name = NAME
    degrees = range(1, 15)

    def terms(self, degree: Any) -> Any:
        """Return the proxies of a cluster."""
        return (degree + 1) ** 3

    def build(self, points: np.ndarray, leaf_size: int) -> tuple[Tree, np.ndarray]:
        """Sort `points` into boxes that are bisected, not shrunk (K section 6)."""
        return build_tree(points, leaf_size, shrink=False)

    def prepare(
        self, kernel: Kernel, tree: Tree, degree: int, wanted: np.ndarray, dtype: type
    ) -> Interpolation:
        """Allocate modified weights for the `wanted` clusters of more points than proxies."""
        proxies = self.terms(degree)
        expanded = wanted & (tree.stop - tree.start > proxies)
        slot = np.where(expanded, np.cumsum(expanded) - 1, -1)
        # The sine gives points that are symmetric to the last bit.
        nodes = np.sin(np.pi * (degree - 2 * np.arange(degree + 1)) / (2 * degree))
        shape = (np.count_nonzero(expanded), kernel.weight_size, proxies)
        return Interpolation(nodes, slot, np.empty(shape, dtype))


METHOD = KernelIndependentTreecode()


@inlined
def _proxies(nodes, half, like):
    """Return the grid of Chebyshev points in a box around the origin, (3, (n + 1)^3)."""
    n = len(nodes)
    grid = np.empty((3, n * n * n), like.dtype)
    row = 0
    for k1 in range(n):
        for k2 in range(n):
            for k3 in range(n):
                grid[0, row] = half[0] * nodes[k1]
                grid[1, row] = half[1] * nodes[k2]
                grid[2, row] = half[2] * nodes[k3]
                row += 1
    return grid


@standalone
def _lagrange(nodes, center, half, points, polynomials):
    """Evaluate the Lagrange polynomials of a box side at `points`: K eq. (5.1), algorithm 1.

    The points are mapped to [-1, 1] first. K works in place, where a box far from the origin has
    Chebyshev points rounded to the spacing of doubles at its coordinates, not at its size.

    Parameters
    ----------
    nodes : (n + 1,) float64
    center, half : float
        Of the side.
    points : (m,) float64
    polynomials : (n + 1, m) float64
        Overwritten.
    """
    last = len(nodes) - 1
    scale = 1.0 / half if half > 0.0 else 0.0
    for j in range(len(points)):
        y = (points[j] - center) * scale
        total = 0.0
        flag = -1
        for k in range(last + 1):
            distance = y - nodes[k]
            if abs(distance) <= SMALLEST:
                flag = k
            else:
                weight = 0.5 if k == 0 or k == last else 1.0
                a = (weight if k % 2 == 0 else -weight) / distance
                polynomials[k, j] = a
                total += a
        for k in range(last + 1):
            if flag < 0:
                polynomials[k, j] /= total
            else:
                polynomials[k, j] = 1.0 if k == flag else 0.0


@standalone
def _gather_particles(expansion, tree, cluster, sources, weights, start, stop):
    """Add the particles ``start:stop`` to the modified weights of `cluster` (K eq. 4.4)."""
    wide_vectors()
    nodes = expansion.nodes
    n = len(nodes)
    modified = expansion.weights[expansion.slot[cluster]]
    polynomials = np.empty((3, n, _BLOCK))
    product = np.empty((modified.shape[0], _BLOCK))
    for low in range(start, stop, _BLOCK):
        size = min(_BLOCK, stop - low)
        for d in range(3):
            points = sources[d, low : low + size]
            _lagrange(nodes, tree.center[d, cluster], tree.half[d, cluster], points, polynomials[d])
        for k1 in range(n):
            for k2 in range(n):
                for c in range(modified.shape[0]):
                    for j in range(size):
                        pair = polynomials[0, k1, j] * polynomials[1, k2, j]
                        product[c, j] = pair * weights[c, low + j]
                for k3 in range(n):
                    for c in range(modified.shape[0]):
                        total = 0.0
                        for j in range(size):
                            total += product[c, j] * polynomials[2, k3, j]
                        modified[c, (k1 * n + k2) * n + k3] += total


@inlined
def _apply(matrix, values):
    """Contract the first of three axes with `matrix` and make it the last; thrice is all three."""
    n = matrix.shape[0]
    out = np.zeros(n * n * n)
    for i in range(n):
        for rest in range(n * n):
            for k in range(n):
                out[rest * n + k] += values[i * n * n + rest] * matrix[k, i]
    return out


@standalone
def _gather_child(expansion, tree, cluster, child):
    """Add a child's modified weights to its parent's: the interpolant of a polynomial is itself."""
    n = len(expansion.nodes)
    modified = expansion.weights[expansion.slot[cluster]]
    below = expansion.weights[expansion.slot[child]]
    matrices = np.empty((3, n, n))
    points = np.empty(n)
    for d in range(3):
        for k in range(n):
            points[k] = tree.center[d, child] + tree.half[d, child] * expansion.nodes[k]
        center, half = tree.center[d, cluster], tree.half[d, cluster]
        _lagrange(expansion.nodes, center, half, points, matrices[d])
    for c in range(modified.shape[0]):
        values = _apply(matrices[2], _apply(matrices[1], _apply(matrices[0], below[c])))
        for k in range(n * n * n):
            modified[c, k] += values[k]
