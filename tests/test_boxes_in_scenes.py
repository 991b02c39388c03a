"""Scenes in a periodic box: contacts with images, images that move alike, and the files of runs."""

import csv
import itertools

import numpy as np
import pytest

import mrs
from mrs import observables as obs
from mrs.output.trajectory import Trajectory
from mrs.run import cli, scenario_files
from tests.cases.ewald_oracle import lattice_sum
from tests.test_runs import assert_equal_runs

CUBE = 3.0 * np.eye(3)
SHEARED = np.array([[3.0, 0.0, 0.0], [1.2, 2.8, 0.0], [-0.5, 0.7, 2.6]])
each_cell = pytest.mark.parametrize("cell", [CUBE, SHEARED], ids=["cube", "sheared"])
CONTACT = mrs.Steric(2.0, 0.2, chi=1.5)  # reaches 0.6
EXACT = mrs.Backend("direct", precision="float64")
AT_HOME = np.zeros((13, 3))


def lattice(count, cell, seed=7):
    """Return random lattice vectors, (count, 3)."""
    return np.random.default_rng(seed).integers(-4, 5, (count, 3)) @ cell


def bodies(cell, shifts=AT_HOME):
    """Return swimmers, rods and tracers that fill a cell, each moved by a row of `shifts`.

    The straight rod passes over the image of the ring.
    """
    rng = np.random.default_rng(3)
    x, p = rng.random((6, 3)) @ cell, rng.standard_normal((6, 3))
    swimmers = mrs.Swimmers(x + shifts[:6], p, length=0.7, force=1.0, epsilon=0.1)
    moduli = {"bending": 0.1, "twisting": 0.1, "shearing": 1.0, "stretching": 1.0}
    shapes = [
        mrs.geometry.straight(0.9, 7, origin=(2.6, 1.0, 1.3), direction=(1.0, 0.0, 0.2)),
        mrs.geometry.ring(0.4, 9, twist=1.0, origin=(0.1, 1.0, 1.0)),
    ]
    lines = [line.moved(shift) for line, shift in zip(shapes, shifts[6:8], strict=True)]
    rods = mrs.Rods(lines, intrinsic_curvature=(0.5, 0.2, 0.0), **moduli, epsilon=0.2, name="rods")
    return [swimmers, rods, mrs.Tracers(rng.random((5, 3)) @ cell + shifts[8:])]


def scene(cell, shifts=AT_HOME, **options):
    fluid = mrs.Fluid(0.7, boundary=mrs.Periodic(cell))
    options = {"backend": EXACT, "forces": [CONTACT]} | options
    return mrs.Simulation(fluid, bodies(cell, shifts), **options)


def flow_of(cell):
    """Return a background of sines that a lattice repeats."""
    phase = 2.0 * np.pi * np.linalg.inv(cell)[:, 0]
    across = np.cross(phase, [0.0, 0.0, 1.0])
    return mrs.flows.UserFlow(lambda x, t: np.sin(x @ phase)[:, None] * across)


# --- contacts -------------------------------------------------------------------------------------


def contacts(points, layout, cell):
    """Return the forces of `CONTACT`, pair by pair, over the 27 images about the nearest."""
    pieces, places, rounds = layout.contact_labels
    forces = np.zeros_like(points)
    boxes = np.array(list(itertools.product((-1, 0, 1), repeat=3)))
    for i, j in itertools.permutations(range(len(points)), 2):
        from_j = points[i] - points[j]
        nearest = -np.round(from_j @ np.linalg.inv(cell)).astype(int)
        along = abs(places[i] - places[j])
        joined = pieces[i] == pieces[j] and min(along, rounds[i] - along) <= 0.6
        for box in nearest + boxes:
            d = from_j + box @ cell
            if d @ d < 0.36 and not (joined and not box.any()):
                forces[i] += 2.0 / 0.4 * ((0.36 - d @ d) / (0.36 - 0.16)) ** 4 * d
    return forces


@each_cell
def test_contacts_are_those_of_27_images(cell):
    sim = scene(cell, lattice(13, cell))
    layout = sim.scene.layout
    points = sim.now.points[layout.forced]
    forces = CONTACT.forces(0.0, points, layout, sim.fluid)
    expected = contacts(points, layout, cell)
    free = CONTACT.forces(0.0, bodies_at_home(cell, layout), layout, mrs.Fluid())
    size = np.abs(expected).max()
    assert np.abs(expected - free).max() > 0.1 * size  # images touch
    np.testing.assert_allclose(forces, expected, atol=1e-11 * size)
    np.testing.assert_allclose(forces.sum(axis=0), 0.0, atol=1e-13 * size * len(points))


def bodies_at_home(cell, layout):
    return scene(cell).now.points[layout.forced]


def test_a_swimmer_touches_its_own_image():
    """Its particles are 2.7 apart, and 0.3 from each other's image."""
    swimmer = mrs.Swimmers([[0.0, 0.0, 0.0]], [[1.0, 0.0, 0.0]], length=2.7, force=1.0, epsilon=0.1)
    sim = mrs.Simulation(mrs.Fluid(boundary=mrs.Periodic(CUBE)), [swimmer])
    forces = CONTACT.forces(0.0, sim.now.points, sim.scene.layout, sim.fluid)
    push = 2.0 / 0.4 * ((0.36 - 0.09) / 0.2) ** 4 * 0.3
    np.testing.assert_allclose(forces, [[-push, 0, 0], [push, 0, 0]], atol=1e-13 * push)


def test_a_box_too_small_for_contacts_is_refused():
    sim = scene(np.diag([3.0, 3.0, 1.1]))
    with pytest.raises(ValueError, match=r"^radius must be small .* up to 0.6, .* only 1.1 high"):
        sim.run(0.1)


# --- images ---------------------------------------------------------------------------------------


@each_cell
def test_each_body_may_be_in_any_image_of_the_box(cell):
    """Rounding of places some boxes away is 1e-15; bonds of length 0.15 turn it into 1e-13."""
    here, there = scene(cell).now, scene(cell, lattice(13, cell)).now
    assert np.abs(there.points - here.points).max() > 5.0
    for name in ("loads", "motion", "rates"):
        values = getattr(here, name)
        np.testing.assert_allclose(
            getattr(there, name), values, atol=1e-11 * np.abs(values).max(), err_msg=name
        )


def test_velocity_is_the_same_in_every_box():
    sim = scene(SHEARED)
    points = np.random.default_rng(1).random((9, 3)) @ SHEARED
    velocity = sim.velocity(points)
    moved = sim.velocity(points + lattice(9, SHEARED))
    np.testing.assert_allclose(moved, velocity, atol=1e-12 * np.abs(velocity).max())


def test_images_hold_a_lone_swimmer_back():
    """Its speed differs from that in free space as in the lattice sum, and by (length / L)^3.

    The uniform part of order 1 / L of what images do is the same at body and flagellum, and cancels
    as their forces do.
    """

    def speed(boundary):
        swimmer = mrs.Swimmers([[0.3, 0, 0]], [[0, 0, 1.0]], length=0.5, force=1.0, epsilon=0.1)
        sim = mrs.Simulation(mrs.Fluid(boundary=boundary), [swimmer], backend=EXACT)
        return sim.now.motion[0, 2]

    alone = speed(mrs.Fluid().boundary)
    change = {}
    for size in (3.0, 6.0):
        change[size] = speed(mrs.Periodic((size,) * 3)) - alone
        points = np.array([[0.3, 0.0, 0.0], [0.3, 0.0, -0.5]])
        forces = np.array([[0, 0, 1.0, 0, 0, 0], [0, 0, -1.0, 0, 0, 0]])
        cell = size * np.eye(3)
        (exact,) = lattice_sum(0.1, cell, points, forces, points[:1], 9.0 * size, 1.6 * size)
        assert alone + change[size] == pytest.approx(exact[2], rel=1e-9)
    assert np.log2(change[3.0] / change[6.0]) == pytest.approx(3.0, abs=0.1)


# --- backgrounds ----------------------------------------------------------------------------------


def test_backgrounds_must_be_periodic():
    for flow in (mrs.flows.poiseuille(1.0, 2.0), flow_of(CUBE)):
        with pytest.raises(ValueError, match=r"^background must be the same in each box of Per"):
            mrs.Fluid(boundary=mrs.Periodic(SHEARED), background=flow)
    flow = flow_of(SHEARED)
    fluid = mrs.Fluid(boundary=mrs.Periodic(SHEARED), background=flow)
    points = np.random.default_rng(5).uniform(-9.0, 9.0, (8, 3))
    moved = mrs.Simulation(fluid, [mrs.Tracers(points)]).now.motion
    np.testing.assert_allclose(moved, flow.velocity(points, 0.0), atol=1e-15)


def test_tracers_stay_uniform():
    """Stirred by swimmers, they leave their lattice, but not more of them are in some octant.

    Their numbers in the octants are those of random points: chi squared of 7 degrees of freedom is
    below 24.3 with a probability of 0.999.
    """
    rng = np.random.default_rng(2)
    x, p = rng.random((8, 3)) * 2.0, rng.standard_normal((8, 3))
    swimmers = mrs.Swimmers(x, p, length=0.5, force=60.0, epsilon=0.3)
    tracers = mrs.Tracers(mrs.geometry.grid((8, 8, 8), 0.25) + 1.0)
    fluid = mrs.Fluid(boundary=mrs.Periodic((2.0, 2.0, 2.0)))
    rk4 = mrs.Integrator("rk4", dt=0.05)
    sim = mrs.Simulation(fluid, [swimmers, tracers], integrator=rk4).run(1.0)
    now = sim.body_state(tracers).positions
    gone = np.sqrt(np.mean((now - tracers.positions) ** 2) * 3)
    assert gone > 3.0 * 0.25  # spacings of their lattice
    octant = np.floor(now % 2.0).astype(int) @ [1, 2, 4]
    counts = np.bincount(octant, minlength=8)
    assert np.sum((counts - 64.0) ** 2) / 64.0 < 24.3


# --- files ----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    """A run of bodies that are some boxes away from the first."""
    path = tmp_path_factory.mktemp("run") / "boxes"
    backend = mrs.Backend(tolerance=1e-6)
    output = mrs.Output(path, 0.01)
    sim = scene(SHEARED, lattice(13, SHEARED), output=output, backend=backend).run(0.02)
    return path, sim


def test_frames_have_each_line_whole_in_the_box(stored):
    path, sim = stored
    for body in sim.bodies:
        state = sim.now.points[sim.scene.layout.part(body).points]
        with Trajectory(path / f"{body.name}.vtkhdf") as file:
            points, image = file.points(-1), file.point_data(-1)["image"]
        assert np.abs(image).max() > 1
        np.testing.assert_allclose(points + image @ SHEARED, state, atol=1e-14 * 20)
        vertices, lines = body.topology()
        for line in [*lines, *([[i] for i in vertices] if not lines else [])]:
            assert np.ptp(image[line], axis=0).max() == 0
            middle = points[np.unique(line)].mean(axis=0) @ np.linalg.inv(SHEARED)
            assert ((middle > -1e-12) & (middle < 1.0 + 1e-12)).all()


def test_tracks_are_those_of_the_state(stored):
    path, sim = stored
    for body in sim.bodies:
        found = obs.tracks(path, body.name)
        np.testing.assert_array_equal(found.cell, SHEARED)
        start, end = found.positions[[0, -1]]
        np.testing.assert_allclose(start, body.positions, atol=1e-13)
        np.testing.assert_allclose(end, sim.body_state(body).positions, atol=1e-13)


def test_velocity_of_a_stored_frame(stored):
    """Frames have forces in singles, so 1e-6; and sums have the tolerance 1e-6."""
    path, sim = stored
    _, velocity = mrs.frame_velocity(path)
    targets = np.random.default_rng(4).random((9, 3)) @ SHEARED
    expected = sim.velocity(targets)
    size = np.abs(expected).max()
    np.testing.assert_allclose(velocity(targets), expected, atol=5e-6 * size)
    moved = velocity(targets + lattice(9, SHEARED))
    np.testing.assert_allclose(moved, expected, atol=5e-6 * size)


SUSPENSION = {"count": 8, "size": 3.0, "tracers": 5, "interval": 0.05}


@pytest.fixture(scope="module")
def suspension(tmp_path_factory):
    """A run of the scenario without a stop."""
    path = tmp_path_factory.mktemp("run") / "whole"
    scenario_files.make("swimmer_suspension", SUSPENSION | {"t_end": 0.15}).simulation(path).run(
        0.15
    )
    return path


def test_a_resumed_run_has_the_same_bits(suspension, tmp_path):
    """Stopped at 0.1, with bodies that have left the box."""
    path = tmp_path / "stopped"
    scenario = scenario_files.make("swimmer_suspension", SUSPENSION | {"t_end": 0.1})
    scenario.simulation(path).run(0.1)
    mrs.resume(path, 0.15)
    assert_equal_runs(suspension, path)


def test_columns_take_the_cell_of_the_fluid(suspension, tmp_path):
    """Those of the log are those of the files with their cell; bins beyond it are refused."""
    with (suspension / "log.csv").open() as file:
        rows = list(csv.DictReader(file))
    bins = [0.0, 0.5, 1.0, 1.5]
    times, positions, directions, cell = obs.tracks(suspension, "swimmers")
    for row, x, p in zip(rows, positions, directions, strict=True):
        found = obs.orientation_correlation(x, p, bins, cell)
        logged = [float(row[f"alignment[{label}]"]) for label in ("0.25", "0.75", "1.25")]
        np.testing.assert_allclose(logged, found, atol=1e-6)
    times, positions, _, _ = obs.tracks(suspension, "tracers")
    msd = obs.mean_square_displacement(times, positions)
    np.testing.assert_allclose(float(rows[-1]["tracers_msd"]), msd[-1], rtol=1e-12)
    output = mrs.Output(tmp_path, 0.1, columns={"g": obs.PairDistribution("swimmers", [0, 1.6])})
    with pytest.raises(ValueError, match=r"columns\['g'\]: bins must end within half .*1\.[0-9]+"):
        scene(SHEARED, output=output)


BOX = """
scenario = "scene"
[options]
t_end = 0.02
interval = 0.01
[options.fluid]
epsilon = 0.1
boundary = { kind = "periodic", cell = [5.0, 5.0, 5.0] }
[[options.swimmers]]
suspension = { kind = "random_suspension", count = 4, size = 5.0, spacing = 0.2, periodic = true }
length = 1.0
force = 1.0
[options.steric]
strength = 4.0
radius = 0.1
"""


def test_a_box_in_toml(tmp_path):
    (tmp_path / "box.toml").write_text(BOX)
    run = tmp_path / "run"
    assert cli.main(["run", str(tmp_path / "box.toml"), "--output", str(run)]) == 0
    np.testing.assert_array_equal(obs.tracks(run, "swimmers").cell, 5.0 * np.eye(3))
    assert cli.main(["resume", str(run), "--t-end", "0.03"]) == 0
    (tmp_path / "bad.toml").write_text(BOX.replace("[5.0, 5.0, 5.0]", "[5.0, 0.0, 5.0]"))
    scenario = scenario_files.make(*scenario_files.read_input(tmp_path / "bad.toml"))
    with pytest.raises(mrs.ScenarioError, match=r"^fluid: boundary: cell\[1\] must be .*got 0\.0$"):
        scenario.simulation()


def test_a_boundary_is_named_by_its_kind():
    """The message is about the kind that was asked for, and no other."""
    fluid = {"epsilon": 0.1, "boundary": {"kind": "wal"}}
    with pytest.raises(mrs.ScenarioError, match=r"^fluid\.boundary: .*'wall', 'periodic'"):
        scenario_files.make("scene", {"fluid": fluid})
    fluid["boundary"] = {"kind": "periodic", "size": 1.0}
    with pytest.raises(mrs.ScenarioError, match=r"^fluid\.boundary\.periodic\.cell: must be given"):
        scenario_files.make("scene", {"fluid": fluid})
