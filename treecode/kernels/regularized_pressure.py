"""Pressure of regularized Stokeslets."""

from __future__ import annotations

import math
from typing import NamedTuple

from treecode import check
from treecode._lanes import inverse_sqrt


class _Parameters(NamedTuple):
    epsilon: float


class RegularizedPressure(_Parameters):
    """Pressure of regularized point forces in free space, zero far away.

    ``p = sum_j (f_j . r) Q(r)`` with ``Q = (5 eps^2 + 2 r^2) / (8 pi (r^2 + eps^2)^(5/2))``, of
    the blob ``phi(r) = 15 eps^4 / (8 pi (r^2 + eps^2)^(7/2))`` (R. Cortez, L. Fauci & A. Medovikov,
    Phys. Fluids 17, 031504, 2005). It does not depend on the viscosity. Torques have no pressure:
    their force on the fluid, ``curl(n phi) / 2``, has no divergence.

    Strengths are (N, 3) forces, values are (N, 1) pressures.

    Parameters
    ----------
    epsilon : float
        Blob size, in the unit of the coordinates.

    Raises
    ------
    ValueError, TypeError
        If it is not a number between 1e-60 and 1e60.

    Examples
    --------
    >>> import numpy as np
    >>> import treecode as tc
    >>> kernel, force = tc.RegularizedPressure(epsilon=0.01), [[0, 0, 1]]
    >>> p = tc.evaluate(kernel, [[0, 0, 0]], force, targets=[[0, 0, 2], [0, 0, -2], [2, 0, 0]])
    >>> print((4 * np.pi * p[:, 0]).round(3))  # cosine / r^2
    [ 0.25 -0.25  0.  ]
    """

    __slots__ = ()
    strength_size = 3
    weight_size = 3
    value_size = 1
    value_lengths = (2,)

    def __new__(cls, epsilon: float) -> RegularizedPressure:
        return super().__new__(cls, check.positive("epsilon", epsilon))

    def weights(self, q):
        scale = 1.0 / (8.0 * math.pi)
        return q[0] * scale, q[1] * scale, q[2] * scale

    def pair(self, dx, dy, dz, w, acc):
        # With psi = 1/R: Q = psi^3 (2 + 3 eps^2 psi^2).
        eps2 = self.epsilon * self.epsilon
        psi = inverse_sqrt(dx * dx + dy * dy + dz * dz + eps2)
        psi2 = psi * psi
        q = psi * psi2 * (2.0 + 3.0 * eps2 * psi2)
        return (acc[0] + q * (w[0] * dx + w[1] * dy + w[2] * dz),)
