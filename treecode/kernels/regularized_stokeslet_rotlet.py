"""Regularized Stokeslet and rotlet: force and torque to velocity and angular velocity (K 7.3)."""

from __future__ import annotations

import math

from treecode._lanes import inverse_sqrt
from treecode.kernels.base import COLUMNS
from treecode.kernels.blob import Blob


class RegularizedStokesletRotlet(Blob):
    """Velocity and angular velocity of regularized forces and torques, K eq. (7.3).

    With the factor 1/(8 pi mu) and the functions H1, H2, Q, D1, D2 of K eq. (7.1)::

        mu u = sum_j f H1 + (f . r) r H2 + 1/2 Q (n x r)
        mu w = sum_j 1/2 Q (f x r) + 1/4 D1 n + 1/4 D2 (n . r) r

    (K 7.3b is printed without the last factor r; with it w is half the curl of u.) The sum
    includes a particle's own terms, ``u = f / (4 pi mu eps)`` and ``w = 5 n / (16 pi mu eps^3)``.

    Strengths are (N, 6): force, torque. Values are (N, 6): velocity, angular velocity.

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
    >>> kernel, torque = tc.RegularizedStokesletRotlet(epsilon=0.5), [[0, 0, 0, 0, 0, 1]]
    >>> print(tc.evaluate(kernel, [[0, 0, 0]], torque).round(4) + 0.0)  # 5 / (16 pi epsilon^3)
    [[0.     0.     0.     0.     0.     0.7958]]
    """

    __slots__ = ()
    strength_size = 6
    weight_size = 6
    value_size = 6
    derivatives = 3
    contractions = ((0, 1, 2),)
    weight_lengths = (0, 0, 0, 1, 1, 1)
    value_lengths = (1, 1, 1, 2, 2, 2)

    def weights(self, q):
        s = 1.0 / (8.0 * math.pi * self.viscosity)
        return q[0] * s, q[1] * s, q[2] * s, q[3] * s, q[4] * s, q[5] * s

    def pair(self, dx, dy, dz, w, acc):
        # With psi = 1/R, t = (eps psi)^2 and e = r psi, the factor 1/(8 pi) left out:
        # H1 = psi (1 + t), H2 = psi^3, Q = psi^3 (2 + 3 t), D1 = psi^3 (15 t^2 - 3 t - 2),
        # D2 r r = psi^3 (6 + 15 t) e e.
        f1, f2, f3, n1, n2, n3 = w
        eps2 = self.epsilon * self.epsilon
        psi = inverse_sqrt(dx * dx + dy * dy + dz * dz + eps2)
        psi2 = psi * psi
        psi3 = psi2 * psi
        t = eps2 * psi2
        h1 = psi + psi * t
        s = psi3 * (f1 * dx + f2 * dy + f3 * dz)
        q = psi3 * (1.0 + 1.5 * t)
        d1 = psi3 * (t * (3.75 * t - 0.75) - 0.5)
        ex, ey, ez = dx * psi, dy * psi, dz * psi
        d2 = psi3 * (1.5 + 3.75 * t) * (n1 * ex + n2 * ey + n3 * ez)
        return (
            acc[0] + f1 * h1 + s * dx + q * (n2 * dz - n3 * dy),
            acc[1] + f2 * h1 + s * dy + q * (n3 * dx - n1 * dz),
            acc[2] + f3 * h1 + s * dz + q * (n1 * dy - n2 * dx),
            acc[3] + n1 * d1 + d2 * ex + q * (f2 * dz - f3 * dy),
            acc[4] + n2 * d1 + d2 * ey + q * (f3 * dx - f1 * dz),
            acc[5] + n3 * d1 + d2 * ez + q * (f1 * dy - f2 * dx),
        )

    def taylor(self, k, up, psi, chi, x, m, out):
        # u = (2 chi - psi) f + (r . f) nabla psi + n x nabla chi
        # w = f x nabla chi + [(n . nabla) nabla chi - n nabla^2 chi] / 2
        f1, f2, f3, inner = m[0, k], m[1, k], m[2, k], m[6, k]
        n1, n2, n3 = m[3, k], m[4, k], m[5, k]
        half1, half2, half3 = 0.5 * n1, 0.5 * n2, 0.5 * n3
        k1, k2, k3 = up[0, k], up[1, k], up[2, k]
        k11, k12, k13 = up[0, k1], up[0, k2], up[0, k3]
        k22, k23, k33 = up[1, k2], up[1, k3], up[2, k3]
        for t in range(COLUMNS):
            h1 = 2.0 * chi[k, t] - psi[k, t]
            s = x[0, t] * f1 + x[1, t] * f2 + x[2, t] * f3 - inner
            c1, c2, c3 = chi[k1, t], chi[k2, t], chi[k3, t]
            c11, c12, c13 = chi[k11, t], chi[k12, t], chi[k13, t]
            c22, c23, c33 = chi[k22, t], chi[k23, t], chi[k33, t]
            out[0, t] += h1 * f1 + s * psi[k1, t] + n2 * c3 - n3 * c2
            out[1, t] += h1 * f2 + s * psi[k2, t] + n3 * c1 - n1 * c3
            out[2, t] += h1 * f3 + s * psi[k3, t] + n1 * c2 - n2 * c1
            out[3, t] += f2 * c3 - f3 * c2 + half2 * c12 + half3 * c13 - half1 * (c22 + c33)
            out[4, t] += f3 * c1 - f1 * c3 + half1 * c12 + half3 * c23 - half2 * (c11 + c33)
            out[5, t] += f1 * c2 - f2 * c1 + half1 * c13 + half2 * c23 - half3 * (c11 + c22)
