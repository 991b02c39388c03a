"""A naive oracle: the sums of the papers over (M, N) arrays. Shares nothing with treecode."""

from typing import NamedTuple

import mpmath
import numpy as np
import pytest

import treecode as tc
from treecode import methods
from treecode.methods.treecode import Treecode
from treecode.methods.walk import WalkMethod

METHODS = [methods.get(name) for name in methods.names()]
BACKENDS = [method.name for method in METHODS if isinstance(method, WalkMethod)]
TREECODES = [method.name for method in METHODS if isinstance(method, Treecode)]
KERNELS = [
    tc.RegularizedStokeslet(epsilon=0.1, viscosity=0.7),
    tc.RegularizedStokesletRotlet(epsilon=0.1, viscosity=1.3),
    tc.Stokeslet(),
    tc.StokesletStresslet(),
]
# Sums of these kernels, by name: there are others of periodic ones.
FREE = [method.name for method in METHODS if method.takes(KERNELS[0])]
UNIT = 2.0**-53
COINCIDENT = 2.0**-1022  # r^2 of points that are one to a singular kernel: doubles end there
each_backend = pytest.mark.parametrize("backend", BACKENDS)
each_treecode = pytest.mark.parametrize("backend", TREECODES)
each_kernel = pytest.mark.parametrize("kernel", KERNELS, ids=lambda kernel: type(kernel).__name__)


class Numbers(NamedTuple):
    """What the formulas are evaluated in."""

    convert: object
    pi: object


# 64 bits of mantissa and 15 of exponent where the machine has them: nothing below can overflow.
EXTENDED = Numbers(
    lambda a: np.asarray(a, np.longdouble), np.longdouble("3.14159265358979323846264338327950288")
)
MULTIPRECISION = Numbers(np.vectorize(mpmath.mpf, otypes=[object]), mpmath.pi)


def random_case(kernel, n, seed, targets=None):
    """Return points in the cube [-1, 1]^3, strengths in [-1, 1] and `targets` more points."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-1.0, 1.0, (n, 3))
    strengths = rng.uniform(-1.0, 1.0, (n, kernel.strength_size))
    return points, strengths, None if targets is None else rng.uniform(-1.0, 1.0, (targets, 3))


def with_epsilon(kernel, epsilon):
    """Return the same kernel with another blob; a singular kernel has none."""
    if not hasattr(kernel, "epsilon"):
        return kernel
    return type(kernel)(epsilon=epsilon, viscosity=kernel.viscosity)


def _dot(a, b):
    return (a * b).sum(axis=-1, keepdims=True)


def _cross(a, b, minus):
    i, j = [1, 2, 0], [2, 0, 1]
    return a[..., i] * b[..., j] + minus * a[..., j] * b[..., i]


class _Regularized(NamedTuple):
    """H1, H2, Q, D1, D2 of physics.md 2 (K 7.1)."""

    H1: object
    H2: object
    Q: object
    D1: object
    D2: object

    @classmethod
    def at(cls, r, e, pi, minus):
        r2 = _dot(r, r)
        R2 = r2 + e**2
        R3 = R2**0.5 * R2  # powers by multiplication: powl takes seconds
        R5, R7 = R3 * R2, R3 * R2 * R2
        return cls(
            (2 * e**2 + r2) / (8 * pi * R3),
            1 / (8 * pi * R3),
            (5 * e**2 + 2 * r2) / (8 * pi * R5),
            (10 * e**4 + minus * (7 * e**2 * r2 + 2 * r2**2)) / (8 * pi * R7),
            (21 * e**2 + 6 * r2) / (8 * pi * R7),
        )


def _parameters(kernel, numbers):
    return numbers.convert(kernel.epsilon)[()], numbers.convert(kernel.viscosity)[()]


def _regularized_stokeslet(kernel, r, f, numbers, minus):
    """K 7.2."""
    e, mu = _parameters(kernel, numbers)
    k = _Regularized.at(r, e, numbers.pi, minus)
    return (f * k.H1 + _dot(f, r) * r * k.H2) / mu


def _regularized_stokeslet_rotlet(kernel, r, q, numbers, minus):
    """K 7.3, with the factor r that the last term of 7.3b lacks in print."""
    e, mu = _parameters(kernel, numbers)
    f, n = q[..., :3], q[..., 3:]
    k = _Regularized.at(r, e, numbers.pi, minus)
    u = f * k.H1 + _dot(f, r) * r * k.H2 + k.Q * _cross(n, r, minus) / 2
    w = k.Q * _cross(f, r, minus) / 2 + k.D1 * n / 4 + k.D2 * _dot(n, r) * r / 4
    return np.concatenate([u / mu, w / mu], axis=-1)


def _inverse_distance(r):
    r2 = _dot(r, r)
    coincident = (r2 < COINCIDENT).astype(bool)
    return np.where(coincident, 0 * r2, 1 / np.where(coincident, 1 + r2, r2) ** 0.5)


def _stokeslet(kernel, r, f, numbers, minus):
    """T 2a."""
    s = _inverse_distance(r)
    return f * s + _dot(f, r) * r * (s * s * s)


def _stokeslet_stresslet(kernel, r, q, numbers, minus):
    """T 2a and 2b."""
    f, h, nu = q[..., :3], q[..., 3:6], q[..., 6:]
    s = _inverse_distance(r)
    stresslet = _dot(h, r) * _dot(nu, r) * r * (s * s * s * s * s)
    return _stokeslet(kernel, r, f, numbers, minus) + stresslet


_FORMULAS = {
    "RegularizedStokeslet": _regularized_stokeslet,
    "RegularizedStokesletRotlet": _regularized_stokeslet_rotlet,
    "Stokeslet": _stokeslet,
    "StokesletStresslet": _stokeslet_stresslet,
}


def _contributions(kernel, sources, strengths, targets, numbers, majorant=False):
    """Return the (M, N, value_size) terms; `majorant` is them with every product positive."""
    targets = sources if targets is None else targets
    r = numbers.convert(targets)[:, None, :] - numbers.convert(sources)[None, :, :]
    q = numbers.convert(strengths)
    if majorant:
        r, q = abs(r), abs(q)
    return _FORMULAS[type(kernel).__name__](kernel, r, q, numbers, 1 if majorant else -1)


def exact(kernel, sources, strengths, targets=None):
    """Return the sum in extended precision."""
    return _contributions(kernel, sources, strengths, targets, EXTENDED).sum(axis=1)


def exact_mpmath(kernel, sources, strengths, targets=None):
    """Return the sum with 50 digits, rounded to extended precision. For a few points."""
    with mpmath.workdps(50):
        values = _contributions(kernel, sources, strengths, targets, MULTIPRECISION).sum(axis=1)
        return np.vectorize(lambda v: np.longdouble(mpmath.nstr(v, 25)), [np.longdouble])(values)


def rounding(kernel, sources, strengths, targets=None):
    """Return how far rounding may take a direct sum in double precision, (M, value_size).

    A term is some 30 operations on the correctly rounded r, of which up to seven powers of 1/R
    and the differences in D1 and r^2 accumulate; N terms are added. The floor is for numbers below
    the smallest double: sums, and products of r with strengths and powers of 1/R in any order, of
    which one may be lost and the others make the loss larger.
    """
    n = len(strengths)
    targets = sources if targets is None else targets
    majorant = _contributions(kernel, sources, strengths, targets, EXTENDED, majorant=True)
    distance2 = _distance2(kernel, sources, targets)
    inverse = distance2 ** np.longdouble(-0.5)
    power = max(channel.nu for channel in _CHANNELS[type(kernel).__name__]) - 1
    reach = 1 + np.where(np.isinf(distance2), 0, distance2)
    largest = 1 + np.abs(EXTENDED.convert(strengths)).sum(axis=1)
    losses = (1 + inverse**power) * reach * largest
    floor = np.longdouble(2.0**-1074) * losses.sum(axis=1)[:, None]
    return (32 + n) * (UNIT * majorant.sum(axis=1) + floor)


def _distance2(kernel, sources, targets):
    """Return R^2 = r^2 + eps^2, infinite for coincident points of a singular kernel."""
    r = EXTENDED.convert(targets)[:, None, :] - EXTENDED.convert(sources)[None, :, :]
    R2 = (r**2).sum(axis=-1) + np.longdouble(getattr(kernel, "epsilon", 0.0)) ** 2
    return np.where(R2 < COINCIDENT, np.inf, R2)


class _Channel(NamedTuple):
    """Bound c |q| R^(power - nu) of a block: a polynomial of degree `power` in r over R^nu."""

    rows: slice
    columns: tuple
    c: float
    nu: int
    power: int


_U, _W = slice(0, 3), slice(3, 6)
_CHANNELS = {
    "Stokeslet": [_Channel(_U, (_U,), 2, 3, 2)],
    "StokesletStresslet": [
        _Channel(_U, (_U,), 2, 3, 2),
        _Channel(_U, (slice(3, 6), slice(6, 9)), 1, 5, 3),
    ],
    "RegularizedStokeslet": [_Channel(_U, (_U,), 3, 3, 2)],
    "RegularizedStokesletRotlet": [
        _Channel(_U, (_U,), 3, 3, 2),
        _Channel(_U, (_W,), 5 / 2, 5, 3),
        _Channel(_W, (_U,), 5 / 2, 5, 3),
        _Channel(_W, (_W,), 41 / 4, 7, 4),
    ],
}


def _size(kernel, channel, sources, strengths, targets):
    """Return ``sum_j c |q_j| R^(power - nu)`` of one channel for every target."""
    q = EXTENDED.convert(strengths)
    weight = np.prod([np.sqrt((q[:, k] ** 2).sum(axis=1)) for k in channel.columns], axis=0)
    if hasattr(kernel, "epsilon"):
        weight = weight / (8 * EXTENDED.pi * kernel.viscosity)
    R2 = _distance2(kernel, sources, sources if targets is None else targets)
    return channel.c * (R2 ** ((channel.power - channel.nu) / 2) * weight).sum(axis=1)


def sizes(kernel, sources, strengths, targets=None, factor=lambda channel: 1):
    """Return the sum of the sizes of all terms, (M, value_size), each channel times `factor`."""
    count = len(sources if targets is None else targets)
    result = np.zeros((count, kernel.value_size), np.longdouble)
    for channel in _CHANNELS[type(kernel).__name__]:
        size = _size(kernel, channel, sources, strengths, targets)
        result[:, channel.rows] += (factor(channel) * size)[:, None]
    return result


def truncation(backend, theta, degree):
    """Return the factor of `sizes` that bounds the error of a treecode, for any sources.

    Along y_c + t (y - y_c) a kernel is analytic for |t| < 1/theta, where |R^2| lies between
    (R_c -+ |t| r)^2; on |t| = s Cauchy bounds what a Taylor polynomial leaves out. In one
    coordinate of a box a kernel is analytic in the Bernstein ellipse rho with half axis
    L = (rho + 1/rho)/2 where theta sqrt(1 + L^2) < 1, and interpolation errs by
    4 max|f| rho^-n / (rho - 1), in three by 1 + Lambda + Lambda^2 times as much, and never by more
    than 1 + Lambda^3 times the largest |f| in the box.
    """
    t = np.linspace(0.0, 1.0, 402)[1:-1]
    theta = max(float(theta), 1e-6)  # a bound for a larger theta
    if backend == "taylor":
        s = 1.0 + (1.0 / theta - 1.0) * t
        with np.errstate(divide="ignore"):
            reach, decay = s * theta, s ** -(degree + 1.0) / (1.0 - 1.0 / s)
    else:
        lebesgue = 1.0 + 2.0 / np.pi * np.log(degree + 1.0)
        L = 1.0 + (max(np.sqrt(theta**-2 - 1.0), 1.0) - 1.0) * t
        rho = L + np.sqrt(L**2 - 1.0)
        with np.errstate(divide="ignore"):
            decay = 4.0 * (1.0 + lebesgue + lebesgue**2) * rho**-degree / (rho - 1.0)
        reach = np.append(theta * np.sqrt(1.0 + L**2), theta)
        decay = np.append(decay, 1.0 + lebesgue**3)

    def factor(channel):
        inside = reach < 1.0
        growth = (1.0 + reach[inside]) ** channel.power * (1.0 - reach[inside]) ** -channel.nu
        best = np.min(growth * decay[inside], initial=np.inf)
        return best * (1.0 + theta) ** (channel.nu - channel.power)

    return factor


def assert_within(values, expected, bound, share=1.0):
    """Assert finite ``|values - expected| <= share * bound`` for every entry."""
    assert values.shape == expected.shape
    assert np.isfinite(values).all()
    error, allowed = abs(values - expected), share * bound
    i = np.unravel_index(np.argmax(error - allowed), error.shape) if error.size else None
    assert i is None or error[i] <= allowed[i], f"{error[i]:.3g} > {allowed[i]:.3g} at {i}"
