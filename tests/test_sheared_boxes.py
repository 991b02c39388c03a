"""Boxes that a shear flow carries along: their lattice, bodies in them, and the files of runs."""

import csv

import numpy as np
import pytest

import mrs
from mrs import observables as obs
from mrs.output.trajectory import Trajectory
from tests.test_boxes_in_scenes import CONTACT, EXACT, bodies
from tests.test_runs import assert_equal_runs

CUBE = 3.0 * np.eye(3)
INCLINED = np.array([[3.0, 0.0, 0.0], [1.2, 2.8, 0.0], [-0.5, 0.7, 2.6]])
RATE = 0.8
SHEARS = {
    "cube": (CUBE, mrs.flows.shear(RATE, origin=(0.3, 0.2, 0.7))),
    "inclined": (INCLINED, mrs.flows.shear(RATE, gradient=(0.0, 0.6, 0.8))),
    "along the second": (INCLINED, mrs.flows.shear(-RATE, INCLINED[1], (-2.8, 1.2, 0.0))),
}
each_shear = pytest.mark.parametrize(("cell", "flow"), SHEARS.values(), ids=SHEARS.keys())


def sheared(cell, flow, **options):
    return mrs.Fluid(0.7, boundary=mrs.Periodic(cell), background=flow, **options)


def moved(cell, flow, time):
    """Return lattice vectors as the fluid moves them, which incline ever more."""
    return cell + time * cell @ flow.gradient.T


# --- the lattice ----------------------------------------------------------------------------------


@each_shear
def test_the_lattice_moves_with_the_fluid(cell, flow):
    """The basis is another one, with whole numbers and the same volume, and hardly inclined."""
    fluid = sheared(cell, flow)
    least = fluid.narrowest_boundary.heights.min()
    seen = []
    for time in np.linspace(-9.0, 9.0, 301):
        box = fluid.boundary_at(time)
        basis = box.vectors @ np.linalg.inv(moved(cell, flow, time))
        np.testing.assert_allclose(basis, np.rint(basis), atol=1e-13)
        assert np.linalg.det(basis) == pytest.approx(1.0, abs=1e-12)
        seen.append(box.heights.min())
    assert least - 1e-12 < min(seen) < 1.02 * least
    np.testing.assert_allclose(fluid.boundary_at(0.0).vectors, cell, atol=1e-15)


def test_a_strain_of_one_box_brings_the_lattice_back():
    fluid = sheared(CUBE, mrs.flows.shear(RATE))
    for periods in (1.0, 7.0):
        there = fluid.boundary_at(periods / RATE).vectors
        np.testing.assert_allclose(there, CUBE, atol=1e-14)
    np.testing.assert_allclose(fluid.boundary_at(0.25 / RATE).vectors[2], [0.75, 0.0, 3.0])


def test_flows_that_draw_boxes_out_are_refused():
    turning = mrs.flows.QuadraticFlow([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    for flow in (mrs.flows.extension(1.0), mrs.flows.shear(1.0, (1, 1, 0)), turning):
        with pytest.raises(ValueError, match=r"^background must be a shear along one of the latt"):
            sheared(INCLINED, flow)


def test_other_boundaries_and_flows_stay():
    uniform = mrs.flows.QuadraticFlow(constant=[1.0, 0.0, 0.0])
    for fluid in (sheared(CUBE, uniform), mrs.Fluid(background=mrs.flows.shear(1.0))):
        assert fluid.boundary_at(0.4) is fluid.boundary is fluid.narrowest_boundary


# --- bodies ---------------------------------------------------------------------------------------


@each_shear
def test_motion_is_that_in_the_box_as_it_is_now(cell, flow):
    """Contacts, motion and velocity, beside those in a box at rest with the vectors as they move.

    The background is added to them; rounding of bonds of length 0.15 is 1e-13 of what they carry.
    """
    time, rng = 0.63 / RATE, np.random.default_rng(6)
    x, p = rng.random((40, 3)) @ cell, rng.standard_normal((40, 3))
    crowd = mrs.Swimmers(x, p, length=0.7, force=1.0, epsilon=0.2, name="crowd")
    of_both = {"bodies": [*bodies(cell), crowd], "forces": [CONTACT], "backend": EXACT}
    sim = mrs.Simulation(sheared(cell, flow), **of_both)
    at_rest = mrs.Fluid(0.7, boundary=mrs.Periodic(moved(cell, flow, time)))
    other = mrs.Simulation(at_rest, **of_both)
    before = sim.now  # the sums have been chosen in another box
    now, still = sim.scene.evaluate(time, sim.state), other.now
    size = np.abs(still.loads).max()
    np.testing.assert_allclose(now.loads, still.loads, atol=1e-12 * size)
    assert np.abs(before.loads - still.loads).max() > 0.01 * size
    u, size = still.motion[:, :3], np.abs(still.motion[:, :3]).max()
    background = flow.velocity(now.points, time)
    np.testing.assert_allclose(now.motion[:, :3] - background, u, atol=1e-12 * size)
    targets = rng.uniform(-4.0, 4.0, (7, 3))
    velocity = sim.scene.velocity(targets, now) - flow.velocity(targets, time)
    np.testing.assert_allclose(velocity, other.velocity(targets), atol=1e-12 * size)


def test_images_of_bodies_move_apart_as_the_lattice_does():
    """Two boxes of a lattice, one above the other, are one of twice the height with twice as much.

    Its basis changes at other times. What is in the second box moves as in the first, and away
    from it by G a t; rounding is that of positions, through contacts.
    """
    flow, t = mrs.flows.shear(RATE), 1.5
    rng = np.random.default_rng(4)
    x, p = rng.random((5, 3)) @ CUBE, rng.standard_normal((5, 3))

    def run(cell, copies):
        places = np.concatenate([x + k * CUBE[2] for k in range(copies)])
        along = np.tile(p, (copies, 1))
        swimmers = mrs.Swimmers(places, along, length=0.7, force=3.0, epsilon=0.1)
        options = {"backend": EXACT, "integrator": mrs.Integrator("rk4", dt=0.25)}
        sim = mrs.Simulation(sheared(cell, flow), [swimmers], forces=[CONTACT], **options)
        return sim.run(t).state.positions.reshape(copies, len(x), -1, 3)

    (one,) = run(CUBE, 1)
    lower, upper = run(np.diag([3.0, 3.0, 6.0]), 2)
    np.testing.assert_allclose(lower, one, atol=1e-11)
    np.testing.assert_allclose(upper - lower, one * 0 + moved(CUBE, flow, t)[2], atol=1e-11)
    assert RATE * t > 1.0  # strain: both bases have changed
    drift = one[:, 0] - x
    assert np.abs(drift[:, 2]).max() > 0.1  # they are no part of the flow alone


@pytest.mark.parametrize("axes", ["xyz", "xy"])
def test_springs_join_images_that_move(axes):
    """A spring to the next box is one to the image of a body there, which moves with the flow."""
    flow = mrs.flows.shear(RATE, gradient=(0.0, 1.0, 0.0))
    fluid = mrs.Fluid(boundary=mrs.Periodic(CUBE[: len(axes)], axes), background=flow)
    spring = mrs.Springs([("swimmers", 0)], [("swimmers", 1)], stiffness=2.0)
    x, p = np.array([[0.2, 0.1, 0.1], [0.5, 2.9, 0.4]]), np.array([[0, 0, 1.0], [0, 0, 1.0]])
    t, forces = 0.9 / RATE, []
    for image in (0.0, 1.0):
        away = image * np.array([[0.0, 0.0, 0.0], CUBE[1]])
        swimmers = mrs.Swimmers(x - away, p, length=0.3, force=1.0, epsilon=0.1)
        layout = mrs.Simulation(fluid, [swimmers], forces=[spring]).scene.layout
        points = layout.initial_points - np.tile(t * away @ flow.gradient.T, (2, 1))
        forces.append(spring.forces(t, points, layout, fluid))
    step = x[1] - x[0] - moved(CUBE, flow, t)[1]
    extension = np.linalg.norm(step) - np.linalg.norm(x[1] - x[0] - CUBE[1])
    np.testing.assert_allclose(forces[1], forces[0], atol=1e-14)
    expected = 2.0 * extension * step / np.linalg.norm(step)
    np.testing.assert_allclose(forces[0][:2], [expected, -expected], atol=1e-14)


def test_contacts_need_room_in_the_box_at_its_lowest():
    """A cube of edge 1.25 has room for a reach of 0.6, but not when it is inclined by a half."""
    swimmers = mrs.Swimmers([[0.1, 0.1, 0.1]], [[0, 0, 1]], length=0.3, force=1.0, epsilon=0.1)
    cell = (1.25, 1.25, 1.25)
    rk4 = {"integrator": mrs.Integrator("rk4", dt=0.01), "forces": [CONTACT]}
    mrs.Simulation(mrs.Fluid(boundary=mrs.Periodic(cell)), [swimmers], **rk4).run(0.01)
    sim = mrs.Simulation(sheared(cell, mrs.flows.shear(1.0)), [swimmers], **rk4)
    with pytest.raises(ValueError, match=r"^radius must be small .* up to 0.6, .* only 1.118"):
        sim.run(0.01)


# --- files ----------------------------------------------------------------------------------------

FLOW = mrs.flows.shear(2.0 * RATE)


def simulation(path):
    swimmers, _, tracers = bodies(CUBE)
    columns = {"g": obs.PairDistribution("swimmers", [0.0, 0.6, 1.2])}
    options = {
        "forces": [CONTACT],
        "output": mrs.Output(path, 0.125, columns=columns),
        "backend": mrs.Backend(tolerance=1e-6),
        "integrator": mrs.Integrator("rk4", dt=0.0625),
    }
    return mrs.Simulation(sheared(CUBE, FLOW), [swimmers, tracers], **options)


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    """A run to a strain of 1."""
    path = tmp_path_factory.mktemp("run") / "sheared"
    return path, simulation(path).run(0.625)


def test_frames_are_in_the_box_of_their_time(stored):
    path, sim = stored
    for body in sim.bodies:
        found = obs.tracks(path, body.name)
        for time, cell in zip(found.times, found.cell, strict=True):
            np.testing.assert_array_equal(cell, sim.fluid.boundary_at(time).vectors)
        np.testing.assert_allclose(found.positions[-1], sim.body_state(body).positions, atol=1e-13)
        with Trajectory(path / f"{body.name}.vtkhdf") as file:
            for i, cell in enumerate(found.cell):
                places = file.points(i) @ np.linalg.inv(cell)
                for line in body.topology()[1] or np.arange(len(places))[:, None]:
                    middle = places[np.unique(line)].mean(axis=0)
                    assert ((middle > -1e-12) & (middle < 1.0 + 1e-12)).all()


def test_velocity_of_a_stored_frame(stored):
    """Frames have forces in singles, so 1e-6; and sums have the tolerance 1e-6."""
    path, sim = stored
    targets = np.random.default_rng(4).random((9, 3)) @ CUBE
    expected = sim.velocity(targets)
    for given in ({}, {"background": FLOW, "boundary": mrs.Periodic(CUBE)}):
        _, velocity = mrs.frame_velocity(path, **given)
        np.testing.assert_allclose(
            velocity(targets), expected, atol=5e-6 * np.abs(expected - 1.0).max()
        )


def test_columns_take_the_cell_of_their_time(stored):
    path, _ = stored
    found = obs.tracks(path, "swimmers")
    with (path / "log.csv").open() as file:
        rows = list(csv.DictReader(file))
    for row, x, cell in zip(rows, found.positions, found.cell, strict=True):
        g = obs.pair_distribution(x, [0.0, 0.6, 1.2], cell)
        np.testing.assert_allclose([float(row["g[0.3]"]), float(row["g[0.9]"])], g, rtol=1e-6)
    columns = {"g": obs.PairDistribution("swimmers", [0.0, 1.5])}
    output = mrs.Output(path / "new", 1.0, columns=columns)
    with pytest.raises(ValueError, match=r"columns\['g'\]: bins must end within half .*1\.34"):
        mrs.Simulation(sheared(CUBE, FLOW), bodies(CUBE), output=output)


def test_a_resumed_run_has_the_same_bits(stored, tmp_path):
    """Stopped at a strain of 0.4, before lattice vectors are changed for others."""
    path, _ = stored
    stopped = tmp_path / "stopped"
    simulation(stopped).run(0.25)
    mrs.restart(simulation(stopped)).run(0.625)
    assert_equal_runs(path, stopped)
