"""Periodic sums by near images and waves: against oracles, wherever points crowd."""

import itertools

import numpy as np
import pytest

import treecode as tc
from tests.cases.bits import assert_choice_keeps_bits
from tests.cases.ewald_oracle import lattice_sum, wave_sum
from tests.test_ewald import CUBE, KINDS, SHEARED, each_cell, each_kind, error, periodic, some
from treecode.kernels.periodic import PeriodicKernel
from treecode.methods.images.wrapping import Wrapped

LAYER = ((2.0, 0.0, 0.0), (0.4, 1.5, 0.0))  # a slab


def summed(kernel, points, strengths, targets=None, **parameters):
    """Return the sum of a choice as it is, which nothing samples."""
    sum_ = tc.Choice("images", **parameters).sum(kernel)
    sum_.set_points(points.T.copy(), None if targets is None else targets.T.copy())
    return sum_.execute(strengths)


def ball(n, radius, seed=0):
    """Return points that crowd around the corner where eight cells meet."""
    rng = np.random.default_rng(seed)
    points = rng.standard_normal((n, 3))
    points /= np.linalg.norm(points, axis=1)[:, None]
    return points * radius * rng.random((n, 1)) ** (1.0 / 3.0)


def on_sphere(n, radius):
    points = ball(n, 1.0, 1)
    return 0.5 + radius * points / np.linalg.norm(points, axis=1)[:, None]


SETS = {
    "uniform": lambda n: np.random.default_rng(3).random((n, 3)),
    "corner": lambda n: ball(n, 0.1),
    "sphere": lambda n: on_sphere(n, 0.4),
    "two clumps": lambda n: np.concatenate([ball(n // 2, 0.02), ball(n - n // 2, 0.02) + 0.6]),
}


# --- the sum --------------------------------------------------------------------------------------


@pytest.mark.parametrize("cell", [CUBE, SHEARED], ids=["cube", "sheared"])
def test_it_is_the_lattice_sum_of_the_free_kernels(cell):
    """Up to the cut-off of the oracle, see `test_ewald`."""
    points, q = some(KINDS[1], cell, 4)
    q[:, :3] -= q[:, :3].mean(axis=0)
    targets = points[:2] + 0.05
    exact = lattice_sum(0.1, cell, points, q, targets, 9.0, 1.6)
    values = summed(periodic(KINDS[1], 0.1, cell), points, q, targets, tol=1e-12)
    assert tc.relative_error(values[:, :3], exact[:, :3]) < 1e-11
    assert tc.relative_error(values[:, 3:], exact[:, 3:]) < 1e-9


@each_cell
def test_it_is_the_sum_over_waves_of_the_blob(cell):
    """With a net force: the flow has no mean."""
    points, q = some(KINDS[1], cell, 20)
    points[:, 0] *= 0.3
    exact = wave_sum(0.35, cell, points, q, points)
    flow = wave_sum(0.35, cell, points, q * [1, 1, 1, 0, 0, 0], points)[:, :3]
    values = summed(periodic(KINDS[1], 0.35, cell), points, q, tol=1e-10, xi=9.0)
    assert error(values, exact) < 1e-10
    values = summed(periodic(KINDS[0], 0.35, cell), points, q[:, :3], tol=1e-10, xi=9.0)
    assert error(values, flow) < 1e-10


CASES = [  # points, cell, tolerances: few where many images are near
    ("uniform", SHEARED, (1e-3,)),
    ("corner", SHEARED, (1e-3, 1e-5, 1e-10)),
    ("sphere", CUBE, (1e-3, 1e-5)),
    ("two clumps", CUBE, (1e-5, 1e-10)),
    ("two clumps", LAYER, (1e-5, 1e-10)),
]


@each_kind
@pytest.mark.parametrize(("points", "cell", "tolerances"), CASES)
def test_it_keeps_a_tolerance(kind, points, cell, tolerances):
    points = SETS[points](200)
    q = np.random.default_rng(4).standard_normal((len(points), kind.strength_size))
    kernel = PeriodicKernel(kind(0.01), tuple(map(tuple, np.array(cell).tolist())))
    exact = tc.evaluate(kernel, points, q, backend="direct")
    for tol in tolerances:
        assert error(summed(kernel, points, q, tol=tol), exact) <= tol


@each_kind
def test_at_targets_apart_it_keeps_a_tolerance(kind):
    """Most of them are far from the clump, and a few cells away.

    A plan samples: singles may miss it there, and it goes on with a finer sum.
    """
    points, targets = ball(200, 0.1), 0.3 * np.random.default_rng(8).random((50, 3)) + 3.1
    q = np.random.default_rng(4).standard_normal((len(points), kind.strength_size))
    kernel = periodic(kind, 0.01, CUBE)
    exact = tc.evaluate(kernel, points, q, targets, backend="direct")
    for tol in (1e-3, 1e-5, 1e-10):
        plan = tc.Plan(kernel, "images", tol=tol).set_points(points, targets)
        assert error(plan.execute(q), exact) <= tol


def test_with_a_tree_it_keeps_a_tolerance():
    points, q = ball(6000, 0.1), np.random.default_rng(5).standard_normal((6000, 3))
    kernel = periodic(KINDS[0], 0.01, CUBE)
    sum_ = tc.Choice("images", tol=1e-4).sum(kernel)
    sum_.set_points(points.T.copy(), None)
    values = sum_.execute(q)
    assert sum_.info()["far_pairs"] > 0
    exact = tc.evaluate(kernel, points, q, points[::20], backend="direct")
    assert tc.relative_error(values[::20], exact) <= 1e-4


@each_kind
def test_lattice_and_not_cell_matters(kind):
    """Another basis, points in other images, all points moved: nothing but the last bits change."""
    points, q = ball(60, 0.2), some(kind, SHEARED)[1]
    values = summed(periodic(kind, 0.02, SHEARED), points, q, tol=1e-10)
    basis = np.array([[1, 1, 0], [0, 1, -1], [0, 0, 1]])
    other = summed(periodic(kind, 0.02, basis @ SHEARED), points, q, tol=1e-10)
    assert error(other, values) < 2e-10
    kernel = periodic(kind, 0.02, SHEARED)
    images = np.random.default_rng(1).integers(-5, 6, points.shape) @ SHEARED
    assert error(summed(kernel, points + images, q, tol=1e-10), values) < 1e-12
    moved = points + np.array([0.3, -1.7, 0.2])
    assert error(summed(kernel, moved, q, tol=1e-10), values) < 2e-10


@pytest.mark.parametrize(("length", "load"), [(1e-6, 1e12), (3e40, 1e-30)])
def test_any_units(length, load):
    points, q = ball(60, 0.2), some(KINDS[1], SHEARED)[1]
    lengths = np.array(KINDS[1].value_lengths, float)
    scaled = q * load * length ** np.array(KINDS[1].weight_lengths, float)
    kernel = periodic(KINDS[1], 0.1 * length, length * SHEARED)
    values = summed(periodic(KINDS[1], 0.1, SHEARED), points, q, tol=1e-9, xi=6.0)
    other = summed(kernel, length * points, scaled, tol=1e-9, xi=6.0 / length)
    assert error(other * length**lengths / load, values) < 1e-12


# --- images ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("same", [True, False])
def test_all_images_near_the_targets_are_found(same):
    """Each once: as many as a search among all images finds, within slopes of the cell."""
    rng = np.random.default_rng(6)
    sources = (rng.random((40, 3)) * 3.0 @ SHEARED).T
    targets = sources if same else 0.2 * rng.random((3, 10)) + 5.0
    wrapped = Wrapped(SHEARED, sources, targets)
    there = SHEARED.T @ wrapped.targets
    numbers, near = wrapped.near(0.4)
    steps = np.linalg.solve(SHEARED.T, near - sources[:, numbers])
    assert np.abs(steps - np.rint(steps)).max() < 1e-12
    found = set(zip(numbers.tolist(), *np.rint(steps).astype(int).tolist(), strict=True))
    assert len(found) == len(numbers)
    middle = np.rint(np.linalg.solve(SHEARED.T, there.mean(axis=1)[:, None] - sources)).astype(int)
    for j in range(sources.shape[1]):
        for shift in itertools.product(range(-3, 4), repeat=3):
            step = middle[:, j] + shift
            place = sources[:, j] + SHEARED.T @ step
            if np.linalg.norm(there - place[:, None], axis=0).min() < 0.4:
                assert (j, *step.tolist()) in found
    if same:
        assert np.array_equal(numbers[:40], np.arange(40))


def test_a_clump_that_the_cell_cuts_is_whole():
    """Its sources are the only images near, and it is no wider than it is."""
    points = ball(200, 0.1).T
    wrapped = Wrapped(CUBE, points, points)
    numbers, near = wrapped.near(0.5)
    assert np.array_equal(numbers, np.arange(200))
    assert np.ptp(near, axis=1) == pytest.approx(np.ptp(points, axis=1), abs=1e-15)


# --- as a method of summation ---------------------------------------------------------------------


def test_auto_takes_it_where_points_crowd():
    q = np.random.default_rng(7).standard_normal((20_000, 3))
    for points, crowded in ((ball(20_000, 0.1), True), (SETS["uniform"](20_000), False)):
        plan = tc.Plan(periodic(KINDS[0], 0.005, CUBE), tol=1e-3).set_points(points)
        values = plan.execute(q)
        assert (plan.choice.backend == "images") == crowded
        exact = tc.evaluate(plan.kernel, points, q, points[::100], backend="direct")
        assert tc.relative_error(values[::100], exact) <= 1e-3


@each_kind
def test_plans_keep_a_tolerance(kind):
    points, q = ball(400, 0.1), some(kind, CUBE, 400)[1]
    kernel = periodic(kind, 0.01, CUBE)
    exact = tc.evaluate(kernel, points, q, backend="direct")
    for tol in (1e-4, 1e-9):
        plan = tc.Plan(kernel, "images", tol=tol).set_points(points)
        assert error(plan.execute(q), exact) <= tol
        assert plan.estimate_error(q, by_unit=True) <= tol
        assert not plan.refine(q)


@each_kind
def test_a_choice_sums_to_the_same_bits(kind):
    """On any number of threads, and after its way through JSON at other points."""
    points, q = ball(1000, 0.2), some(kind, SHEARED, 1000)[1]
    kernel = periodic(kind, 0.02, SHEARED)
    plan = tc.Plan(kernel, "images", tol=1e-5).set_points(points)
    assert_choice_keeps_bits(plan, points, q)


def test_ranks_share_a_sum(on_ranks):
    """All have the same values, within the tolerance."""
    points, q = ball(300, 0.2), some(KINDS[0], SHEARED, 300)[1]
    kernel = periodic(KINDS[0], 0.02, SHEARED)
    exact = tc.evaluate(kernel, points, q, backend="direct")

    def sum_on(comm):
        plan = tc.Plan(kernel, comm=comm)
        plan.use(tc.Choice("images", tol=1e-5, xi=9.0))
        return plan.set_points(points).execute(q)

    first, *others = on_ranks(3, sum_on)
    assert error(first, exact) <= 1e-5
    assert all(np.array_equal(first, values) for values in others)


def test_nothing_to_sum():
    plan = tc.Plan(periodic(KINDS[1], 0.1, CUBE), "images")
    assert plan.set_points(np.zeros((0, 3))).execute(np.zeros((0, 6))).shape == (0, 6)
    plan.set_points(np.zeros((0, 3)), np.ones((4, 3)))
    assert not plan.execute(np.zeros((0, 6))).any()
    plan.set_points(np.ones((4, 3)), np.zeros((0, 3)))
    assert plan.execute(np.ones((4, 6))).shape == (0, 6)
    assert not plan.set_points(np.ones((4, 3))).execute(np.zeros((4, 6))).any()


def test_no_image_is_near():
    """A split for which a target is far from all sources."""
    kernel = periodic(KINDS[0], 0.01, CUBE)
    points, q, targets = ball(3, 0.01), np.eye(3), np.full((2, 3), 0.5)
    exact = tc.evaluate(kernel, points, q, targets, backend="direct")
    assert tc.relative_error(summed(kernel, points, q, targets, tol=1e-5, xi=20.0), exact) <= 1e-5


def test_refusals():
    with pytest.raises(TypeError, match=r"kernel must have free, cell for backend 'images'"):
        tc.Plan(KINDS[0](0.1), "images")
    with pytest.raises(ValueError, match=r"^precision must be None with backend 'images'"):
        tc.Plan(periodic(KINDS[0], 0.1, CUBE), "images", precision="float32")
