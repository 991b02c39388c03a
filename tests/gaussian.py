"""A kernel that is not part of the package: Stokeslets with a Gaussian blob."""

import math
from typing import NamedTuple

import treecode as tc


class GaussianStokeslet(NamedTuple):
    """Velocity of forces spread by (5/2 - r^2/eps^2) exp(-r^2/eps^2) / (pi^(3/2) eps^3).

    Hernandez-Ortiz, de Pablo and Graham, Phys. Rev. Lett. 98, 140602 (2007).
    """

    epsilon: float
    viscosity: float

    strength_size = 3
    weight_size = 3
    value_size = 3
    value_lengths = (1, 1, 1)

    def weights(self, q):
        s = 1.0 / (8.0 * math.pi * self.viscosity)
        return q[0] * s, q[1] * s, q[2] * s

    def pair(self, dx, dy, dz, w, acc):
        # u = (erf(r/eps)/r (1 + n n) + 2 exp(-r^2/eps^2) / (sqrt(pi) eps) (1 - n n)) . w
        r2 = dx**2 + dy**2 + dz**2
        x2 = r2 / self.epsilon**2
        apart = x2 > 1e-16
        inverse = tc.inverse_sqrt(tc.where(apart, r2, 1.0))
        peak = 2.0 / (math.sqrt(math.pi) * self.epsilon)  # of erf(r/eps)/r, at r = 0
        outer = tc.where(apart, tc.erf(r2 * inverse / self.epsilon) * inverse, peak)
        inner = peak * tc.exp(-x2)
        a = outer + inner
        d = (outer - inner) * inverse**2 * (w[0] * dx + w[1] * dy + w[2] * dz)
        return acc[0] + a * w[0] + d * dx, acc[1] + a * w[1] + d * dy, acc[2] + a * w[2] + d * dz
