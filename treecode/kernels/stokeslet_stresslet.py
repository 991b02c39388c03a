"""Singular Stokeslet and stresslet (T 2a and 2b)."""

from __future__ import annotations

from typing import NamedTuple

from treecode._lanes import inverse_sqrt, where
from treecode.kernels.base import COLUMNS, SMALLEST


class _Parameters(NamedTuple):
    pass


class StokesletStresslet(_Parameters):
    """Velocity of point forces and stresslets, T eq. (3), printed there without a prefactor.

    ``u_i = sum (delta_ij / r + r_i r_j / r^3) f_j + sum (r_i r_j r_l / r^5) h_j nu_l``;
    coincident points contribute nothing. For forces alone `Stokeslet` is cheaper.

    Strengths are (N, 9): force f, dipole weight h, unit normal nu. Values are (N, 3).

    Examples
    --------
    >>> import treecode as tc
    >>> strengths = [[0, 0, 0, 1, 0, 0, 1, 0, 0]]  # no force, h = nu = (1, 0, 0)
    >>> print(tc.evaluate(tc.StokesletStresslet(), [[0, 0, 0]], strengths, targets=[[2, 0, 0]]))
    [[0.25 0.   0.  ]]
    """

    __slots__ = ()
    strength_size = 9
    weight_size = 9
    value_size = 3
    derivatives = 2
    contractions = ((0, 1, 2), (3, 6, 7), (6, 4, 8), (7, 8, 5))
    weight_lengths = (0, 0, 0, 1, 1, 1, 1, 1, 1)
    value_lengths = (1, 1, 1)

    def weights(self, q):
        # The stresslet is symmetric in j and l, so only the symmetric part of h nu^T acts:
        # xx, yy, zz, xy, xz, yz.
        h1, h2, h3, n1, n2, n3 = q[3], q[4], q[5], q[6], q[7], q[8]
        return (
            q[0],
            q[1],
            q[2],
            h1 * n1,
            h2 * n2,
            h3 * n3,
            0.5 * (h1 * n2 + h2 * n1),
            0.5 * (h1 * n3 + h3 * n1),
            0.5 * (h2 * n3 + h3 * n2),
        )

    def pair(self, dx, dy, dz, w, acc):
        f1, f2, f3, xx, yy, zz, xy, xz, yz = w
        r2 = dx * dx + dy * dy + dz * dz
        psi = where(r2 >= SMALLEST, inverse_sqrt(r2), 0.0)
        ex, ey, ez = dx * psi, dy * psi, dz * psi
        stress = (
            ex * (xx * ex + 2.0 * (xy * ey + xz * ez))
            + ey * (yy * ey + 2.0 * yz * ez)
            + zz * ez * ez
        )
        s = psi * (f1 * ex + f2 * ey + f3 * ez + psi * stress)
        return acc[0] + f1 * psi + s * ex, acc[1] + f2 * psi + s * ey, acc[2] + f3 * psi + s * ez

    def taylor(self, k, up, psi, chi, x, m, out):
        # u = psi f + (r . f) nabla psi + [nabla nabla psi (S r) + S nabla psi] / 3, S = h nu^T
        f1, f2, f3, inner = m[0, k], m[1, k], m[2, k], m[9, k]
        xx, yy, zz = m[3, k] / 3.0, m[4, k] / 3.0, m[5, k] / 3.0
        xy, xz, yz = m[6, k] / 3.0, m[7, k] / 3.0, m[8, k] / 3.0
        inner1, inner2, inner3 = m[10, k] / 3.0, m[11, k] / 3.0, m[12, k] / 3.0
        k1, k2, k3 = up[0, k], up[1, k], up[2, k]
        k11, k12, k13 = up[0, k1], up[0, k2], up[0, k3]
        k22, k23, k33 = up[1, k2], up[1, k3], up[2, k3]
        for t in range(COLUMNS):
            x1, x2, x3 = x[0, t], x[1, t], x[2, t]
            p1, p2, p3 = psi[k1, t], psi[k2, t], psi[k3, t]
            h1 = psi[k, t]
            s = x1 * f1 + x2 * f2 + x3 * f3 - inner
            s1 = x1 * xx + x2 * xy + x3 * xz - inner1
            s2 = x1 * xy + x2 * yy + x3 * yz - inner2
            s3 = x1 * xz + x2 * yz + x3 * zz - inner3
            out[0, t] += (
                h1 * f1
                + (s + xx) * p1
                + xy * p2
                + xz * p3
                + s1 * psi[k11, t]
                + s2 * psi[k12, t]
                + s3 * psi[k13, t]
            )
            out[1, t] += (
                h1 * f2
                + xy * p1
                + (s + yy) * p2
                + yz * p3
                + s1 * psi[k12, t]
                + s2 * psi[k22, t]
                + s3 * psi[k23, t]
            )
            out[2, t] += (
                h1 * f3
                + xz * p1
                + yz * p2
                + (s + zz) * p3
                + s1 * psi[k13, t]
                + s2 * psi[k23, t]
                + s3 * psi[k33, t]
            )
