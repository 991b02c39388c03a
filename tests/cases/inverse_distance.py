"""A kernel that is not part of the package, with Taylor expansions: one over the distance."""

from typing import NamedTuple

import treecode as tc
from treecode.kernels.base import COLUMNS


class InverseDistance(NamedTuple):
    """Potential of charges, 1 / sqrt(r^2 + eps^2); charges (N, 1) to potentials (N, 1)."""

    epsilon: float

    strength_size = 1
    weight_size = 1
    value_size = 1
    value_lengths = (1,)
    weight_lengths = (0,)
    derivatives = 1
    contractions = ()

    def weights(self, q):
        return q

    def pair(self, dx, dy, dz, w, acc):
        r2 = dx * dx + dy * dy + dz * dz
        return (acc[0] + w[0] * tc.inverse_sqrt(r2 + self.epsilon**2),)

    def taylor(self, k, up, psi, chi, x, m, out):
        for t in range(COLUMNS):
            out[0, t] += psi[k, t] * m[0, k]
