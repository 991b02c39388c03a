"""Slabs, periodic in a plane: lattice sums, means over planes, tolerances, and scenes in them."""

import numpy as np
import pytest

import mrs
import treecode as tc
from mrs import observables as obs
from tests.cases.ewald_oracle import plane_sum
from tests.test_boxes_in_scenes import CONTACT, EXACT
from tests.test_ewald import error, summed

CELL = np.array([[1.1, 0.0, 0.0], [0.4, 0.9, 0.0]])
KINDS = tc.RegularizedStokeslet, tc.RegularizedStokesletRotlet
each_kind = pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)


def slab(kind, epsilon, cell=CELL, **parameters):
    (term,) = tc.Periodic(cell, "xy").terms(kind(epsilon, **parameters))
    return term.kernel


def some(kind, n=60, height=0.8, seed=0):
    rng = np.random.default_rng(seed)
    points = rng.random((n, 2)) @ CELL
    points[:, 2] = height * rng.random(n)
    return points, rng.standard_normal((n, kind.strength_size))


# --- the sum --------------------------------------------------------------------------------------


def test_it_is_the_sum_over_a_plane_of_images():
    """The oracle approaches it with the fifth power of its radius, to 2e-9."""
    points, q = some(KINDS[1], 4)
    q[:, :3] -= q[:, :3].mean(axis=0)
    targets = points[:2] + 0.05
    values = summed(slab(KINDS[1], 0.1), points, q, targets)
    far, farther = (
        error(plane_sum(0.1, CELL, points, q, targets, radius), values) for radius in (8.0, 16.0)
    )
    assert farther < 4e-9
    assert np.log2(far / farther) == pytest.approx(5.0, abs=0.3)


@pytest.mark.parametrize("epsilon", [1e-3, 0.1, 0.6])
def test_the_mean_over_a_plane_is_the_flow_of_its_height(epsilon):
    """Of a net force and torque: shear on both sides, for any height of the slab.

    A mean over 40 x 40 points leaves waves that are exp(-40 pi) times as large, at 0.5.
    """
    f, n, mu = np.array([0.7, -0.4, 1.3]), np.array([-0.2, 0.9, 0.5]), 0.3
    kernel = slab(KINDS[1], epsilon, viscosity=mu)
    grid = np.indices((40, 40)).reshape(2, -1).T / 40.0 @ CELL
    area = np.linalg.norm(np.cross(*CELL))
    for z in (-2.5, -0.5, 0.7, 12.0):
        targets = grid + np.array([0.0, 0.0, z])
        source = np.array([[0.3, 0.2, 0.0]])
        mean = summed(kernel, source, np.array([[*f, *n]]), targets).mean(axis=0)
        Z = np.hypot(z, epsilon)
        t = z / Z
        h, slope, bend = (Z + z * t) / 2.0, (3.0 * t - t**3) / 2.0, 1.5 * epsilon**4 / Z**5
        expected = [
            -h * f[0] + 0.5 * slope * n[1],
            -h * f[1] - 0.5 * slope * n[0],
            0.0,
            0.5 * slope * f[1] + 0.25 * bend * n[0],
            -0.5 * slope * f[0] + 0.25 * bend * n[1],
            0.0,
        ]
        flow = np.array(expected) / (2.0 * mu * area)
        np.testing.assert_allclose(mean, flow, atol=1e-13 * abs(z))


@each_kind
@pytest.mark.parametrize("epsilon", [1e-5, 0.02, 0.5])
def test_it_depends_on_neither_split_nor_padding(kind, epsilon):
    """Points far above pad the box anew; so does another tolerance, within which it is the same."""
    points, q = some(kind)
    kernel = slab(kind, epsilon)
    values = summed(kernel, points, q)
    for xi in (5.0, 9.0):
        assert error(summed(kernel, points, q, xi=xi), values) < 1e-13
    for high in (1.7, 30.0):
        targets = np.concatenate([points, [[0.2, 0.1, high]]])
        assert error(summed(kernel, points, q, targets)[:-1], values) < 1e-13
    assert error(summed(kernel, points, q, tol=1e-9), values) < 1e-9


@each_kind
def test_lattice_and_not_cell_matters(kind):
    """Another basis, points in other images, all points moved: nothing changes but rounding."""
    points, q = some(kind)
    kernel = slab(kind, 0.02)
    values = summed(kernel, points, q)
    basis = np.array([[1, 3], [1, 4]])
    assert error(summed(slab(kind, 0.02, basis @ CELL), points, q), values) < 1e-13
    images = np.random.default_rng(1).integers(-5, 6, (len(points), 2)) @ CELL
    assert error(summed(kernel, points + images, q), values) < 1e-13
    assert error(summed(kernel, points + np.array([0.3, -1.7, 9.2]), q), values) < 1e-13


def test_it_is_the_free_sum_where_the_cell_is_wide():
    """Force dipoles of length l move themselves through their images by a part (l / L)^3."""
    points, q = some(KINDS[0], 6, 0.3)
    q -= q.mean(axis=0)
    free = tc.evaluate(KINDS[0](0.2), points, q, backend="direct")
    small, large = (
        error(summed(slab(KINDS[0], 0.2, size * np.eye(2, 3)), points, q), free)
        for size in (8.0, 16.0)
    )
    assert np.log2(small / large) == pytest.approx(3.0, abs=0.2)


SETS = {
    "layer": some(KINDS[0], 250)[0],
    "plane": some(KINDS[0], 250, 0.0)[0],
    "tower": some(KINDS[0], 250, 12.0)[0],
}


@each_kind
@pytest.mark.parametrize("points", SETS)
def test_plans_keep_a_tolerance(kind, points):
    points = SETS[points]
    q = np.random.default_rng(2).standard_normal((len(points), kind.strength_size))
    boundary = tc.Periodic(CELL, "xy")
    exact = tc.Plan(kind(0.02), "direct", boundary=boundary).set_points(points).execute(q)
    for tol in (1e-4, 1e-9):
        plan = tc.Plan(kind(0.02), tol=tol, boundary=boundary).set_points(points)
        assert error(plan.execute(q), exact) <= tol
        assert plan.choice.backend == "ewald"


def test_ranks_share_a_sum(on_ranks):
    points, q = some(KINDS[1], 300)
    choice = tc.Choice("ewald", tol=1e-5, xi=9.0)

    def sum_on(comm):
        plan = tc.Plan(slab(KINDS[1], 0.02), comm=comm)
        plan.use(choice)
        return plan.set_points(points, points[::3]).execute(q)

    alone = sum_on(None)
    assert all(np.array_equal(values, alone) for values in on_ranks(3, sum_on))


@pytest.mark.parametrize(
    ("cell", "axes", "text"),
    [
        ([1.0, 2.0, 3.0], "xy", r"^cell must be two lengths or two lattice vectors with axes 'xy'"),
        ([1.0, 0.0], "xy", r"^cell\[1\] must be .*got 0.0"),
        ([[1, 0, 0], [2, 0, 0]], "xy", r"^cell must have a positive area, got"),
        ([[1, 0, 0], [0, 1, 0.1]], "xy", r"^cell must have vectors across z with axes 'xy', got"),
        ([1.0, 2.0], "yz", r"^axes must be one of 'xyz', 'xy', got 'yz'"),
    ],
)
def test_what_is_no_cell(cell, axes, text):
    with pytest.raises(ValueError, match=text):
        tc.Periodic(cell, axes)


# --- scenes ---------------------------------------------------------------------------------------

SQUARE = 3.0 * np.eye(2, 3)


def swimmers(shifts=0.0):
    rng = np.random.default_rng(3)
    x, p = rng.random((9, 3)) * [3.0, 3.0, 1.0], rng.standard_normal((9, 3))
    return mrs.Swimmers(x + shifts, p, length=0.7, force=1.0, epsilon=0.1)


def test_each_body_may_be_in_any_image_of_the_cell():
    """Contacts are those of a box that is much too high to touch its images along z."""
    fluid = mrs.Fluid(0.7, boundary=mrs.Periodic(SQUARE, "xy"))
    images = np.random.default_rng(7).integers(-4, 5, (9, 2)) @ SQUARE
    here, there = (
        mrs.Simulation(fluid, [swimmers(shift)], forces=[CONTACT], backend=EXACT).now
        for shift in (0.0, images)
    )
    for name in ("loads", "motion"):
        values = getattr(here, name)
        np.testing.assert_allclose(
            getattr(there, name), values, atol=1e-12 * np.abs(values).max(), err_msg=name
        )
    box = mrs.Fluid(0.7, boundary=mrs.Periodic((3.0, 3.0, 30.0)))
    in_box = mrs.Simulation(box, [swimmers()], forces=[CONTACT], backend=EXACT).now
    np.testing.assert_allclose(in_box.loads, here.loads, atol=1e-12)
    assert np.abs(here.loads).max() > 1.1  # more than the swimmers' own force: some touch


def test_backgrounds_of_slabs():
    """Flows that depend on z alone leave it as it is; a shear along it carries it along."""
    slab = mrs.Periodic(SQUARE, "xy")
    for flow in (mrs.flows.shear(1.0), mrs.flows.QuadraticFlow(quadratic=_parabola())):
        fluid = mrs.Fluid(boundary=slab, background=flow)
        assert fluid.boundary_at(0.3) is slab
    fluid = mrs.Fluid(boundary=slab, background=mrs.flows.shear(1.0, gradient=(0, 1, 0)))
    np.testing.assert_allclose(fluid.boundary_at(0.75).vectors, [[3, 0, 0], [-0.75, 3, 0]])
    with pytest.raises(ValueError, match=r"^background must be the same in each box"):
        mrs.Fluid(boundary=slab, background=mrs.flows.poiseuille(1.0, 2.0))
    with pytest.raises(ValueError, match=r"^background must be a shear along"):
        mrs.Fluid(boundary=slab, background=mrs.flows.extension(1.0))


def _parabola():
    quadratic = np.zeros((3, 3, 3))
    quadratic[0, 2, 2] = 1.0
    return quadratic


def test_a_run_in_a_sheared_slab(tmp_path):
    """Its frames are wrapped along the slab only, and tracks are not; pairs have no g(r)."""
    fluid = mrs.Fluid(boundary=mrs.Periodic((3.0, 3.0), "xy"), background=mrs.flows.shear(9.0))
    output = mrs.Output(tmp_path, 0.25)
    rk4 = mrs.Integrator("rk4", dt=0.125)
    sim = mrs.Simulation(fluid, [swimmers()], output=output, integrator=rk4).run(0.5)
    found = obs.tracks(tmp_path, "swimmers")
    np.testing.assert_array_equal(found.cell, SQUARE)
    end = sim.body_state(sim.bodies[0]).positions
    np.testing.assert_allclose(found.positions[-1], end, atol=1e-13)
    assert np.ptp(end[:, 0]) > 3.0
    points, velocity = mrs.frame_velocity(tmp_path)
    assert points[:, :2].min() > -0.4
    assert points[:, :2].max() < 3.4
    targets = np.random.default_rng(1).uniform(-1.0, 4.0, (5, 3))
    np.testing.assert_allclose(velocity(targets), sim.velocity(targets), rtol=1e-3)
    columns = {"g": obs.PairDistribution("swimmers", [0.0, 1.0])}
    with pytest.raises(ValueError, match=r"columns\['g'\]: cell must have three lattice vectors"):
        mrs.Simulation(fluid, [swimmers()], output=mrs.Output(tmp_path / "g", 1, columns=columns))
