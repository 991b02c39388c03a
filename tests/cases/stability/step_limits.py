"""Sections 7 and 8: the longest steps that are stable."""

import itertools
import math
import warnings

import numpy as np
from scipy.special import kv

import mrs
from mrs.time.integrators import METHODS, Chebyshev
from tests.cases import rod_oracle
from tests.cases.linearization import jacobian, spectral_radius
from tests.cases.stability.findings import Finding, at_least, at_most, case
from tests.cases.stability.scenes import kicked, offset, rod_of, simulate

TERMS = {"euler": 1, "heun": 2, "rk4": 4, "bs32": 3}  # of exp(-x) after the first, in R(-x)


@case("7. Integrators about their stability limits")
def stability_limits():
    """A helix near rest; steps of 0.5, 0.9 and 1.1 times the limit over the fastest rate.

    In the basis of the Jacobian's eigenvectors each component of a small displacement is
    multiplied by R(-h lambda) a step, real here: below the limit none grows, above it the fastest
    grows by the R of the textbooks. Displacements of 1e-8 are linear to some 1e-6, and of 1e-4,
    after two steps of the fastest growth, to some 1e-3.
    """
    strain = (1.0, 0.0, 2.0)
    line = mrs.geometry.at_rest(strain, 0.1, 10)
    rod = rod_of(line, 0.02, 0.3, strain, twisting=0.03)
    base = simulate([rod], 0.3)
    rates, vectors = np.linalg.eig(jacobian(base))
    inverse, top = np.linalg.inv(vectors), abs(rates).argmax()
    signs = np.random.default_rng(0).choice([-1e-8, 1e-8], len(rates))
    methods = [*((name, 0) for name in TERMS), ("rkc2", 5), ("rkc2", 10)]
    for (name, stages), share in itertools.product(methods, (0.5, 0.9, 1.1)):
        # SSV eq. 2.6 for s stages; the others state theirs.
        limit = 0.653 * (stages**2 - 1) if stages else METHODS[name].stability_interval()
        h = share * limit / abs(rates[top])
        sim = simulate([rod], 0.3, mrs.Integrator(name, h))
        if stages:
            sim.stepper.method = _FixedStages(stages)
        kicked(sim, (vectors @ signs).real)
        displaced = [abs(inverse @ offset(sim.state, base.state))]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # beyond the limit, as it should say
            for k in range(1, 11 if share < 1.0 else 3):
                sim.step(k * h)
                displaced.append(abs(inverse @ offset(sim.state, base.state)))
        growth = np.array(displaced[1:]) / displaced[0]
        asked = f"{name}{f' with {stages} stages' if stages else ''} at {share} of its limit"
        if share < 1.0:
            yield at_most(f"{asked}: largest component in ten steps", growth.max(), 1.0 + 1e-4)
        else:
            expected = abs(_amplification(name, share * limit, stages))
            yield Finding(
                f"{asked}: growth of the fastest in a step",
                math.sqrt(growth[1, top]),
                (1.0 - 1e-3) * expected,
                (1.0 + 1e-3) * expected,
            )


class _FixedStages(Chebyshev):
    """Runge-Kutta-Chebyshev with a number of stages of its own, whatever the step."""

    def __init__(self, stages):
        self._stages = stages

    def stages(self, h_lambda):
        return self._stages


def _amplification(name, x, stages):
    """Return R(-x): partial sums of exp(-x), and for rkc2 SSV eqs. 2.2-2.3."""
    if name in TERMS:
        return sum((-x) ** k / math.factorial(k) for k in range(TERMS[name] + 1))
    T = np.polynomial.Chebyshev.basis(stages)
    w0 = 1.0 + 2.0 / 13.0 / stages**2
    w1 = T.deriv()(w0) / T.deriv(2)(w0)
    b = T.deriv(2)(w0) / T.deriv()(w0) ** 2
    return 1.0 - b * T(w0) + b * T(w0 - w1 * x)


@case("8. Rods at 1, 2, 4 and 8 times the resolution")
def resolutions():
    """Straight rods of ten nodes and more, bent into helices; and the steps that they allow.

    Shapes converge as ds^2. The step limit is that of an infinite straight rod on a lattice (Bessel
    functions of k epsilon), whatever ds is to epsilon; 2 % are for the ends of a rod of 16 epsilon.
    With epsilon a multiple of ds it falls as ds^2 for stretch and as ds^4 for bending and twist, to
    0.05: a rod of few blobs has more ends.
    """
    factors = (1, 2, 4, 8)
    shapes = []
    for factor in factors:
        line = mrs.geometry.straight(2.0, 10 * factor + 1)
        sim = simulate([rod_of(line, 0.05, 1.0, (1.3, 0.0, 1.5))], 0.4, mrs.Integrator("rk4", 0.05))
        shapes.append(sim.run(0.5).state.positions[::factor])
    steps = [abs(a - b).max() for a, b in itertools.pairwise(shapes)]
    yield at_least("change of shape from once to twice", steps[0], 1e-6)
    order = rod_oracle.orders(steps)[-1]
    yield Finding("observed order of the shape", order, 1.95, 2.05)
    for kind, moduli in (
        ("stretch", {"stretching": 1.0}),
        ("bending", {"bending": 1.0}),
        ("twist", {"twisting": 1.0}),
    ):
        fixed, tied = [], []
        for factor in factors:
            line = mrs.geometry.straight(4.0, 16 * factor + 1)
            ds = 0.25 / factor
            found = spectral_radius(simulate([rod_of(line, 1e-6, 1e-6, **moduli)], 0.25))
            fixed.append(found / _largest_rate(kind, 0.25, ds))
            tied.append(spectral_radius(simulate([rod_of(line, 1e-6, 1e-6, **moduli)], 3.0 * ds)))
        for factor, ratio in zip(factors, fixed, strict=True):
            asked = f"{kind}, epsilon = {factor} ds: step limit over the theory"
            yield Finding(asked, 1.0 / ratio, 0.98, 1.02)
        power = 2.0 if kind == "stretch" else 4.0
        order = -rod_oracle.orders(tied)[-1]
        yield Finding(
            f"{kind}, epsilon = 3 ds: power of ds in the step limit",
            order,
            power - 0.05,
            power + 0.05,
        )


def _largest_rate(kind, epsilon, ds):
    """Return the largest rate of a mode cos(k s) of an infinite straight rod, mu and modulus 1."""
    k = np.linspace(0.0, np.pi / ds, 2001)[1:]
    waves = abs(
        k + 2.0 * np.pi / ds * np.arange(-3, 4)[:, None]
    )  # a sum over nodes is one of these
    return (
        _response(kind, waves, epsilon).sum(axis=0) * (2.0 / ds * np.sin(0.5 * k * ds)) ** 2
    ).max()


def _response(kind, k, epsilon):
    """Return the Fourier transform of the velocity or spin along a line, for a unit load a length.

    Of physics.md 7; for bending of D1 / 4 = (15 eps^4 R^-7 - 3 eps^2 R^-5 - 2 R^-3) / (32 pi).
    """
    x = k * epsilon
    if kind == "stretch":
        return kv(0, x) / (2.0 * np.pi)
    if kind == "twist":
        return (2.0 * x * kv(1, x) + x**2 * kv(2, x)) / (8.0 * np.pi * epsilon**2)
    spin = x**3 * kv(3, x) - x**2 * kv(2, x) - 2.0 * x * kv(1, x)
    return spin / (16.0 * np.pi * epsilon**2)
