"""The largest eigenvalue of a Jacobian, which is never formed as a matrix."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

_FIRST, _RENEWED = 60, 6  # iterations at most, from a random vector and from the last one
_SETTLED = 0.01
MARGIN = 1.1  # of the spectral radius, since it is estimated from below


def spectral_radius(
    f: Callable[[np.ndarray], np.ndarray],
    z: np.ndarray,
    rates: np.ndarray,
    scale: np.ndarray,
    vector: np.ndarray | None,
) -> tuple[float, np.ndarray]:
    """Return the spectral radius of df/dz by nonlinear power iteration, and its vector.

    Parameters
    ----------
    f : callable
    z, rates : ndarray
        Where, and f(z) there.
    scale : ndarray
        Size of the perturbation of each component; also the norm's unit.
    vector : ndarray or None
        The vector of an earlier call nearby, in units of `scale`.

    Notes
    -----
    SSV (see `chebyshev`) section 3.3. Each iteration is one evaluation of f.
    """
    iterations = _RENEWED
    if vector is None:
        iterations = _FIRST
        vector = np.random.default_rng(0).standard_normal(z.shape)
    radius = 0.0
    for _ in range(iterations):
        size = np.abs(vector).max()
        if size == 0.0:  # f does not depend on z
            return radius, vector
        vector = vector / size
        image = (f(z + scale * vector) - rates) / scale
        last, radius = radius, float(np.linalg.norm(image) / np.linalg.norm(vector))
        vector = image
        if abs(radius - last) <= _SETTLED * radius:
            break
    return radius, vector
