"""Singular Stokeslet (T 2a)."""

from __future__ import annotations

from typing import NamedTuple

from treecode._lanes import inverse_sqrt, where
from treecode.kernels.base import COLUMNS, SMALLEST


class _Parameters(NamedTuple):
    pass


class Stokeslet(_Parameters):
    """Velocity of point forces, the first sum of T eq. (3), printed there without a prefactor.

    ``u_i = sum_j (delta_ij / r + r_i r_j / r^3) f_j``; coincident points contribute nothing.
    Multiply by 1/(8 pi mu) for a velocity in a fluid of viscosity mu.

    Strengths are (N, 3) forces, values are (N, 3).

    Examples
    --------
    >>> import treecode as tc
    >>> u = tc.evaluate(tc.Stokeslet(), [[0, 0, 0]], [[1, 0, 0]], targets=[[2, 0, 0], [0, 2, 0]])
    >>> print(u)  # 2 / r along the force, 1 / r across
    [[1.  0.  0. ]
     [0.5 0.  0. ]]
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
        return q

    def pair(self, dx, dy, dz, w, acc):
        r2 = dx * dx + dy * dy + dz * dz
        psi = where(r2 >= SMALLEST, inverse_sqrt(r2), 0.0)
        ex, ey, ez = dx * psi, dy * psi, dz * psi
        s = psi * (w[0] * ex + w[1] * ey + w[2] * ez)
        return (
            acc[0] + w[0] * psi + s * ex,
            acc[1] + w[1] * psi + s * ey,
            acc[2] + w[2] * psi + s * ez,
        )

    def taylor(self, k, up, psi, chi, x, m, out):
        # u = psi f + (r . f) nabla psi
        m1, m2, m3, inner = m[0, k], m[1, k], m[2, k], m[3, k]
        k1, k2, k3 = up[0, k], up[1, k], up[2, k]
        for t in range(COLUMNS):
            h1 = psi[k, t]
            s = x[0, t] * m1 + x[1, t] * m2 + x[2, t] * m3 - inner
            out[0, t] += h1 * m1 + s * psi[k1, t]
            out[1, t] += h1 * m2 + s * psi[k2, t]
            out[2, t] += h1 * m3 + s * psi[k3, t]
