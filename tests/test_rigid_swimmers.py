"""Rigid bodies that swim, are dragged and fall: against dense systems, theorems and formulas."""

import meshio
import numpy as np
import pytest
import pyvista
import scipy

import mrs
from mrs.run import scenario_files
from tests.cases import rigid_oracle

EXACT = mrs.Backend("direct", precision="float64", tolerance=1e-11)
SMALL = {"head_points": 40, "turns": 1.0, "thickness": 0.15, "viscosity": 1.0, "rate": 1.0}
STILL = scipy.spatial.transform.Rotation.identity()
TURN = scipy.spatial.transform.Rotation.from_rotvec([0.4, -1.1, 0.7])


def bacterium(**options):
    """Return a simulation of a small head with a flagellum that turns against it."""
    return scenario_files.make("helical_swimmer_with_head", SMALL | options).build(backend=EXACT)


# Swimmers


def test_swimming_is_that_of_the_dense_system():
    """Speed and angular velocity of a head with a rigid flagellum."""
    sim = bacterium()
    (body,) = sim.bodies
    points = body.shape.points(0.0)
    on_tail = (np.arange(len(points)) >= SMALL["head_points"])[:, None]
    slip = on_tail * np.cross([0.0, 0.0, 2.0 * np.pi], points)
    whole = [(np.arange(len(points)), np.zeros(3))]
    forces, motion = rigid_oracle.solve(
        points, body.epsilons(0.0), whole, slip, [0], {0: np.zeros(6)}
    )
    assert motion[0][2] > 0.01  # it swims along z
    np.testing.assert_allclose(sim.now.rates.ravel(), motion[0], rtol=1e-8, atol=1e-9)
    scale = np.abs(forces).max()
    np.testing.assert_allclose(sim.now.loads, forces, rtol=0, atol=1e-8 * scale)


class Nets(mrs.Tracker):
    """Net forces and torques on the fluid after each step, and the largest force at a point."""

    def initialize(self, sim):
        self.net, self.largest = [], []

    def handle(self, sim):
        points, force, torque = sim.now.points, sim.now.loads[:, :3], sim.now.loads[:, 3:]
        turning = np.cross(points, force).sum(axis=0)
        self.net.append(
            np.r_[force.sum(axis=0), turning + (torque.sum(axis=0) if torque.size else 0)]
        )
        self.largest.append(np.abs(force).max())


@pytest.mark.parametrize("flagellum", ["rigid", "elastic"])
def test_swimmers_are_free_of_force_and_torque_at_every_step(flagellum):
    options = SMALL | {"flagellum": flagellum, "bending": 0.5, "shearing": 10.0}
    nets, steps = Nets(), mrs.Integrator(tolerance=1e-3)
    scene = scenario_files.make("helical_swimmer_with_head", options)
    scene.build(backend=EXACT, integrator=steps, trackers=[nets]).run(0.03)
    assert len(nets.net) >= 3
    assert min(nets.largest) > 0.1
    assert np.abs(nets.net).max() < 1e-10


def test_swimming_does_not_depend_on_the_frame():
    """What starts turned and elsewhere makes the same way, turned."""
    (body,), start = bacterium().bodies, np.array([3.0, -1.0, 2.0])
    rates, ways = [], []
    for rotation, shift in ((STILL, np.zeros(3)), (TURN, start)):
        there = mrs.Rigid(body.shape, positions=[shift], orientations=[rotation.as_quat()])
        steps = mrs.Integrator("rk4", dt=0.05)
        sim = mrs.Simulation(mrs.Fluid(), [there], backend=EXACT, integrator=steps)
        rates.append(rotation.inv().apply(sim.now.rates))
        ways.append(rotation.inv().apply(sim.run(0.1).state.positions - shift))
    np.testing.assert_allclose(rates[1], rates[0], rtol=0, atol=1e-9 * np.abs(rates[0]).max())
    assert np.linalg.norm(ways[0]) > 1e-3
    np.testing.assert_allclose(ways[1], ways[0], rtol=0, atol=1e-9)


def test_viscosity_drops_out():
    """It multiplies the forces, and not the motion."""
    thin, thick = bacterium(viscosity=1.0), bacterium(viscosity=40.0)
    np.testing.assert_allclose(thick.now.rates, thin.now.rates, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(thick.now.loads, 40.0 * thin.now.loads, rtol=0, atol=1e-6)


def test_swimming_is_what_the_reciprocal_theorem_says():
    """F U + L W = -sum of f w, with the forces f of the body dragged at F, L (Stone & Samuel 1996).

    It holds for a mobility that is symmetric: all blobs have one size.
    """
    (body,) = bacterium().bodies
    shape, epsilon = body.shape, 0.25
    swimming = mrs.Simulation(
        mrs.Fluid(), [mrs.Rigid(shape, epsilon=epsilon)], backend=EXACT
    ).now.rates.ravel()
    slip = shape.velocities(0.0)
    drag = mrs.Rigid(shape.surface, epsilon=epsilon)
    matrix = mrs.resistance(drag, mrs.Fluid(), backend=EXACT)
    for k, unit in enumerate(np.eye(6)):
        drive = mrs.Drive(velocity=unit[:3], angular_velocity=unit[3:])
        dragged = mrs.Rigid(shape.surface, epsilon=epsilon, motion=drive)
        forces = mrs.Simulation(mrs.Fluid(), [dragged], backend=EXACT).now.loads
        assert matrix[k] @ swimming == pytest.approx(-np.vdot(forces, slip), rel=1e-8, abs=1e-8)


def hinged(angles):
    """Return a shape of arms of length 1 in a plane; `angles` are those of the joints, in time."""
    middles = (np.arange(5) + 0.5) / 5

    def points(time):
        direction, start, arms = 0.0, np.zeros(2), []
        for angle in (0.0, *angles(2.0 * np.pi * time)):
            direction += angle
            along = np.array([np.cos(direction), np.sin(direction)])
            arms.append(start + middles[:, None] * along)
            start = start + along
        return np.insert(np.concatenate(arms), 2, 0.0, axis=1)

    return mrs.Moving(points, period=1.0, epsilon=0.2)


def way_in_a_period(angles, steps):
    """Return how far a body with joints gets."""
    body = mrs.Prescribed(hinged(angles), motion="free")
    rk4 = mrs.Integrator("rk4", dt=1.0 / steps)
    sim = mrs.Simulation(mrs.Fluid(), [body], backend=EXACT, integrator=rk4)
    return np.linalg.norm(sim.run(1.0).state.positions[0])


def test_a_scallop_does_not_swim():
    """One hinge opens and closes: what remains is the error of the steps, of fourth order."""

    def scallop(phase):
        return (1.2 + 0.8 * np.cos(phase) + 0.4 * np.sin(2.0 * phase),)

    coarse, fine = (way_in_a_period(scallop, steps) for steps in (8, 16))
    assert fine < 1e-3
    assert np.log2(coarse / fine) > 3.5


def test_two_hinges_swim():
    """Purcell's swimmer, whose stroke is another one backwards."""

    def purcell(phase):
        return 0.8 * np.cos(phase), 0.8 * np.sin(phase)

    coarse, fine = (way_in_a_period(purcell, steps) for steps in (8, 16))
    assert fine > 0.01
    assert coarse == pytest.approx(fine, rel=0.05)


# Dragged bodies


def test_resistance_of_two_unequal_bodies_is_symmetric():
    """Lorentz: F1 U2 + L1 W2 is the same with 1 and 2 exchanged."""
    ellipsoid = mrs.Rigid(
        mrs.surfaces.ellipsoid((1.0, 0.8, 0.5), 60),
        epsilon=0.2,
        orientations=[TURN.as_quat()],
        name="ellipsoid",
    )
    helix = mrs.Rigid(
        mrs.surfaces.helix(0.4, 1.5, 2.0, 0.12), epsilon=0.2, positions=[[1.8, 0, 0]], name="helix"
    )
    matrix = mrs.resistance([ellipsoid, helix], mrs.Fluid(), backend=mrs.Backend(tolerance=1e-8))
    across = matrix[:6, 6:]
    np.testing.assert_allclose(across, matrix[6:, :6].T, rtol=0, atol=1e-6 * np.abs(across).max())
    np.testing.assert_allclose(matrix, matrix.T, rtol=0, atol=1e-6 * np.abs(matrix).max())
    assert np.linalg.eigvalsh(matrix).min() > 0.0


def stimson_and_jeffery(distance):
    """Return the drag of one of two spheres of radius 1 that follow each other, over its own.

    M. Stimson & G. B. Jeffery, Proc. R. Soc. A 111, 110 (1926).
    """
    alpha, n = np.arccosh(0.5 * distance), np.arange(1, 60)
    above = 4.0 * np.sinh((n + 0.5) * alpha) ** 2 - ((2 * n + 1) * np.sinh(alpha)) ** 2
    below = 2.0 * np.sinh((2 * n + 1) * alpha) + (2 * n + 1) * np.sinh(2.0 * alpha)
    weights = n * (n + 1) / ((2 * n - 1) * (2 * n + 3))
    return 4.0 / 3.0 * np.sinh(alpha) * (weights * (1.0 - above / below)).sum()


@pytest.mark.parametrize(("distance", "printed"), [(4.0, 0.7423), (6.0, 0.8047), (10.0, 0.8706)])
def test_formula_of_two_spheres(distance, printed):
    assert stimson_and_jeffery(distance) == pytest.approx(printed, abs=5e-5)


def test_two_spheres_tend_to_stimson_and_jeffery():
    errors = []
    for count in (40, 160):
        pair = mrs.Rigid(mrs.surfaces.sphere(1.0, count), positions=[[0, 0, 0], [0, 0, 4.0]])
        matrix = mrs.resistance(pair, mrs.Fluid())
        alone = mrs.resistance(mrs.Rigid(mrs.surfaces.sphere(1.0, count)), mrs.Fluid())[2, 2]
        errors.append((matrix[2, 2] + matrix[2, 8]) / alone / stimson_and_jeffery(4.0) - 1.0)
    assert abs(errors[0]) < 0.02
    assert abs(errors[1]) < 0.6 * abs(errors[0])


def oberbeck(semi_axes):
    """Return resistances of an ellipsoid along and about its axes, (6,), viscosity 1.

    Oberbeck (1876), Edwardes (1892), Perrin (1934), by elliptic integrals in Carlson's form.
    """
    a = np.square(semi_axes)
    chi = 2.0 * scipy.special.elliprf(*a)
    alpha = np.array([2.0 / 3.0 * scipy.special.elliprd(*np.delete(a, i), a[i]) for i in range(3)])
    product = a * alpha
    along = 16.0 * np.pi / (chi + product)
    about = 16.0 * np.pi / 3.0 * (a.sum() - a) / (product.sum() - product)
    return np.concatenate([along, about])


def test_formula_of_ellipsoids():
    """A sphere has Stokes' resistances, a disc 32/3, 32/3 and 16, and 32/3 about each axis."""
    pi = np.pi
    np.testing.assert_allclose(oberbeck((1, 1, 1)), [6 * pi] * 3 + [8 * pi] * 3, rtol=1e-12)
    disc = [32 / 3, 32 / 3, 16, 32 / 3, 32 / 3, 32 / 3]
    np.testing.assert_allclose(oberbeck((1, 1, 1e-9)), disc, rtol=1e-8)


def errors_of_resistances(make, semi_axes):
    """Return relative errors of all six, along and about the axes, with 50 and 200 points."""
    matrices = (mrs.resistance(mrs.Rigid(make(count)), mrs.Fluid()) for count in (50, 200))
    return np.array([np.diag(matrix) / oberbeck(semi_axes) - 1.0 for matrix in matrices])


@pytest.mark.parametrize(
    "semi_axes",
    [(0.4, 0.4, 1.0), (1.0, 1.0, 0.4), (1.0, 0.8, 0.5)],
    ids=["prolate", "oblate", "triaxial"],
)
def test_resistances_tend_to_those_of_ellipsoids(semi_axes):
    """The errors are of first order or better in the size of the blobs, which is halved."""
    coarse, fine = errors_of_resistances(lambda n: mrs.surfaces.ellipsoid(semi_axes, n), semi_axes)
    assert np.abs(fine).max() < 0.05
    assert (np.abs(fine) < 0.65 * np.abs(coarse)).all()


def test_resistances_of_a_disc():
    """16 across, 32/3 along: forces are infinite at the rim, which blobs make smooth.

    Along the disc the errors of rim and thickness cancel but for 1 %.
    """
    coarse, fine = errors_of_resistances(lambda n: mrs.surfaces.disc(1.0, n), (1.0, 1.0, 1e-9))
    assert abs(fine[2]) < 0.65 * abs(coarse[2]) < 0.1
    np.testing.assert_allclose(fine[:2], 0.0, atol=0.01)


def test_three_falling_spheres_keep_their_symmetry():
    """At the corners of a horizontal triangle; also their points are the same, turned."""
    thirds = scipy.spatial.transform.Rotation.from_rotvec(
        2.0 * np.pi / 3.0 * np.outer(range(3), [0.0, 0.0, 1.0])
    )
    balls = mrs.Rigid(
        mrs.surfaces.sphere(1.0, 30),
        positions=thirds.apply([2.0, 0.0, 0.0]),
        orientations=thirds.as_quat(),
        force=(0.0, 0.0, -6.0 * np.pi),
    )
    sim = mrs.Simulation(mrs.Fluid(), [balls], backend=EXACT).run(3.0)
    positions = sim.state.positions
    assert (positions[:, 2] < -3.0).all()  # faster than alone
    np.testing.assert_allclose(positions, thirds.apply(positions[0]), rtol=0, atol=1e-9)


# A surface from a file


@pytest.fixture
def ball_file(tmp_path):
    """A .stl of a sphere of radius 1 with 120 corners."""
    corners = mrs.surfaces.sphere(1.0, 120).points
    triangles = scipy.spatial.ConvexHull(corners).simplices
    meshio.write(tmp_path / "ball.stl", meshio.Mesh(corners, [("triangle", triangles)]))
    return tmp_path / "ball.stl"


def test_head_from_a_file(ball_file):
    """Its drag is that of the sphere; with a flagellum it swims as the sphere does."""
    read, sphere = mrs.surfaces.read(ball_file), mrs.surfaces.sphere(1.0, 120)
    assert len(read.points) == 120
    drag = mrs.resistance(mrs.Rigid(read), mrs.Fluid())[2, 2]
    assert drag == pytest.approx(6.0 * np.pi, rel=0.02)
    tail = mrs.surfaces.helix(0.3, 2.0, 2.0, 0.15).moved((0.0, 0.0, -3.1))
    speeds = [
        mrs.Simulation(mrs.Fluid(), [mrs.Rigid(mrs.Turning(head, tail, rate=1.0))]).now.rates[0, 2]
        for head in (read, sphere)
    ]
    assert speeds[0] > 1e-3
    assert speeds[0] == pytest.approx(speeds[1], rel=0.01)


def test_scenario_with_a_surface_from_a_file(ball_file):
    scene = scenario_files.make("dragged_bodies", {"surface": str(ball_file)}, quick=True)
    result = scene.check(scene.simulation())
    assert result.passed, str(result)


def test_a_file_that_meshio_ends_the_program_for(tmp_path):
    """A legacy .vtk of polygons, as pyvista writes them: an error that a script can catch."""
    path = tmp_path / "ball.vtk"
    pyvista.Sphere().save(path)
    with pytest.raises(ValueError, match=r"^path must be a file that meshio reads, .*ball\.vtk"):
        mrs.surfaces.read(path)
    with pytest.raises(FileNotFoundError, match="path: there is no file"):
        mrs.surfaces.read(tmp_path / "none.stl")
