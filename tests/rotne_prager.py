"""A kernel that is not part of the package: the Rotne-Prager-Yamakawa tensor."""

import math
from typing import NamedTuple

import treecode as tc


class RotnePrager(NamedTuple):
    """Velocity of spheres of one radius under forces; forces (N, 3) to velocities (N, 3)."""

    radius: float
    viscosity: float

    strength_size = 3
    weight_size = 3
    value_size = 3
    value_lengths = (1, 1, 1)

    def weights(self, q):
        s = 1.0 / (8.0 * math.pi * self.viscosity)
        return q[0] * s, q[1] * s, q[2] * s

    def pair(self, dx, dy, dz, w, acc):
        a = self.radius
        r2 = dx * dx + dy * dy + dz * dz
        psi = tc.inverse_sqrt(tc.where(r2 > 0.0, r2, 1.0))  # 1/r
        r = r2 * psi
        # The tensor is g I + h r r / r^2; inside r < 2 a the spheres overlap.
        s = a * a * psi * psi
        apart = r > 2.0 * a
        g = tc.where(apart, psi * (1.0 + s * (2.0 / 3.0)), (4.0 - 1.125 * r / a) / (3.0 * a))
        h = tc.where(apart, psi * (1.0 - 2.0 * s), 0.125 * r / (a * a))
        d = h * psi * psi * (w[0] * dx + w[1] * dy + w[2] * dz)
        return acc[0] + g * w[0] + d * dx, acc[1] + g * w[1] + d * dy, acc[2] + g * w[2] + d * dz
