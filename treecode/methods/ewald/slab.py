"""Sums that are periodic in a plane, and free along z: those of a box that is padded along z.

Waves across the plane decay along z, those of the padded box's images too. What depends on z alone
does not: per area A of the cell, a force f in the plane drives the flow ::

    -4 pi H(z) f / A,    H = (Z + z^2 / Z) / 2 = |z| + O(epsilon^4 / z^3),    Z^2 = z^2 + epsilon^2

The padded box, of height L, has in the place of H the sum of H(z - m L) over all m, less its mean:
H(z) - z^2 / L - L / 6 - epsilon^2 / (2 L), and H - |z| at the images besides. So what it lacks is
smooth, and a sum of few products of polynomials of the places of target and source: no sum over
pairs is needed. A torque drives half the curl of the flow of a force, and spins are half the curl
of flows. The factor 1/(8 pi mu) is in the weights.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy
from numpy.polynomial import chebyshev

from treecode.ranks import OneRank

_BEYOND = 5.0  # decay lengths of the padding besides those that a tolerance asks for
_BLOBS = 4.0  # blob sizes of padding, for the series in powers of their ratio,
_TERMS = 15  # which ends at 4^-30
_UNIT = 2.0**-53
_FEWEST = 4  # polynomials, with which squares are exact


class Span(NamedTuple):
    """The lowest and the highest place of any point along z."""

    low: float
    high: float


def span_of(points: Sequence[np.ndarray], ranks: OneRank) -> Span:
    """Return the span of points, (3, n) each, of all ranks together."""
    own = [(float(z.min()), float(z.max())) for _, _, z in points if z.size]
    ends = [end for some in ranks.exchange(own) for end in some] or [(0.0, 0.0)]
    return Span(min(low for low, _ in ends), max(high for _, high in ends))


def padded(cell: np.ndarray, span: Span, epsilon: float, tol: float) -> np.ndarray:
    """Return lattice vectors, (3, 3), of the padded box of a cell in the plane, (2, 3), in rows."""
    area = float(np.linalg.norm(np.cross(*cell)))
    slowest = 2.0 * math.pi * _shortest(*cell) / area  # the least wave number of the plane
    room = max((_BEYOND - math.log(tol)) / slowest, _BLOBS * epsilon)
    return np.concatenate([cell, [[0.0, 0.0, span.high - span.low + room]]])


def _shortest(a: np.ndarray, b: np.ndarray) -> float:
    """Return the length of the shortest vector of the lattice of two vectors."""
    while True:
        a, b = sorted((a, b), key=np.linalg.norm)
        steps = np.rint(a @ b / (a @ a))
        if not steps:
            return float(np.linalg.norm(a))
        b = b - steps * a


class PlaneFlow:
    """What a padded box lacks, of waves that depend on z alone.

    Parameters
    ----------
    vectors : (3, 3) float64
        Of the padded box, the third along z.
    span : Span
    epsilon : float
    """

    def __init__(self, vectors: np.ndarray, span: Span, epsilon: float) -> None:
        self._middle = 0.5 * (span.low + span.high)
        height = float(vectors[2, 2])
        self._half = 0.5 * (span.high - span.low) or 0.25 * height
        area = float(np.linalg.norm(np.cross(*vectors[:2])))
        x = height / self._half - 1.0  # where the next image of the lowest point is, on their scale
        rate = math.log(x + math.sqrt(x**2 - 1.0))
        self._count = max(_FEWEST, math.ceil(-math.log(_UNIT) / rate))
        nodes = chebyshev.chebpts1(self._count)
        z = self._half * (nodes[:, None] - nodes)
        inverse = np.linalg.inv(chebyshev.chebvander(nodes, self._count - 1))
        self._maps = [inverse @ f @ inverse.T for f in _lacking(z, height, epsilon) / area]

    def __call__(self, weights: np.ndarray, sources: np.ndarray, targets: np.ndarray) -> np.ndarray:
        """Return the flow, (M, w), of weights, (w, N), from places along z, (N,), to others, (M,).

        The weights are forces, and torques if there are six; of the flow there are as many.
        """
        moments = self._moments(weights, sources)
        flow, slope, bend = (lacking @ moments for lacking in self._maps)
        parts = np.zeros_like(moments)
        parts[:, :2] = flow[:, :2]
        if len(weights) == 6:
            parts[:, 0] -= 0.5 * slope[:, 4]
            parts[:, 1] += 0.5 * slope[:, 3]
            parts[:, 3] = -0.5 * slope[:, 1] - 0.25 * bend[:, 3]
            parts[:, 4] = 0.5 * slope[:, 0] - 0.25 * bend[:, 4]
        return np.asarray(chebyshev.chebval((targets - self._middle) / self._half, parts).T)

    def _moments(self, weights: np.ndarray, sources: np.ndarray) -> np.ndarray:
        """Return the sums of weights times Chebyshev polynomials, (polynomials, w)."""
        x = (sources - self._middle) / self._half
        before, now = x, np.ones_like(x)
        moments = np.empty((self._count, len(weights)))
        for moment in moments:
            moment[:] = (weights * now).sum(axis=1)
            before, now = now, 2.0 * x * now - before
        return moments


def _lacking(z: np.ndarray, height: float, epsilon: float) -> np.ndarray:
    """Return what the padded box lacks times the area, and two derivatives, (3, ...)."""
    x = z / height
    images = np.zeros((3, *z.shape))
    for k in range(2, _TERMS):
        # H = |z| times the sum of these terms in powers of (epsilon / z)^2
        term = 0.5 * (scipy.special.binom(0.5, k) + scipy.special.binom(-0.5, k))
        term *= epsilon * (epsilon / height) ** (2 * k - 1)
        for d, power in enumerate(range(2 * k - 1, 2 * k + 2)):
            above, below = (scipy.special.zeta(power, 1.0 + side * x) for side in (1.0, -1.0))
            images[d] += term * (below - above if d == 1 else below + above)
            term *= power / height
    square = [z**2 + height**2 / 6.0 + epsilon**2 / 2.0, 2.0 * z, np.full_like(z, 2.0)]
    return -4.0 * math.pi * (np.array(square) / height - images)
