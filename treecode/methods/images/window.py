"""The smooth part of the kernel in free space, as waves of a box in which sources are alone.

It is ``(I lap - grad grad) h(r)``, where h(r) is the smooth part of Ewald's split,
``R erf(xi R) + exp(-xi^2 R^2) / (sqrt(pi) xi)`` with R^2 = r^2 + epsilon^2. A window leaves h as it
is where targets and sources are, and ends it before the next image of the box (F. Vico et al., J.
Comput. Phys. 323, 2016, end it at once). Since h is about R, the parabola in r that touches R amid
the edge of the window is taken off before: what the window changes is small then. A parabola
``a + b r^2`` is but a uniform flow, ``4 b`` times the force.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import scipy

from treecode.methods.ewald.long_part import Waves, waves_of
from treecode.methods.ewald.tuning import Split, Task

_MARGIN = 30.0  # by how much less than a tolerance the edge of a window changes
_STEP = 2.0**-5  # of lengths, so that waves serve for a while
_NODES, _FEWEST = 4.0, 20  # of the trapezoidal rule, for each oscillation, and besides
_KNOTS, _DEGREE = 32.0, 7  # of the spline of the transform, for each oscillation


class Box(NamedTuple):
    """A box around targets and sources, so large that its images are beyond a window.

    Attributes
    ----------
    corner, lengths : (3,) float64
        Its lowest corner, and its edges, along the axes.
    middle, edge : float
        Where the window falls to a half, and how far from there it is whole or nothing.
    steepness : float
        An inverse length.
    """

    corner: np.ndarray
    lengths: np.ndarray
    middle: float
    edge: float
    steepness: float


def box_around(sources: np.ndarray, targets: np.ndarray, task: Task, split: Split) -> Box:
    """Return a box around points, (3, n) and (3, M), for the waves of a split.

    Flows are second derivatives of h, small where sources are far away and where blobs are wide.
    Those of what the window changes are not small.
    """
    some = sources if sources.size else targets
    low, high = some.min(axis=1), some.max(axis=1)
    first, last = targets.min(axis=1), targets.max(axis=1)
    extent = np.ceil(np.maximum(high - first, last - low) / _STEP) * _STEP
    sharp = math.log(_MARGIN * (1.0 + split.wave_number**2) / task.tol)
    edge, reach = 2.0 * sharp / split.wave_number, float(np.linalg.norm(extent))
    lengths = extent + reach + 2.0 * edge
    return Box(np.minimum(low, first), lengths, reach + edge, edge, math.sqrt(sharp) / edge)


def free_waves(box: Box, epsilon: float, xi: float, largest: float) -> tuple[Waves, float]:
    """Return the smooth part of a split: waves up to a wave number, and the uniform flow besides.

    The latter is that of a unit of force.
    """
    end, touching = box.middle + box.edge, math.hypot(box.middle, epsilon)
    step = 2.0 * math.pi / end  # of wave numbers, for one more oscillation
    r = end * np.linspace(0.0, 1.0, math.ceil(_NODES * largest / step) + _FEWEST)[1:]
    density = 2.0 * math.pi * r[0] * r**2 * _laplacian(r, box, epsilon, xi, touching)
    k = step / _KNOTS * np.arange(-_DEGREE, _KNOTS * largest / step + _DEGREE)
    chi = np.sinc(np.outer(k, r) / math.pi) @ density
    smooth = scipy.interpolate.make_interp_spline(k, chi, _DEGREE)
    return waves_of(np.diag(box.lengths), largest, smooth), 2.0 / touching


def _laplacian(r: np.ndarray, box: Box, epsilon: float, xi: float, touching: float) -> np.ndarray:
    """Return the Laplacian of the window times h less the parabola, at distances r > 0.

    Roundings of a transform of the product itself would grow by the square of the wave number.
    """
    R = np.hypot(r, epsilon)
    gaussian, a = np.exp(-((xi * R) ** 2)) / math.sqrt(math.pi), scipy.special.erf(xi * R) / R
    h = R**2 * a + gaussian / xi - touching - 0.5 * (r**2 - box.middle**2) / touching
    slope = r * (a - 1.0 / touching)
    bend = 3.0 * (a - 1.0 / touching) + (r / R) ** 2 * (2.0 * xi * gaussian - a)
    x = box.steepness * (r - box.middle)
    window = 0.5 * scipy.special.erfc(x)
    falling = -box.steepness / math.sqrt(math.pi) * np.exp(-(x**2))
    return np.asarray(window * bend + 2.0 * falling * (slope + h * (1.0 / r - box.steepness * x)))
