"""The polynomials of `treecode/_elements.py`, fitted with mpmath: python -m benchmarks.fit_elements

Near-minimax (Chebyshev) fits. Beside each is printed its largest error, relative to the function
that is made with it; half a unit of the last place is 1.1e-16 in doubles, 6e-8 in singles.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mpmath as mp

SMALL = mp.mpf(10) ** -12  # below it formulas cancel, and the first terms of a series serve
MIDDLE = mp.mpf(5) / 2  # the complement of erf is fitted in (a - MIDDLE) / (a + MIDDLE)
END = {64: 6, 32: 4}  # where erf has become 1


def exp_part(r: Any) -> Any:
    """Return (exp(r) - 1 - r) / r^2."""
    return (mp.expm1(r) - r) / r**2 if abs(r) > SMALL else mp.mpf(1) / 2 + r / 6


def log_part(z: Any) -> Any:
    """Return (log((1 + s) / (1 - s)) - 2 s) / s^3 of z = s^2."""
    s = mp.sqrt(z)
    return (2 * mp.atanh(s) - 2 * s) / (s * z) if z > SMALL else mp.mpf(2) / 3 + 2 * z / 5


def erf_part(z: Any) -> Any:
    """Return erf(a) / a - 1 of z = a^2."""
    return (mp.erf(mp.sqrt(z)) / mp.sqrt(z) if z > 0 else 2 / mp.sqrt(mp.pi)) - 1


def erfc_part(u: Any) -> Any:
    """Return exp(a^2) erfc(a)."""
    a = MIDDLE * (1 + u) / (1 - u)
    return mp.exp(a * a) * mp.erfc(a)


def fits(bits: int) -> dict[str, tuple[Callable, Any, Any, int, Any]]:
    """Return function, range, number of coefficients, and the factor of errors."""
    double = bits == 64
    half = mp.log(2) / 2 * mp.mpf("1.001")  # exponents are rounded before, not exactly
    most = ((mp.sqrt(2) - 1) / (mp.sqrt(2) + 1)) ** 2 * mp.mpf("1.001")
    first, last = ((a - MIDDLE) / (a + MIDDLE) for a in (1, END[bits]))
    return {
        "exp": (exp_part, -half, half, 10 if double else 5, half**2),
        "log": (log_part, 0, most, 7 if double else 3, most / 2),
        "erf": (erf_part, 0, 1, 12 if double else 7, 1),
        "erfc": (erfc_part, first, last, 16 if double else 7, mp.exp(-1)),
    }


def coefficients(bits: int, name: str) -> tuple[list[float], float]:
    """Return the coefficients of a fit, from degree 0 on, and its error."""
    function, first, last, count, share = fits(bits)[name]
    with mp.workdps(60):
        found, error = mp.chebyfit(function, [first, last], count, error=True, asc=True)
        return [float(c) for c in found], float(error * share)


if __name__ == "__main__":
    for bits in (64, 32):
        for name in fits(bits):
            found, error = coefficients(bits, name)
            print(f'"{name}": (  # {bits} bits, {error:.1e}')
            print(*(f"    {c!r}," for c in found), sep="\n")
            print("),")
