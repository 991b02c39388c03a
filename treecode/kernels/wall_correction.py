"""What a no-slip wall adds to a load and its mirror image, as translation-invariant kernels.

A wall at z = 0, a source at height h, X from its mirror image to the target, which is at height
x3; R^2 = |X|^2 + epsilon^2. Of a force f and a torque n let g and m be their mirror images, and
p = e3 x n. With ``d = h g - p`` and ``a = 2 h g - p`` the images of Ainley, Durkin, Embid,
Boindala & Cortez (2008), extended to torques, are the mirror image of strength (-g, m) and

    phi = f3/R - (d.X)/R^3                               8 pi mu u = x3 B - 2 e3 A
    s   = f3/R^3 + 3/2 (p.X)/R^5                         8 pi mu w = C + x3 G
    T   = a/R^5 + 5 X x (h m)/R^7
    A   = phi + epsilon^2 s                              C = e3 x (grad A + B/2)
    B   = 2 grad phi + 3 epsilon^2 T                     G = 3/2 epsilon^2 curl T

docs/physics.md has the derivation, and numbers.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from treecode._lanes import inverse_sqrt, where
from treecode.kernels.base import COLUMNS, SMALLEST
from treecode.kernels.blob import Blob


class ForceWallCorrection(Blob):
    """Correction of regularized forces, for velocities.

    Strengths are (N, 4): f3 and ``h g``. Values are (M, 4): A and B.
    """

    __slots__ = ()
    strength_size = 4
    weight_size = 4
    value_size = 4
    derivatives = 2
    contractions = ()
    weight_lengths = (0, 1, 1, 1)
    value_lengths = (1, 2, 2, 2)
    adds_to_flow = True

    def weights(self, q):
        scale = 1.0 / (8.0 * math.pi * self.viscosity)
        return q[0] * scale, q[1] * scale, q[2] * scale, q[3] * scale

    def pair(self, dx, dy, dz, w, acc):
        f3, g1, g2, g3 = w
        eps2 = self.epsilon * self.epsilon
        psi = inverse_sqrt(dx * dx + dy * dy + dz * dz + eps2)
        psi2 = psi * psi
        psi3 = psi * psi2
        t = eps2 * psi2
        gx = g1 * dx + g2 * dy + g3 * dz
        k = 2.0 * psi3 * (3.0 * gx * psi2 - f3)
        m = psi3 * (6.0 * t - 2.0)
        return (
            acc[0] + f3 * psi * (1.0 + t) - gx * psi3,
            acc[1] + k * dx + m * g1,
            acc[2] + k * dy + m * g2,
            acc[3] + k * dz + m * g3,
        )

    def taylor(self, k, up, psi, chi, x, m, out):
        # A = (2 chi - psi) f3 - h g . nabla psi
        # B / 2 = (h g . nabla - f3) nabla psi - h g nabla^2 psi
        f3, g1, g2, g3 = m[0, k], m[1, k], m[2, k], m[3, k]
        k1, k2, k3 = up[0, k], up[1, k], up[2, k]
        k11, k12, k13 = up[0, k1], up[0, k2], up[0, k3]
        k22, k23, k33 = up[1, k2], up[1, k3], up[2, k3]
        for t in range(COLUMNS):
            p1, p2, p3 = psi[k1, t], psi[k2, t], psi[k3, t]
            p11, p12, p13 = psi[k11, t], psi[k12, t], psi[k13, t]
            p22, p23, p33 = psi[k22, t], psi[k23, t], psi[k33, t]
            laplacian = p11 + p22 + p33
            out[0, t] += f3 * (2.0 * chi[k, t] - psi[k, t]) - g1 * p1 - g2 * p2 - g3 * p3
            out[1, t] += 2.0 * (g1 * (p11 - laplacian) + g2 * p12 + g3 * p13 - f3 * p1)
            out[2, t] += 2.0 * (g1 * p12 + g2 * (p22 - laplacian) + g3 * p23 - f3 * p2)
            out[3, t] += 2.0 * (g1 * p13 + g2 * p23 + g3 * (p33 - laplacian) - f3 * p3)


class WallCorrection(Blob):
    """Correction of regularized forces and torques, for velocities and angular velocities.

    Strengths are (N, 9): f3, two components of p, ``h g`` and ``h m``. Values are (M, 9): A and B,
    two components of C, and G.
    """

    __slots__ = ()
    strength_size = 9
    weight_size = 9
    value_size = 9
    weight_lengths = (0, 1, 1, 1, 1, 1, 2, 2, 2)
    value_lengths = (1, 2, 2, 2, 2, 2, 3, 3, 3)
    adds_to_flow = True

    def weights(self, q):
        scale = 1.0 / (8.0 * math.pi * self.viscosity)
        return (
            q[0] * scale,
            q[1] * scale,
            q[2] * scale,
            q[3] * scale,
            q[4] * scale,
            q[5] * scale,
            q[6] * scale,
            q[7] * scale,
            q[8] * scale,
        )

    def pair(self, dx, dy, dz, w, acc):
        f3, p1, p2, g1, g2, g3, m1, m2, m3 = w
        eps2 = self.epsilon * self.epsilon
        psi = inverse_sqrt(dx * dx + dy * dy + dz * dz + eps2)
        psi2 = psi * psi
        psi3 = psi * psi2
        t = eps2 * psi2
        d1, d2 = g1 - p1, g2 - p2
        a1, a2, a3 = g1 + d1, g2 + d2, 2.0 * g3
        d_x = d1 * dx + d2 * dy + g3 * dz
        p_x = p1 * dx + p2 * dy
        # grad phi = k X - psi3 d, and t psi3 T with T in units of 1/R^5
        k = psi3 * (3.0 * d_x * psi2 - f3)
        e1, e2, e3 = dy * m3 - dz * m2, dz * m1 - dx * m3, dx * m2 - dy * m1  # X x (h m)
        five = 5.0 * psi2
        tp3 = t * psi3
        half_b1 = k * dx - psi3 * d1 + 1.5 * tp3 * (a1 + five * e1)
        half_b2 = k * dy - psi3 * d2 + 1.5 * tp3 * (a2 + five * e2)
        half_b3 = k * dz - psi3 * g3 + 1.5 * tp3 * (a3 + five * e3)
        # grad A = grad phi + epsilon^2 grad s
        ka = k - tp3 * (3.0 * f3 + 7.5 * p_x * psi2)
        c2 = ka * dx - psi3 * d1 + 1.5 * tp3 * p1 + half_b1
        c1 = ka * dy - psi3 * d2 + 1.5 * tp3 * p2 + half_b2
        curl = -7.5 * tp3 * psi2
        seven = 7.0 * psi2
        return (
            acc[0] + f3 * psi * (1.0 + t) + psi3 * (1.5 * t * p_x - d_x),
            acc[1] + 2.0 * half_b1,
            acc[2] + 2.0 * half_b2,
            acc[3] + 2.0 * half_b3,
            acc[4] - c1,
            acc[5] + c2,
            acc[6] + curl * (dy * a3 - dz * a2 + 2.0 * m1 + seven * (dy * e3 - dz * e2)),
            acc[7] + curl * (dz * a1 - dx * a3 + 2.0 * m2 + seven * (dz * e1 - dx * e3)),
            acc[8] + curl * (dx * a2 - dy * a1 + 2.0 * m3 + seven * (dx * e2 - dy * e1)),
        )


class _Parameters(NamedTuple):
    pass


class StokesletWallCorrection(_Parameters):
    """Correction of singular forces, without a prefactor as `Stokeslet`: Blake (1971).

    Strengths are (N, 4): f3 and ``h g``. Values are (M, 4): A and B. A source on the wall has no
    flow, and contributes nothing where it is.
    """

    __slots__ = ()
    strength_size = 4
    weight_size = 4
    value_size = 4
    derivatives = 2
    contractions = ()
    weight_lengths = (0, 1, 1, 1)
    value_lengths = (1, 2, 2, 2)
    adds_to_flow = True

    def weights(self, q):
        return q

    def pair(self, dx, dy, dz, w, acc):
        f3, g1, g2, g3 = w
        r2 = dx * dx + dy * dy + dz * dz
        psi = where(r2 >= SMALLEST, inverse_sqrt(r2), 0.0)
        ex, ey, ez = dx * psi, dy * psi, dz * psi
        psi2 = psi * psi
        gx = (g1 * ex + g2 * ey + g3 * ez) * psi
        k = 2.0 * psi * (3.0 * gx - f3) * psi
        m = -2.0 * psi2 * psi
        return (
            acc[0] + psi * (f3 - gx),
            acc[1] + k * ex + m * g1,
            acc[2] + k * ey + m * g2,
            acc[3] + k * ez + m * g3,
        )

    def taylor(self, k, up, psi, chi, x, m, out):
        # A = psi f3 - h g . nabla psi, B / 2 = (h g . nabla - f3) nabla psi
        f3, g1, g2, g3 = m[0, k], m[1, k], m[2, k], m[3, k]
        k1, k2, k3 = up[0, k], up[1, k], up[2, k]
        k11, k12, k13 = up[0, k1], up[0, k2], up[0, k3]
        k22, k23, k33 = up[1, k2], up[1, k3], up[2, k3]
        for t in range(COLUMNS):
            p1, p2, p3 = psi[k1, t], psi[k2, t], psi[k3, t]
            p11, p12, p13 = psi[k11, t], psi[k12, t], psi[k13, t]
            p22, p23, p33 = psi[k22, t], psi[k23, t], psi[k33, t]
            out[0, t] += f3 * psi[k, t] - g1 * p1 - g2 * p2 - g3 * p3
            out[1, t] += 2.0 * (g1 * p11 + g2 * p12 + g3 * p13 - f3 * p1)
            out[2, t] += 2.0 * (g1 * p12 + g2 * p22 + g3 * p23 - f3 * p2)
            out[3, t] += 2.0 * (g1 * p13 + g2 * p23 + g3 * p33 - f3 * p3)
