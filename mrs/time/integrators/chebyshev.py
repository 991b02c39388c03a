"""The stabilised Runge-Kutta-Chebyshev method of second order.

Sommeijer, Shampine & Verwer, J. Comput. Appl. Math. 88 (1998) 315-326, "SSV". Stable for
eigenvalues on the real axis down to -0.65 s^2 / h with s stages: elastic relaxation in viscous
fluid has such eigenvalues.
"""

from __future__ import annotations

from functools import cache
from math import sqrt
from typing import NamedTuple

import numpy as np
from numpy.polynomial import chebyshev

from mrs.time.integrators.base import Problem, Step
from mrs.time.integrators.spectral import MARGIN
from mrs.time.state import Arrays

_DAMPING = 2.0 / 13.0
_MAX_STAGES = 250


class _Coefficients(NamedTuple):
    """SSV eqs. 2.2-2.4, index 0 and 1 of mu, nu and gamma unused."""

    first: float
    mu: np.ndarray
    nu: np.ndarray
    mu_tilde: np.ndarray
    gamma: np.ndarray
    nodes: np.ndarray


@cache
def _coefficients(s: int) -> _Coefficients:
    w0 = 1.0 + _DAMPING / s**2
    basis = np.eye(s + 1)
    series = (basis, chebyshev.chebder(basis), chebyshev.chebder(basis, 2))
    t, t1, t2 = (np.asarray(chebyshev.chebval(w0, c)) for c in series)
    w1 = t1[s] / t2[s]
    b = np.empty(s + 1)
    b[2:] = t2[2:] / t1[2:] ** 2
    b[:2] = b[2]
    mu, nu, mu_tilde, gamma, nodes = (np.zeros(s + 1) for _ in range(5))
    j = np.arange(2, s + 1)
    mu[j] = 2.0 * b[j] * w0 / b[j - 1]
    nu[j] = -b[j] / b[j - 2]
    mu_tilde[j] = 2.0 * b[j] * w1 / b[j - 1]
    gamma[j] = -(1.0 - b[j - 1] * t[j - 1]) * mu_tilde[j]
    nodes[j] = w1 * t2[j] / t1[j]
    nodes[1] = b[1] * w1
    return _Coefficients(float(b[1] * w1), mu, nu, mu_tilde, gamma, nodes)


class Chebyshev:
    """RKC2 with as many stages as the spectral radius asks for."""

    name = "rkc2"
    order = 2
    error_order = 2

    def stages(self, h_lambda: float) -> int:
        """Return the smallest number of stages that is stable, from 2 to 250 (SSV eq. 2.5).

        `h_lambda` is the step times the spectral radius.
        """
        return max(2, 1 + int(min(_MAX_STAGES - 1, sqrt(1.0 + 1.54 * h_lambda))))

    def stability_interval(self) -> float:
        """Return the one of the largest number of stages allowed."""
        return 0.653 * (_MAX_STAGES**2 - 1)

    def init(self, z: np.ndarray) -> Arrays:
        """Return nothing to remember."""
        return {}

    def step(self, problem: Problem, t: float, z: np.ndarray, h: float, memory: Arrays) -> Step:
        """Return the step, with SSV's estimate of its error (section 3.1)."""
        f, k0 = problem.f, problem.rates
        stages = self.stages(MARGIN * h * problem.spectral_radius)
        k = _coefficients(stages)
        before, new = z, z + k.first * h * k0
        for j in range(2, stages + 1):
            rate = f(t + k.nodes[j - 1] * h, new)
            before, new = (
                new,
                (
                    (1.0 - k.mu[j] - k.nu[j]) * z
                    + k.mu[j] * new
                    + k.nu[j] * before
                    + h * (k.mu_tilde[j] * rate + k.gamma[j] * k0)
                ),
            )
        return Step(new, 0.8 * (z - new) + 0.4 * h * (k0 + f(t + h, new)))
