"""Every kernel and backend on points no one wishes for: finite, and as accurate as promised."""

from functools import lru_cache

import numpy as np
import pytest

import treecode as tc
from tests.cases.oracle import (
    assert_within,
    each_backend,
    each_kernel,
    each_treecode,
    exact,
    rounding,
    sizes,
    with_epsilon,
)

THETA = 0.5


# Typed, because kernels are tuples: those of different classes with the same parameters are equal.
@lru_cache(maxsize=None, typed=True)
def _reference(kernel, sources, targets):
    """Return strengths, sum, rounding and sizes for points given as bytes, for all backends."""
    sources = np.frombuffer(sources).reshape(-1, 3)
    targets = None if targets is None else np.frombuffer(targets).reshape(-1, 3)
    strengths = np.random.default_rng(0).uniform(-1.0, 1.0, (len(sources), kernel.strength_size))
    case = kernel, sources, strengths, targets
    return strengths, exact(*case), rounding(*case), sizes(*case)


def solve(kernel, backend, points, targets=None, degree=2, leaf_size=8):
    """Compare with the oracle and return `Plan.info` and the error in units of rounding.

    What a treecode leaves out of a term at r/R <= theta begins with theta^(degree + 1) of its
    size; Chebyshev interpolation errs by less. Without far pairs there is only rounding.
    """
    key = kernel, points.tobytes(), None if targets is None else targets.tobytes()
    strengths, expected, unit, size = _reference(*key)
    plan = tc.Plan(kernel, backend, theta=THETA, degree=degree, leaf_size=leaf_size)
    values = plan.set_points(points, targets).execute(strengths)
    far = plan.info()["far_pairs"] > 0
    assert_within(values, expected, unit + far * THETA ** (degree + 1) * size)
    return plan.info(), abs(values - expected) / np.where(unit > 0, unit, 1.0)


def _cube(rng, n=300):
    return rng.uniform(-1.0, 1.0, (n, 3))


def _on(rng, *directions):
    return rng.uniform(-1.0, 1.0, (300, len(directions))) @ np.array(directions, float)


def _clumps(rng, distance):
    return np.concatenate([_cube(rng, 150), _cube(rng, 150) + np.array([distance, 0.0, 0.0])])


def _lattice(*counts):
    axes = [np.arange(float(n)) for n in counts]
    return np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 3)


# Points, and the length that epsilon is a tenth of.
POINTS = {
    "line": (lambda rng: _on(rng, [1.0, 2.0, -3.0]), 1.0),
    "axis": (lambda rng: _on(rng, [0.0, 1.0, 0.0]) + 0.7, 1.0),
    "plane": (lambda rng: _on(rng, [1.0, 2.0, -3.0], [1.0, -1.0, 0.5]), 1.0),
    "level": (lambda rng: _on(rng, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]) - 0.3, 1.0),
    "needle": (lambda rng: _cube(rng) * np.array([1.0, 1e-8, 1e-16]), 1.0),
    "clumps": (lambda rng: _clumps(rng, 1e8), 1.0),
    "outlier": (lambda rng: np.append(_cube(rng), [[0.0, -1e15, 0.0]], axis=0), 1.0),
    "graded": (lambda rng: _cube(rng) * 0.8 ** np.arange(300.0)[:, None], 1.0),
    "tiny": (lambda rng: 1e-12 * _cube(rng), 1e-12),
    "huge": (lambda rng: 1e12 * _cube(rng), 1e12),
    "small": (lambda rng: 1e-50 * _cube(rng), 1e-50),
    "vast": (lambda rng: 1e50 * _cube(rng), 1e50),
    "offset": (lambda rng: 1e12 + _cube(rng), 1.0),
    "lattice": (lambda rng: _lattice(7, 7, 7) / 3.0, 1.0),
    "faces": (lambda rng: _lattice(9, 9, 5) / 4.0 - 1.0, 1.0),
    "duplicates": (lambda rng: np.tile(_cube(rng, 75), (4, 1)), 1.0),
    "on_itself": (lambda rng: np.repeat(_cube(rng, 4), 75, axis=0), 1.0),
}


@each_kernel
@each_backend
@pytest.mark.parametrize(("degree", "leaf_size"), [(2, 8), (1, 1)])
@pytest.mark.parametrize("name", POINTS)
def test_points(kernel, backend, name, degree, leaf_size):
    """The tree is used, and the sum right, however the points lie and whatever their scale."""
    points, length = POINTS[name]
    kernel = with_epsilon(kernel, 0.1 * length)
    points = points(np.random.default_rng(1))
    info, _ = solve(kernel, backend, points, degree=degree, leaf_size=leaf_size)
    assert backend == "direct" or info["far_pairs"] > 0


@each_kernel
@each_treecode
@pytest.mark.parametrize("name", ["offset", "huge", "tiny", "needle"])
def test_targets_among_other_sources(kernel, backend, name):
    """Targets of their own: far ones, near ones, and one at the centre of the root."""
    points, length = POINTS[name]
    kernel = with_epsilon(kernel, 0.1 * length)
    rng = np.random.default_rng(2)
    points = points(rng)
    low, high = points.min(axis=0), points.max(axis=0)
    middle = 0.5 * low + 0.5 * high
    factors = np.append(0.0, np.repeat([0.3, 1.0, 3.0, 1e8], 20))[:, None]
    targets = middle + factors * rng.uniform(-1.0, 1.0, (81, 3)) * (high - low).max()
    info, _ = solve(kernel, backend, points, targets)
    assert info["far_pairs"] > 0


@each_kernel
@each_backend
@pytest.mark.parametrize("count", [1, 2, 100])
def test_all_points_equal(kernel, backend, count):
    """A cluster without extent: exact at every target, and at the point itself."""
    points = np.tile([0.3, -0.2, 7.0], (count, 1))
    targets = np.concatenate([points[:1], points[:1] + 1e-9, _cube(np.random.default_rng(3), 20)])
    solve(kernel, backend, points)
    info, error = solve(kernel, backend, points, targets)
    assert error.max() <= 1.0
    assert info["depth"] == 0


@each_kernel
@each_backend
@pytest.mark.parametrize("epsilon", [1e6, 1e-8 * 300 ** (-1 / 3)], ids=["wide", "narrow"])
def test_epsilon_far_from_the_spacing(kernel, backend, epsilon):
    """Blobs that cover everything, and blobs that no neighbour feels."""
    info, _ = solve(with_epsilon(kernel, epsilon), backend, _cube(np.random.default_rng(4)))
    assert backend == "direct" or info["far_pairs"] > 0


@each_kernel
@each_backend
@pytest.mark.parametrize("degree", [1, 2, 3, 5])
def test_particles_on_the_chebyshev_points(kernel, backend, degree):
    """At the nodes interpolation is exact, 0/0 in the barycentric formula removed: to rounding."""
    nodes = np.cos(np.arange(degree + 1) * np.pi / degree)
    grid = np.stack(np.meshgrid(nodes, 1.5 + 1.5 * nodes, 0.1 * nodes), axis=-1).reshape(-1, 3)
    points = np.tile(grid, (2, 1))  # twice as many as the proxies
    targets = np.array([9.0, 0.0, 0.0]) + _cube(np.random.default_rng(5), 30)
    info, error = solve(kernel, backend, points, targets, degree, leaf_size=len(points))
    assert (info["near_pairs"] == 0) == (backend != "direct")
    assert backend == "taylor" or error.max() <= 1.0


@each_kernel
@each_backend
@pytest.mark.parametrize("targets", [None, 0, 1, 5])
@pytest.mark.parametrize("count", [0, 1, 2])
def test_few_points(kernel, backend, count, targets):
    """None, one and two sources, and as few targets."""
    rng = np.random.default_rng(6)
    points = _cube(rng, count)
    info, _ = solve(kernel, backend, points, None if targets is None else _cube(rng, targets))
    assert info["sources"] == count
    assert info["targets"] == (count if targets is None else targets)


@each_treecode
@pytest.mark.parametrize("x", [0.1, 0.5, -0.7, 5e-324])
def test_resolution_of_the_coordinates(backend, x):
    """Bisection ends where doubles do: y differ by less than the spacing at x, or by the least."""
    corner = np.full(3, max(2.0 * abs(x), 5e-324))
    y = np.array([[0.0, 1e-20, 0.0], [0.0, 2e-20, 0.0]])
    points = np.concatenate([[corner], [-corner], y + np.array([x, 0.0, 0.0])])
    plan = tc.Plan(tc.Stokeslet(), backend, leaf_size=1).set_points(points)
    assert plan.info()["clusters"] <= 2 * len(points)


@each_kernel
@each_backend
@pytest.mark.parametrize("gap", [1e-15, 1e-30, 1e-55])
def test_close_pairs(kernel, backend, gap):
    """Two points `gap` apart near the origin do not become one, however far the others are."""
    points = _cube(np.random.default_rng(7), 40)
    points[0] = 0.0
    points[1] = [0.0, gap, 0.0]
    solve(with_epsilon(kernel, gap), backend, points)
