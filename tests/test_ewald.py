"""Periodic sums: lattice sums, invariances of a lattice, tolerances, and the flow that they are."""

import numpy as np
import pytest

import treecode as tc
from tests.cases.bits import assert_choice_keeps_bits
from tests.cases.ewald_oracle import lattice_sum, wave_sum

CUBE = np.eye(3)
SHEARED = np.array([[1.1, 0.0, 0.0], [0.4, 0.9, 0.0], [0.0, -0.2, 1.0]])
SLAB = np.diag([2.0, 1.5, 0.25])
KINDS = tc.RegularizedStokeslet, tc.RegularizedStokesletRotlet
each_kind = pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
each_cell = pytest.mark.parametrize("cell", [CUBE, SHEARED, SLAB], ids=["cube", "sheared", "slab"])
EXACT = 1e-15  # a tolerance that leaves rounding alone


def periodic(kind, epsilon, cell, **parameters):
    (term,) = tc.Periodic(cell).terms(kind(epsilon, **parameters))
    return term.kernel


def summed(kernel, points, strengths, targets=None, **parameters):
    """Return the sum of a choice as it is, which nothing samples."""
    sum_ = tc.Choice("ewald", **{"tol": EXACT, **parameters}).sum(kernel)
    sum_.set_points(points.T.copy(), None if targets is None else targets.T.copy())
    return sum_.execute(strengths)


def some(kind, cell, n=60, seed=0):
    rng = np.random.default_rng(seed)
    return rng.random((n, 3)) @ cell, rng.standard_normal((n, kind.strength_size))


def error(values, exact):
    """Return the larger of the relative errors of velocities and of angular velocities."""
    columns = [slice(0, 3), slice(3, 6)][: values.shape[1] // 3]
    return max(tc.relative_error(values[:, c], exact[:, c]) for c in columns)


# --- the sum --------------------------------------------------------------------------------------


@pytest.mark.parametrize("cell", [CUBE, SHEARED], ids=["cube", "sheared"])
def test_it_is_the_lattice_sum_of_the_free_kernels(cell):
    """Up to the smooth cut-off of the oracle: 2e-12 for flows and 1e-10 for spins, as it widens."""
    points, q = some(KINDS[1], cell, 4)
    q[:, :3] -= q[:, :3].mean(axis=0)
    targets = points[:2] + 0.05
    exact = lattice_sum(0.1, cell, points, q, targets, 9.0, 1.6)
    values = summed(periodic(KINDS[1], 0.1, cell), points, q, targets)
    assert tc.relative_error(values[:, :3], exact[:, :3]) < 1e-11
    assert tc.relative_error(values[:, 3:], exact[:, 3:]) < 1e-9
    flow = summed(periodic(KINDS[0], 0.1, cell), points, q[:, :3], targets)
    torques = q * [0, 0, 0, 1, 1, 1]
    spun = summed(periodic(KINDS[1], 0.1, cell), points, torques, targets)
    assert tc.relative_error(flow, values[:, :3] - spun[:, :3]) < 1e-13


@each_cell
def test_it_is_the_sum_over_waves_of_the_blob(cell):
    """Also without a short part, and where the whole blob is in it; with a net force."""
    points, q = some(KINDS[1], cell, 20)
    exact = wave_sum(0.35, cell, points, q, points)
    flow = wave_sum(0.35, cell, points, q * [1, 1, 1, 0, 0, 0], points)[:, :3]
    for xi in (None, 3.0, 9.0, 30.0):
        assert error(summed(periodic(KINDS[1], 0.35, cell), points, q, xi=xi), exact) < 1e-13
        values = summed(periodic(KINDS[0], 0.35, cell), points, q[:, :3], xi=xi)
        assert error(values, flow) < 1e-13


@each_kind
@each_cell
@pytest.mark.parametrize("epsilon", [1e-5, 0.02, 0.15])
def test_it_does_not_depend_on_the_split(kind, cell, epsilon):
    """To some roundings; those of spins are of terms like 1 / R^3, which cancel in part."""
    points, q = some(kind, cell)
    values = [summed(periodic(kind, epsilon, cell), points, q, xi=xi) for xi in (5.0, 8.0, 12.0)]
    assert error(values[1], values[0]) < 1e-14 * (1 if kind is KINDS[0] else 10)
    assert error(values[2], values[0]) < 1e-14 * (1 if kind is KINDS[0] else 10)


@each_kind
def test_lattice_and_not_cell_matters(kind):
    """Another basis, points in other images, all points moved: nothing changes but rounding."""
    points, q = some(kind, SHEARED)
    kernel = periodic(kind, 0.02, SHEARED)
    values = summed(kernel, points, q)
    basis = np.array([[1, 2, 0], [0, 1, -1], [0, 0, 1]])
    assert error(summed(periodic(kind, 0.02, basis @ SHEARED), points, q), values) < 1e-13
    images = np.random.default_rng(1).integers(-5, 6, points.shape) @ SHEARED
    assert error(summed(kernel, points + images, q), values) < 1e-13
    assert error(summed(kernel, points + np.array([0.3, -1.7, 0.2]), q), values) < 1e-13
    apart, _ = some(kind, SHEARED, seed=2)
    values = summed(kernel, points, q, apart)
    assert error(summed(kernel, points, q, apart + images), values) < 1e-13


def test_eight_cells_are_one_of_twice_the_edge():
    points, q = some(KINDS[1], CUBE, 10)
    shifts = np.indices((2, 2, 2)).reshape(3, -1).T
    many = (points + shifts[:, None]).reshape(-1, 3)
    values = summed(periodic(KINDS[1], 0.05, 2.0 * CUBE), many, np.tile(q, (8, 1)))
    expected = summed(periodic(KINDS[1], 0.05, CUBE), points, q)
    assert error(values, np.tile(expected, (8, 1))) < 1e-13


@each_kind
@pytest.mark.parametrize(("length", "load"), [(1e-6, 1e12), (3e40, 1e-30)])
def test_any_units(kind, length, load):
    """A sum in other units is the same sum, in single precision too."""
    points, q = some(kind, SHEARED)
    lengths = np.array(kind.value_lengths, float)
    scaled = q * load * length ** np.array(kind.weight_lengths, float)
    for tol in (1e-5, EXACT):
        values = summed(periodic(kind, 0.1, SHEARED), points, q, tol=tol, xi=6.0)
        kernel = periodic(kind, 0.1 * length, length * SHEARED)
        other = summed(kernel, length * points, scaled, tol=tol, xi=6.0 / length)
        assert error(other * length**lengths / load, values) < (1e-6 if tol == 1e-5 else 1e-13)


# --- what it is in physics ------------------------------------------------------------------------


def test_mobility_is_symmetric_and_positive():
    points, _ = some(KINDS[1], SHEARED, 5)
    kernel = periodic(KINDS[1], 0.03, SHEARED)
    columns = [summed(kernel, points, unit.reshape(5, 6)).ravel() for unit in np.eye(30)]
    mobility = np.array(columns)
    assert np.abs(mobility - mobility.T).max() < 1e-13 * np.abs(mobility).max()
    assert np.linalg.eigvalsh(mobility).min() > 0.0


def test_self_mobility_in_a_cube_is_hasimotos():
    """u = F / (6 pi mu a) (1 - 2.837297 a / L + ...): 1/a is that of the blob, 3 / (2 epsilon).

    The next term is in the square of epsilon, which two blobs tell.
    """
    found = []
    for epsilon in (0.02, 0.01):
        kernel = periodic(KINDS[0], epsilon, CUBE, viscosity=0.5)
        velocity = summed(kernel, np.zeros((1, 3)), np.array([[1.0, 0.0, 0.0]]))
        assert np.abs(velocity[0, 1:]).max() < 1e-12
        found.append(1.5 / epsilon - 6.0 * np.pi * 0.5 * velocity[0, 0])
    assert (4.0 * found[1] - found[0]) / 3.0 == pytest.approx(2.837297, abs=1e-6)


@each_kind
def test_flow_and_spin_have_no_mean(kind):
    """By the trapezoidal rule, which is exact for so smooth a flow; forces have a net force."""
    points, q = some(kind, SHEARED, 3)
    places = np.indices((32, 32, 32)).reshape(3, -1).T / 32
    values = summed(periodic(kind, 0.4, SHEARED), points, q, places @ SHEARED)
    assert np.abs(values.mean(axis=0)).max() < 1e-13 * np.abs(values).max()


def test_spin_is_half_the_curl_of_the_flow():
    """By differences of fourth order; the flow has no divergence."""
    points, q = some(KINDS[1], SHEARED, 10)
    x, h = np.array([0.3, 0.5, 0.4]), 2e-3
    steps = h * np.array([-2, -1, 1, 2])[:, None, None] * np.eye(3)
    targets = np.concatenate([[x], (x + steps).reshape(-1, 3)])
    values = summed(periodic(KINDS[1], 0.2, SHEARED), points, q, targets)
    u = values[1:, :3].reshape(4, 3, 3)
    slope = np.tensordot([1.0, -8.0, 8.0, -1.0], u, 1) / (12.0 * h)  # d u_j / d x_i
    curl = np.array(
        [slope[1, 2] - slope[2, 1], slope[2, 0] - slope[0, 2], slope[0, 1] - slope[1, 0]]
    )
    size = np.abs(slope).max()
    assert np.abs(0.5 * curl - values[0, 3:]).max() < 1e-7 * size
    assert abs(np.trace(slope)) < 1e-7 * size


# --- tolerances -----------------------------------------------------------------------------------


def clumped(n):
    rng = np.random.default_rng(3)
    width = 10.0 ** rng.uniform(-3.0, -0.5, 10)
    clump = rng.integers(10, size=n)
    return rng.random((10, 3))[clump] + width[clump, None] * rng.standard_normal((n, 3))


SETS = {
    "uniform": np.random.default_rng(0).random((600, 3)),
    "clumped": clumped(600),
    "few": np.random.default_rng(1).random((7, 3)),
    "one": np.full((1, 3), 0.4),
}


@each_kind
@pytest.mark.parametrize("points", SETS)
@pytest.mark.parametrize("epsilon", [1e-4, 0.02, 0.5])
def test_tolerance_is_kept_before_anything_is_sampled(kind, points, epsilon, capfd):
    """At the sources, and at other targets, where no self term hides what is left out.

    finufft does not complain of what it is asked for.
    """
    points = SETS[points]
    cell = np.diag([1.0, 1.2, 0.9])
    q = np.random.default_rng(2).standard_normal((len(points), kind.strength_size))
    kernel = periodic(kind, epsilon, cell)
    apart = np.random.default_rng(4).random((100, 3))
    targets = np.concatenate([apart, points[:100]])
    exact = tc.evaluate(kernel, points, q, targets, backend="direct")
    for tol in (1e-3, 1e-5, 9e-6, 1e-8, 1e-10, 1e-11):
        values = summed(kernel, points, q, targets, tol=tol)
        for rows in (slice(0, 100), slice(100, None)):
            assert error(values[rows], exact[rows]) <= tol
    assert capfd.readouterr() == ("", "")


@each_kind
@pytest.mark.parametrize("backend", ["auto", "ewald"])
def test_plans_keep_a_tolerance(kind, backend):
    points, q = SETS["clumped"], some(kind, CUBE, 600)[1]
    kernel = periodic(kind, 0.01, CUBE)
    for tol in (1e-4, 1e-9):
        plan = tc.Plan(kernel, backend, tol=tol).set_points(points)
        exact = tc.evaluate(kernel, points, q, backend="direct")
        assert error(plan.execute(q), exact) <= tol
        assert plan.estimate_error(q, by_unit=True) <= tol
        assert plan.choice.backend == "ewald"
        assert not plan.refine(q)


def test_cells_of_any_shape_keep_a_tolerance():
    """Long ones, flat ones, and one whose vectors are nearly parallel."""
    skew = np.array([[1.0, 0.0, 0.0], [3.2, 1.0, 0.0], [-2.1, 1.7, 0.8]])
    for cell in (np.diag([0.1, 0.1, 8.0]), np.diag([5.0, 5.0, 0.1]), skew):
        points, q = some(KINDS[1], cell, 200)
        kernel = periodic(KINDS[1], 0.02, cell)
        exact = tc.evaluate(kernel, points, q, backend="direct")
        for xi in (None, 12.0):
            assert error(summed(kernel, points, q, tol=1e-6, xi=xi), exact) <= 1e-6


# --- as a method of summation ---------------------------------------------------------------------


@each_kind
def test_a_choice_sums_to_the_same_bits(kind):
    """On any number of threads, and after its way through JSON at other points."""
    points, q = some(kind, SHEARED, 3000)
    kernel = periodic(kind, 0.02, SHEARED)
    plan = tc.Plan(kernel, "ewald", tol=1e-5).set_points(points)
    assert_choice_keeps_bits(plan, points, q)


def test_ranks_share_a_sum(on_ranks):
    """Values at a target do not depend on which others are with it."""
    points, q = some(KINDS[0], SHEARED, 700)
    kernel = periodic(KINDS[0], 0.02, SHEARED)
    choice = tc.Choice("ewald", tol=1e-5, xi=9.0)
    alone = tc.Plan(kernel)
    alone.use(choice)
    values = alone.set_points(points).execute(q)

    def same(comm):
        plan = tc.Plan(kernel, comm=comm)
        plan.use(choice)
        return np.array_equal(plan.set_points(points).execute(q), values)

    assert on_ranks(3, same) == [True] * 3


@each_kind
@pytest.mark.parametrize("backend", ["auto", "direct"])
def test_a_plan_sums_in_a_box_that_moves(kind, backend):
    """Its choice stays, and gives what a plan of that box gives; also one of another volume."""
    plan = tc.Plan(kind(0.02), backend, boundary=tc.Periodic(CUBE), tol=1e-6)
    points, q = some(kind, CUBE, 300)
    plan.set_points(points).execute(q)
    choice = plan.choice
    for cell in (SHEARED, 1.7 * CUBE):
        values = plan.set_points(points, boundary=tc.Periodic(cell)).execute(q)
        fixed = tc.Plan(kind(0.02), boundary=tc.Periodic(cell))
        fixed.use(choice)
        assert np.array_equal(fixed.set_points(points).execute(q), values)
        assert np.array_equal(plan.set_points(points).execute(q), values)
        assert plan.estimate_error(q, by_unit=True) <= 1e-6
        assert plan.choice == choice
    with pytest.raises(TypeError, match=r"^boundary must be of the kind of Periodic.*got Wall"):
        plan.set_points(points, boundary=tc.Wall())
    assert np.array_equal(plan.execute(q), values)


def test_nothing_to_sum():
    kernel = periodic(KINDS[1], 0.1, CUBE)
    for backend in ("ewald", "direct"):
        plan = tc.Plan(kernel, backend)
        assert plan.set_points(np.zeros((0, 3))).execute(np.zeros((0, 6))).shape == (0, 6)
        plan.set_points(np.zeros((0, 3)), np.ones((4, 3)))
        assert not plan.execute(np.zeros((0, 6))).any()
        plan.set_points(np.ones((4, 3)), np.zeros((0, 3)))
        assert plan.execute(np.ones((4, 6))).shape == (0, 6)
        assert not plan.set_points(np.ones((4, 3))).execute(np.zeros((4, 6))).any()


# --- refusals -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("cell", "text"),
    [
        ([1.0, 2.0], r"^cell must be three lengths or three lattice vectors, got \[1.0, 2.0\]"),
        ("cube", r"^cell must be three lengths"),
        ([1.0, -2.0, 1.0], r"^cell\[1\] must be a number between 1e-60 and 1e\+60 .*got .*-2.0"),
        ([1.0, 2.0, np.nan], r"^cell\[2\] must be a number .*nan"),
        ([[1, 0, 0], [0, 1, 0], [1, 1, 0]], r"^cell must have a positive volume, got \[\[1"),
        ([[1, 0, 0], [0, 1, 0], [1, np.inf, 0]], r"^cell must be finite"),
    ],
)
def test_what_is_no_cell(cell, text):
    with pytest.raises((ValueError, TypeError), match=text):
        tc.Periodic(cell)


def test_kernels_that_are_not_regularized():
    with pytest.raises(
        ValueError, match=r"^kernel must be RegularizedStokeslet or .*got Stokeslet"
    ):
        tc.Periodic([1.0, 1.0, 1.0]).terms(tc.Stokeslet())


def test_methods_that_do_not_serve():
    kernel = periodic(KINDS[0], 0.1, CUBE)
    for backend in ("kitc", "taylor", "fmm"):
        with pytest.raises(TypeError, match=rf"kernel must have pair.* for backend '{backend}'"):
            tc.Plan(kernel, backend)
    with pytest.raises(TypeError, match=r"kernel must have free, cell for backend 'ewald'"):
        tc.Plan(KINDS[0](0.1), "ewald")
    with pytest.raises(ValueError, match=r"^precision must be None with backend 'ewald'"):
        tc.Plan(kernel, "ewald", precision="float32")
