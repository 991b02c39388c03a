"""exp, log and erf of lanes against mpmath, and a kernel that is made of them."""

import math
from pathlib import Path

import mpmath as mp
import numba
import numpy as np
import pytest

import treecode as tc
from benchmarks import fit_elements
from gaussian import GaussianStokeslet
from treecode import _elements
from treecode._lanes import lane_count, load, store

ELEMENTS = {"exp": (tc.exp, mp.exp), "log": (tc.log, mp.log), "erf": (tc.erf, mp.erf)}
PRECISIONS = [np.float64, np.float32]


def of_lanes(function):
    """Return a function of arrays that takes lanes."""
    inner = numba.njit(function)

    @numba.njit(error_model="numpy")
    def loop(x, out):
        for j in range(0, x.shape[1], lane_count(x)):
            store(out, 0, j, inner(load(x, 0, j)))

    def call(x):
        padded = np.ones((1, -(-len(x) // 64) * 64), x.dtype)
        padded[0, : len(x)] = x
        out = np.empty_like(padded)
        loop(padded, out)
        return out[0, : len(x)]

    return call


exp, log, erf = tc.exp, tc.log, tc.erf
CALLS = {
    "exp": of_lanes(lambda x: exp(x)),
    "log": of_lanes(lambda x: log(x)),
    "erf": of_lanes(lambda x: erf(x)),
}
MATH = {
    "exp": of_lanes(lambda x: math.exp(x)),
    "log": of_lanes(lambda x: math.log(x)),
    "erf": of_lanes(lambda x: math.erf(x)),
}


def points(name, dtype):
    """Return arguments over the whole range, where functions are small, and where ranges meet."""
    rng = np.random.default_rng(0)
    info = np.finfo(dtype)
    if name == "exp":
        least, most = math.log(float(info.smallest_subnormal)), math.log(float(info.max))
        parts = [rng.uniform(least, most, 2000), rng.uniform(-1, 1, 1000)]
        parts += [0.5 * math.log(2) * np.arange(-9, 10) + rng.uniform(-1e-6, 1e-6, 19)]
    elif name == "log":
        parts = [2.0 ** rng.uniform(info.minexp, info.maxexp, 2000), rng.uniform(0.3, 3, 1000)]
        parts += [1 + rng.uniform(-1, 1, 500) * 10.0 ** rng.uniform(-15, -1, 500)]
        parts += [float(info.tiny) * rng.random(500), math.sqrt(0.5) + 1e-6 * rng.normal(size=50)]
    else:
        parts = [rng.uniform(-7, 7, 2000), rng.uniform(-1.1, 1.1, 1000)]
        parts += [10.0 ** rng.uniform(math.log10(float(info.tiny)), 0, 500)]
    x = np.concatenate(parts).astype(dtype)
    return np.append(x, np.array([0.0, 1.0, info.tiny, info.smallest_subnormal], dtype))


@pytest.mark.parametrize("dtype", PRECISIONS)
@pytest.mark.parametrize("name", ELEMENTS)
def test_two_units_of_the_last_place(name, dtype):
    x = points(name, dtype)
    values = CALLS[name](x)
    assert np.array_equal(MATH[name](x), values)  # the same by the name in `math`
    with mp.workdps(40):
        for argument, value in zip(x, values, strict=True):
            if name == "log" and argument == 0.0:
                continue
            exact = ELEMENTS[name][1](mp.mpf(float(argument)))
            unit = mp.mpf(float(np.spacing(np.abs(dtype(float(exact))))))
            assert abs(mp.mpf(float(value)) - exact) < 2 * unit, (argument, value)


LIMITS = {
    "exp": ([-np.inf, -1e5, 0.0, 1e5, np.inf], [0.0, 0.0, 1.0, np.inf, np.inf]),
    "log": ([-np.inf, -1.0, -0.0, 0.0, 1.0, np.inf], [np.nan, np.nan, -np.inf, -np.inf, 0, np.inf]),
    "erf": ([-np.inf, -1e5, -0.0, 0.0, 1e5, np.inf], [-1.0, -1.0, -0.0, 0.0, 1.0, 1.0]),
}


@pytest.mark.parametrize("name", LIMITS)
def test_ends_of_the_range(name):
    arguments, expected = LIMITS[name]
    for dtype in PRECISIONS:
        x, exact = np.array([*arguments, np.nan], dtype), np.array([*expected, np.nan], dtype)
        values = CALLS[name](x)
        assert np.array_equal(values, exact, equal_nan=True)
        assert np.array_equal(np.signbit(values[:-1]), np.signbit(exact[:-1])) or name == "log"


@pytest.mark.interpreted
@pytest.mark.parametrize("name", LIMITS)
def test_plain_numbers(name):
    """Where nothing is compiled, and in `weights`, they take numbers."""
    function = ELEMENTS[name][0]
    for argument, exact in zip(*LIMITS[name], strict=True):
        assert np.array_equal(function(argument), exact, equal_nan=True)
    assert math.isnan(function(math.nan))
    compiled = numba.njit(lambda x: function(x), error_model="numpy")
    for argument in (0.3, 2.0, 2):
        assert function(argument) == pytest.approx(getattr(math, name)(argument), rel=1e-15)
        assert compiled(argument) == pytest.approx(getattr(math, name)(argument), rel=1e-15)


@pytest.mark.parametrize("dtype", PRECISIONS)
def test_powers_roots_and_sizes(dtype):
    x = np.random.default_rng(0).uniform(-3, 3, 64).astype(dtype)
    rounding = 4 * np.finfo(dtype).eps
    for power in (0, 1, 2, 3, 7, -1, -4):
        values = of_lanes(lambda x, n=power: x**n)(x)
        assert np.allclose(values, x.astype(float) ** power, rtol=rounding, atol=0)
    assert np.array_equal(of_lanes(lambda x: abs(x))(x), np.abs(x))
    assert np.array_equal(of_lanes(lambda x: math.sqrt(x * x))(x), np.sqrt(x * x))

    def changed(x):
        x **= 2
        x += 1.0
        x *= 3.0
        x -= 2.0
        x /= 4.0
        return x

    expected = (3 * (x.astype(float) ** 2 + 1) - 2) / 4
    assert np.allclose(of_lanes(changed)(x), expected, rtol=rounding, atol=0)


def test_where_of_parameters():
    """A condition on plain numbers chooses as well."""
    choose = numba.njit(lambda a: tc.where(a > 1.0, a, -1.0))
    assert (choose(2.0), choose(0.5)) == (2.0, -1.0)


@pytest.mark.parametrize("bits", [64, 32])
@pytest.mark.parametrize("name", ["exp", "log", "erf", "erfc"])
def test_polynomials_are_the_fitted_ones(name, bits):
    found, error = fit_elements.coefficients(bits, name)
    assert error < (2e-17 if bits == 64 else 1e-8)
    kept = _elements._POLYNOMIALS[bits][name]
    assert np.allclose(kept, found, rtol=1e-13 if bits == 64 else 1e-8, atol=0)


# --- a kernel that is made of them ---

EPSILON, VISCOSITY = 0.3, 1.7
KERNEL = GaussianStokeslet(EPSILON, VISCOSITY)


def exact_velocity(r, force):
    """The formula in mpmath."""
    d = mp.sqrt(sum(c * c for c in r))
    n = [c / d for c in r]
    x, along = d / EPSILON, sum(a * b for a, b in zip(n, force, strict=True))
    near = 2 * mp.exp(-x * x) / (mp.sqrt(mp.pi) * EPSILON)
    far = mp.erf(x) / d
    return [
        ((far + near) * f + (far - near) * along * c) / (8 * mp.pi * VISCOSITY)
        for c, f in zip(n, force, strict=True)
    ]


def blob(*r):
    x2 = sum(c * c for c in r) / mp.mpf(EPSILON) ** 2
    return (mp.mpf(5) / 2 - x2) * mp.exp(-x2) / (mp.pi**1.5 * mp.mpf(EPSILON) ** 3)


def test_formula_is_the_flow_of_the_blob():
    """div u = 0; the curl of mu lap u = grad p - f blob knows no pressure; far away a Stokeslet."""
    force = [mp.mpf("0.3"), mp.mpf("-1.1"), mp.mpf("0.7")]

    def u(component):
        return lambda *r: exact_velocity(r, force)[component]

    def derivative(function, at, *order):
        return mp.diff(function, at, tuple(order))

    e = np.eye(3, dtype=int)
    with mp.workdps(40):
        for at in ((0.11, -0.2, 0.15), (0.5, 0.3, -0.2), (-0.02, 0.01, 0.03)):
            at = tuple(map(mp.mpf, at))
            assert abs(sum(derivative(u(i), at, *e[i].tolist()) for i in range(3))) < 1e-12
            for j, k in ((1, 2), (2, 0), (0, 1)):
                laplacian = sum(
                    derivative(u(k), at, *(e[j] + 2 * e[d]).tolist())
                    - derivative(u(j), at, *(e[k] + 2 * e[d]).tolist())
                    for d in range(3)
                )
                slope_j, slope_k = (derivative(blob, at, *e[d].tolist()) for d in (j, k))
                assert abs(VISCOSITY * laplacian + slope_j * force[k] - slope_k * force[j]) < 1e-9
        whole = mp.quad(lambda r: 4 * mp.pi * r * r * blob(r, 0, 0), [0, 1, 10])
        assert abs(whole - 1) < 1e-15
        at = 3, -4, 12
        along = sum(a * f for a, f in zip(at, force, strict=True)) / 13**2
        for value, a, f in zip(exact_velocity(at, force), at, force, strict=True):
            assert abs(value - (f + along * a) / (8 * mp.pi * VISCOSITY * 13)) < 1e-30


def test_sums_are_those_of_the_formula():
    rng = np.random.default_rng(1)
    points, forces = rng.uniform(-1, 1, (12, 3)), rng.normal(size=(12, 3))
    points[1] = points[0] + 1e-9  # where terms cancel
    points[2] = points[0] + [1e-4, 0.0, 0.0]
    exact = np.zeros((12, 3))
    for i in range(12):
        for j in range(12):
            if i == j:
                own = 4 / (math.sqrt(math.pi) * EPSILON) / (8 * math.pi * VISCOSITY)
                exact[i] += own * forces[i]
            else:
                difference = [mp.mpf(a) - mp.mpf(b) for a, b in zip(*points[[i, j]], strict=True)]
                exact[i] += np.array(
                    exact_velocity(difference, list(map(mp.mpf, forces[j]))), float
                )
    values = tc.evaluate(KERNEL, points, forces, backend="direct")
    assert tc.relative_error(values, exact) < 3e-16 * 12


def test_all_backends_take_it():
    rng = np.random.default_rng(2)
    points, forces = rng.random((4000, 3)), rng.normal(size=(4000, 3))
    kernel = GaussianStokeslet(0.05, 1.0)
    exact = tc.evaluate(kernel, points, forces, backend="direct")
    singles = tc.evaluate(kernel, points, forces, backend="direct", precision="float32")
    assert 1e-9 < tc.relative_error(singles, exact) < 1e-6
    plan = tc.Plan(kernel, "kitc", degree=7, theta=0.5, leaf_size=60).set_points(points)
    assert tc.relative_error(plan.execute(forces), exact) < 1e-5
    assert plan.info()["far_pairs"] > 0
    plan = tc.Plan(kernel, "fmm", tol=1e-4, leaf_size=40).set_points(points)
    assert tc.relative_error(plan.execute(forces), exact) < 1e-4
    assert plan.info()["far_pairs"] > 0


def test_page_shows_the_tested_file():
    page = Path(__file__).parents[1] / "docs" / "add-a-kernel.md"
    source = Path(__file__).with_name("gaussian.py").read_text()
    assert f"```python\n{source}```" in page.read_text()
