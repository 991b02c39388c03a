"""Ewald's split of the regularized Stokeslet into a short part and a smooth one.

In free space the kernel is ``(I lap - grad grad) R`` over 8 pi mu, with R^2 = r^2 + epsilon^2. The
short part has ``R erfc(xi R) - exp(-xi^2 R^2) / (sqrt(pi) xi)`` in the place of R: Hasimoto's split
of the Stokeslet (Hasimoto, J. Fluid Mech. 5, 1959; Lindbo & Tornberg, J. Comput. Phys. 229, 2010)
with R for r. What is left is smooth, and is summed over waves. Torques and angular velocities are
half the curl of this, so that all parts of both kernels are made of the functions ::

    A_0 = erfc(xi R) / R,    A_(n+1) = -2 dA_n / d(r^2)

    f to u:  I (2 A_0 - r^2 A_1) + r r A_1          n to u:  q (n x r)
    f to w:  q (f x r),  q = (5 A_1 - r^2 A_2) / 2
    n to w:  I (q - r^2 d) + r r d,  d = (7 A_2 - r^2 A_3) / 4

In free space A_n is ``1 3 ... (2n - 1) / R^(2n+1)``. The factor 1/(8 pi mu) is in the weights.
"""

from __future__ import annotations

import math

import numpy as np
import scipy

_SERIES = 2.0  # (epsilon xi)^2 up to which the series of the multiplier is used;
_NODES, _RULE = 0.5 * np.array(np.polynomial.legendre.leggauss(60))  # beyond a Gauss rule
_NODES += 0.5  # from 0 to 1


def short_functions(r2: np.ndarray, epsilon: float, xi: float) -> list[np.ndarray]:
    """Return the functions A_0 to A_3 of the short part, at squares of distances."""
    R2 = r2 + epsilon**2
    R = np.sqrt(R2)
    gaussian = 2.0 * xi / math.sqrt(math.pi) * np.exp(-(xi**2) * R2)
    functions = [scipy.special.erfc(xi * R) / R]
    for n in range(3):
        functions.append(((2 * n + 1) * functions[n] + (2.0 * xi**2) ** n * gaussian) / R2)
    return functions


def multiplier(k: np.ndarray, epsilon: float, xi: float) -> np.ndarray:
    """Return the smooth part of the kernel beside that of a point force, at wave numbers k > 0.

    It is ``int_s0^inf s exp(-s - (epsilon k)^2 / (4 s)) ds`` with s0 = (k / 2 xi)^2.
    """
    s0 = (k / (2.0 * xi)) ** 2
    a = (epsilon * xi) ** 2
    if a > _SERIES:  # the blob's own transform less that of the short part, which is small
        short = np.exp(-np.multiply.outer(s0, _NODES) - a / _NODES) @ (_RULE * _NODES)
        return blob(epsilon * k) - s0**2 * short
    decay = np.exp(-s0)
    total, factor, n = (1.0 + s0) * decay, 1.0, 0
    while abs(factor) > 1e-18:
        n += 1
        factor *= -a / n
        integral = (
            (decay / s0, scipy.special.exp1(s0))[n - 1] if n < 3 else scipy.special.expn(n - 1, s0)
        )
        total = total + factor * s0**2 * integral
    return total


def blob(x: np.ndarray) -> np.ndarray:
    """Return the transform of the blob at x = epsilon k > 0."""
    return np.asarray(0.5 * x**2 * scipy.special.kv(2, x))
