"""Regularized Stokeslet: force to velocity (K 7.2)."""

from __future__ import annotations

import math

from treecode._lanes import inverse_sqrt
from treecode.kernels.base import COLUMNS
from treecode.kernels.blob import Blob


class RegularizedStokeslet(Blob):
    """Velocity of regularized point forces, K eq. (7.2), with the factor 1/(8 pi mu).

    ``u = sum_j [f_j H1(r) + (f_j . r) r H2(r)] / mu``, blob
    ``phi(r) = 15 eps^4 / (8 pi (r^2 + eps^2)^(7/2))``. The sum includes a particle's own term,
    ``f / (4 pi mu eps)``.

    Strengths are (N, 3) forces, values are (N, 3) velocities.

    Parameters
    ----------
    epsilon : float
        Blob size, in the unit of the coordinates.
    viscosity : float, optional
        Dynamic viscosity mu.

    Raises
    ------
    ValueError, TypeError
        If a parameter is not a number between 1e-60 and 1e60.

    Examples
    --------
    >>> import treecode as tc
    >>> kernel = tc.RegularizedStokeslet(epsilon=0.1, viscosity=1.0)
    >>> print(tc.evaluate(kernel, [[0, 0, 0]], [[1, 0, 0]]).round(4))  # 1 / (4 pi epsilon)
    [[0.7958 0.     0.    ]]
    """

    __slots__ = ()
    strength_size = 3
    weight_size = 3
    value_size = 3
    derivatives = 1
    contractions = ((0, 1, 2),)
    weight_lengths = (0, 0, 0)
    value_lengths = (1, 1, 1)

    def weights(self, q):
        scale = 1.0 / (8.0 * math.pi * self.viscosity)
        return q[0] * scale, q[1] * scale, q[2] * scale

    def pair(self, dx, dy, dz, w, acc):
        # With psi = 1/R: H1 = psi + eps^2 psi^3, H2 = psi^3.
        eps2 = self.epsilon * self.epsilon
        psi = inverse_sqrt(dx * dx + dy * dy + dz * dz + eps2)
        psi3 = psi * psi * psi
        h1 = psi + eps2 * psi3
        s = psi3 * (w[0] * dx + w[1] * dy + w[2] * dz)
        return acc[0] + w[0] * h1 + s * dx, acc[1] + w[1] * h1 + s * dy, acc[2] + w[2] * h1 + s * dz

    def taylor(self, k, up, psi, chi, x, m, out):
        # u = (2 chi - psi) f + (r . f) nabla psi
        m1, m2, m3, inner = m[0, k], m[1, k], m[2, k], m[3, k]
        k1, k2, k3 = up[0, k], up[1, k], up[2, k]
        for t in range(COLUMNS):
            h1 = 2.0 * chi[k, t] - psi[k, t]
            s = x[0, t] * m1 + x[1, t] * m2 + x[2, t] * m3 - inner
            out[0, t] += h1 * m1 + s * psi[k1, t]
            out[1, t] += h1 * m2 + s * psi[k2, t]
            out[2, t] += h1 * m3 + s * psi[k3, t]
