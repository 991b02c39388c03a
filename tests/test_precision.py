"""Sums in single precision: what rounding leaves of them, and when a tolerance asks for them."""

import numpy as np
import pytest

import treecode as tc
from tests.cases.oracle import (
    BACKENDS,
    KERNELS,
    each_backend,
    each_kernel,
    exact,
    random_case,
    with_epsilon,
)
from treecode.choice.probe import Probe
from treecode.choice.search import Search

SINGLE = 2.0**-24
OPTIONS = {"theta": 0.6, "degree": 6, "leaf_size": 100}


def both(kernel, backend, points, strengths, targets=None):
    """Return the sums in doubles and in singles, and their plans."""
    plans = [
        tc.Plan(kernel, backend, precision=precision, **OPTIONS).set_points(points, targets)
        for precision in ("float64", "float32")
    ]
    return [plan.execute(strengths) for plan in plans], plans


@each_backend
@each_kernel
def test_differs_by_rounding(kernel, backend):
    """The same pairs; a hundred roundings for what is added, subtracted and close together."""
    points, strengths, targets = random_case(kernel, 3000, 0, targets=700)
    values, plans = both(kernel, backend, points, strengths, targets)
    difference = tc.relative_error(values[1], values[0])
    assert 0.1 * SINGLE < difference < 100.0 * SINGLE
    pairs = [(plan.info()["near_pairs"], plan.info()["far_pairs"]) for plan in plans]
    assert pairs[0] == pairs[1]
    assert [plan.info()["precision"] for plan in plans] == ["float64", "float32"]


@pytest.mark.parametrize("kernel", KERNELS[:2], ids=lambda kernel: type(kernel).__name__)
def test_against_the_oracle(kernel):
    points, strengths, targets = random_case(kernel, 1000, 1, targets=200)
    values, _ = both(kernel, "direct", points, strengths, targets)
    assert tc.relative_error(values[1], exact(kernel, points, strengths, targets)) < 30.0 * SINGLE


@each_backend
@each_kernel
def test_far_from_the_origin(kernel, backend):
    """Coordinates are relative to a cluster: what matters is its size, not where it is.

    At 2^20 a single resolves a sixteenth; the points are multiples of 2^-20, which a double keeps.
    """
    points, strengths, _ = random_case(kernel, 1500, 2)
    points = np.round(points * 2.0**20) / 2.0**20
    (_, near), _ = both(kernel, backend, points, strengths)
    (_, far), _ = both(kernel, backend, points + 2.0**20, strengths)
    assert tc.relative_error(far, near) < 100.0 * SINGLE


@each_backend
@pytest.mark.parametrize("kernel", KERNELS[2:], ids=lambda kernel: type(kernel).__name__)
def test_coincident_points(kernel, backend):
    """A point does nothing to itself in singles either, nor to one that a square cannot tell."""
    points, strengths, _ = random_case(kernel, 400, 3)
    points[200:300] = points[:100]
    points[300:] = [0.0, 0.0, 1e-25] * np.arange(100)[:, None]
    values, _ = both(kernel, backend, points[:300], strengths[:300])
    assert tc.relative_error(values[1], values[0]) < 200.0 * SINGLE
    values, _ = both(kernel, backend, points[300:], strengths[300:])
    assert not values[1].any()


@each_kernel
def test_weights_take_half_the_memory(kernel):
    points, strengths, _ = random_case(kernel, 3000, 4)
    _, plans = both(kernel, "kitc", points, strengths)
    terms = (OPTIONS["degree"] + 1) ** 3 * kernel.weight_size
    clusters = (plans[0].info()["bytes"] - plans[1].info()["bytes"]) / (4 * terms)
    assert clusters == int(clusters) > 5


# --- by tolerance ---------------------------------------------------------------------------------


def choice_for(tol, points, strengths, backend="kitc", kernel=KERNELS[0]):
    plan = tc.Plan(kernel, backend, tol=tol).set_points(points)
    values = plan.execute(strengths)
    drawn = np.random.default_rng(0).permutation(len(points))[:300]
    expected = exact(kernel, points, strengths, points[drawn]).astype(float)
    assert tc.relative_error(values[drawn], expected) <= tol
    return plan.choice


@pytest.mark.parametrize("backend", BACKENDS[1:])
def test_is_what_the_tolerance_allows(backend):
    points, strengths, _ = random_case(KERNELS[0], 4000, 5)
    assert choice_for(1e-3, points, strengths, backend).parameters["precision"] == "float32"
    assert choice_for(1e-8, points, strengths, backend).parameters["precision"] == "float64"


def test_cancellation_needs_doubles():
    """Pairs that push against each other leave a thousandth of what each does."""
    points, strengths, _ = random_case(KERNELS[0], 4000, 6)
    points[2000:] = points[:2000] + 1e-4
    assert choice_for(1e-4, points, strengths).parameters["precision"] == "float32"
    strengths[2000:] = -strengths[:2000]
    assert choice_for(1e-4, points, strengths).parameters["precision"] == "float64"


@pytest.mark.parametrize("unit", [1e-30, 1e30])
@each_kernel
def test_beyond_the_range_of_singles(kernel, unit):
    points, strengths, _ = random_case(kernel, 1500, 7)
    kernel = with_epsilon(kernel, 0.1 * unit)
    choice = choice_for(1e-2, unit * points, strengths, "auto", kernel)
    assert choice.parameters.get("precision") in ("float64", None)


@pytest.mark.parametrize(("seen", "tol"), [(1e-3, 3e-8), (0.0, 1e-7)])
def test_a_miss_is_corrected(monkeypatch, seen, tol):
    """Where the look at a few targets sees little or none of the rounding, the sample finds it."""
    points, strengths, _ = random_case(KERNELS[0], 4000, 8)
    look = Probe.error_of

    def blind(case, choice, *args):
        single = choice.parameters.get("precision") == "float32"
        return (seen if single else 1.0) * look(case, choice, *args)

    bounds = []
    bound = Search.bound
    monkeypatch.setattr(Probe, "error_of", blind)
    monkeypatch.setattr(Search, "bound", lambda *args: bounds.append(bound(*args)) or bounds[-1])
    assert choice_for(tol, points, strengths).parameters["precision"] == "float64"
    assert bounds[0] > tol


@pytest.mark.interpreted
@pytest.mark.parametrize("backend", BACKENDS)
def test_small_enough_to_interpret(backend):
    kernel = KERNELS[0]
    points, strengths, targets = random_case(kernel, 60, 9, targets=5)
    plan = tc.Plan(kernel, backend, theta=0.6, degree=1, leaf_size=9, precision="float32")
    values = plan.set_points(points, targets).execute(strengths)
    error = tc.relative_error(values, exact(kernel, points, strengths, targets))
    assert error < (1e-5 if backend == "direct" else 0.6**2)
