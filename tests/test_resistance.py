"""Points whose motion is given: forces against dense systems, conservation, resuming."""

import numpy as np
import pytest

import mrs
from mrs.fluid import ResistanceError
from tests.cases import rigid_oracle

EXACT = mrs.Backend("direct", precision="float64", tolerance=1e-11)
TURN = np.array([0.3, -0.5, 0.2, 0.7])


def ball(count=60, radius=1.0, **options):
    return mrs.Rigid(mrs.surfaces.sphere(radius, count), **options)


def test_free_and_dragged_bodies_as_a_dense_system():
    """One is dragged and one is free, with other blob sizes, in shear and beside a swimmer."""
    viscosity = 1.7
    dragged = ball(
        positions=[[0, 0, 0]],
        orientations=[TURN],
        motion=mrs.Drive(velocity=(0.3, 0, 1), angular_velocity=(0, 1, 0.5)),
        name="dragged",
    )
    free = mrs.Rigid(
        mrs.surfaces.ellipsoid((0.5, 0.5, 1.0), 50),
        positions=[[2.5, 0.3, 0.2]],
        force=(0.1, 0.2, -3),
        torque=(0, 1, 0.5),
        name="free",
    )
    swimmer = mrs.Swimmers([[0, 3, 0]], [[1, 0, 0]], length=1.0, force=2.0, epsilon=0.2)
    flow = mrs.flows.shear(0.7)
    fluid = mrs.Fluid(viscosity, background=flow)
    sim = mrs.Simulation(fluid, [dragged, swimmer, free], backend=EXACT)
    now = sim.now

    rows = np.r_[0:60, 62:112]
    points = now.points[rows]
    forces = np.array([[2.0, 0, 0], [-2.0, 0, 0]])
    there = np.concatenate([points, now.points[60:62]])
    matrix = rigid_oracle.stokeslets(there, np.full(112, 0.2), viscosity)
    others = (matrix[:-6, -6:] @ forces.ravel()).reshape(-1, 3) + flow.velocity(points, 0.0)
    given = np.zeros_like(points)
    given[:60] = np.cross([0, 1, 0.5], points[:60])
    given[:60] += [0.3, 0, 1]
    epsilons = np.r_[
        np.full(60, dragged.shape.surface.epsilon), np.full(50, free.shape.surface.epsilon)
    ]
    bodies = [(np.arange(60), np.zeros(3)), (np.arange(60, 110), np.array([2.5, 0.3, 0.2]))]
    load = {1: [0.1, 0.2, -3, 0, 1, 0.5]}
    expected, moved = rigid_oracle.solve(
        points, epsilons, bodies, given - others, [1], load, viscosity
    )
    scale = np.abs(expected).max()
    np.testing.assert_allclose(now.loads[rows, :3], expected, rtol=0, atol=1e-8 * scale)
    position, turning = now.rates[2], now.rates[5]  # dragged, swimmer, free: three of each
    np.testing.assert_allclose(position, moved[1][:3], rtol=1e-8)
    np.testing.assert_allclose(turning, moved[1][3:], rtol=1e-8)
    # The fluid moves with the points, which the sums over all points know nothing of.
    of_fluid = (rigid_oracle.stokeslets(points, epsilons, viscosity) @ expected.ravel()).reshape(
        -1, 3
    )
    np.testing.assert_allclose(now.motion[rows, :3], of_fluid + others, atol=1e-7)


@pytest.mark.parametrize(
    ("count", "force", "torque"),
    [(200, 1.00670, 1.03765), (400, 1.00431, 1.02649), (800, 1.00277, 1.01868)],
)
def test_sphere_has_the_resistance_of_its_points(count, force, torque):
    """Factors over Stokes' 6 pi mu a and 8 pi mu a^3 of physics.md 7; they tend to one."""
    matrix = mrs.resistance(ball(count, 2.0), mrs.Fluid(viscosity=0.5))
    drag, turning = matrix[2, 2], matrix[5, 5]  # along the axis of the spiral
    assert drag / (6 * np.pi * 0.5 * 2) == pytest.approx(force, abs=6e-6)
    assert turning / (8 * np.pi * 0.5 * 8) == pytest.approx(torque, abs=6e-6)


def test_rigid_helix():
    """Thrust, torque and drag of Rodenborn et al. (2013), program of regularized Stokeslets."""
    helix = mrs.surfaces.helix(1.0, 10.0, 30.8, 0.04, spacing=0.6)
    matrix = mrs.resistance(mrs.Rigid(helix), mrs.Fluid())
    thrust, torque, drag = -matrix[2, 5], matrix[5, 5], matrix[2, 2]
    np.testing.assert_allclose([thrust, torque, drag], [12.094, 90.80, 42.81], rtol=0.02)
    np.testing.assert_allclose(matrix, matrix.T, rtol=0, atol=1e-5 * torque)


def test_iterations_at_many_points():
    """Patches of a body are a good preconditioner for the whole."""
    sim = mrs.Simulation(
        mrs.Fluid(),
        [ball(2000, motion=mrs.Drive(velocity=(0, 0, 1)))],
        backend=mrs.Backend(tolerance=1e-6),
    )
    assert sim.now.loads[:, 2].sum() == pytest.approx(6 * np.pi * 1.0016, rel=1e-4)
    assert 1 <= sim.scene.resistance.memory.iterations <= 20


def test_many_bodies_take_few_iterations():
    places = mrs.geometry.grid((3, 3, 3), 4.0)
    balls = ball(40, positions=places, force=(0, 0, -1))
    sim = mrs.Simulation(mrs.Fluid(), [balls], backend=mrs.Backend(tolerance=1e-6))
    assert sim.now.loads[:, 2].sum() == pytest.approx(-27.0, rel=1e-13)
    assert 1 <= sim.scene.resistance.memory.iterations <= 12


def test_forces_between_bodies_act_on_the_whole_body():
    """Two balls in touch push each other; on the fluid the pushes are part of their net force."""
    near = ball(60, positions=[[0, 0, 0], [2.05, 0, 0]])
    steric = mrs.Steric(strength=1.0, radius=0.1)
    sim = mrs.Simulation(mrs.Fluid(), [near], forces=[steric], backend=EXACT)
    loads = sim.now.loads[:, :3].reshape(2, 60, 3).sum(axis=1)
    assert loads[0, 0] < -0.01
    np.testing.assert_allclose(loads[0], -loads[1], atol=1e-12)
    assert sim.now.rates[0, 0] < 0.0 < sim.now.rates[1, 0]


def test_elastic_flagellum_on_a_head_is_free_of_force_and_torque():
    head = ball(60, 0.5, name="head")
    line = mrs.geometry.helix(0.15, 1.0, 1.0, 21, origin=(-0.15, 0, 0.5))
    tail = mrs.Rods(
        line,
        bending=1.0,
        twisting=1.0,
        shearing=50.0,
        stretching=50.0,
        base=mrs.Mount("head", turning=(0, 0, 6.0)),
        epsilon=0.1,
    )
    sim = mrs.Simulation(
        mrs.Fluid(), [head, tail], backend=EXACT, integrator=mrs.Integrator(tolerance=1e-3)
    )
    for stop in (0.02, 0.04, 0.06):
        sim.run(stop)
        points, loads = sim.now.points, sim.now.loads
        net = loads[:, :3].sum(axis=0)
        torque = (np.cross(points, loads[:, :3]) + loads[:, 3:]).sum(axis=0)
        assert np.abs(loads).max() > 0.1
        assert max(np.abs(net).max(), np.abs(torque).max()) < 1e-10
    # The base stays where it was fixed, to the error of the steps, and has turned by 6 t.
    turn = sim.body_state(head).quaternions
    base = sim.body_state(tail).positions[:1] - sim.body_state(head).positions
    base = mrs.rotations.rotate(mrs.rotations.conjugate(turn), base)
    np.testing.assert_allclose(base, [[0, 0, 0.5]], atol=1e-4)
    own = mrs.rotations.relative(turn, sim.body_state(tail).quaternions[:1])
    start = mrs.rotations.relative(head.quaternions, tail.quaternions[:1])
    about = mrs.rotations.multiply(own, mrs.rotations.conjugate(start))
    assert 2 * np.arcsin(np.linalg.norm(about[0, :3])) == pytest.approx(0.36, abs=1e-3)


def wagging(time):
    """Return a line whose end goes to and fro."""
    s = np.linspace(0.0, 1.0, 12)
    return np.column_stack([0.3 * s**2 * np.sin(2 * np.pi * time), 0 * s, s])


def scene(motion="free"):
    shape = mrs.Moving(wagging, period=1.0, epsilon=0.08)
    tail = mrs.Prescribed(shape, motion=motion, delay=0.1)
    others = ball(30, 0.3, positions=[[1, 0, 0], [1, 1, 0.5]], force=(0, 0, -0.5), name="balls")
    tracers = mrs.Tracers([[0.5, 0.5, 0.5]])
    return mrs.Simulation(
        mrs.Fluid(), [tail, others, tracers], integrator=mrs.Integrator("bs32", tolerance=1e-3)
    )


def test_resumed_run_is_bitwise_the_same():
    """The next solution begins with the last, which a checkpoint holds."""
    whole = scene().run(0.3).run(0.6)
    begun = scene().run(0.3)
    resumed = scene()
    resumed.restore(*begun.snapshot())
    resumed.run(0.6)
    for one, other in zip(whole.state, resumed.state, strict=True):
        np.testing.assert_array_equal(one, other)
    assert whole.scene.resistance.memory.iterations == resumed.scene.resistance.memory.iterations


def test_held_points_move_as_they_are_told():
    sim = scene("held").run(0.25)
    np.testing.assert_allclose(sim.now.points[:12], wagging(0.15), atol=1e-14)
    change = (wagging(0.15 + 1e-6) - wagging(0.15 - 1e-6)) / 2e-6
    np.testing.assert_allclose(sim.now.motion[:12, :3], change, atol=1e-8)
    fluid = sim.velocity(sim.now.points[:12])
    np.testing.assert_allclose(fluid, change, atol=1e-3 * np.abs(change).max())


def test_blob_much_larger_than_spacing_is_solved_or_refused():
    """The condition of the mobility grows by exp(pi epsilon / spacing)."""
    helix = mrs.surfaces.helix(1.0, 3.0, 3.0, 0.05, spacing=1 / 7)
    assert len(helix.points) > 500
    exact = mrs.Rigid(helix, motion=mrs.Drive(angular_velocity=(0, 0, 1)))
    thrust = mrs.Simulation(mrs.Fluid(), [exact], backend=EXACT).now.loads[:, 2].sum()
    coarse = mrs.surfaces.helix(1.0, 3.0, 3.0, 0.05, spacing=0.5)
    expected = mrs.resistance(mrs.Rigid(coarse), mrs.Fluid())[2, 5]
    assert thrust == pytest.approx(expected, rel=0.01)
    twice = mrs.Rigid(np.repeat(helix.points[:50], 2, axis=0), epsilon=0.1, force=(0, 0, 1))
    with pytest.raises(ResistanceError, match=r"node 0 of 'rigid' .* is 0 epsilon from the next"):
        mrs.Simulation(mrs.Fluid(), [twice], backend=EXACT).now  # noqa: B018


def test_rigid_rod_does_not_turn_about_its_axis():
    """Points on a line put no torque on the fluid along it; all other motion follows."""
    line = np.linspace(-1, 1, 15)[:, None] * [0.0, 0.0, 1.0]
    rod = mrs.Rigid(line, epsilon=0.15, orientations=[TURN], force=(1, 0, 0))
    sim = mrs.Simulation(mrs.Fluid(), [rod], backend=EXACT)
    velocity, spin = sim.now.rates
    np.testing.assert_allclose(spin, 0.0, atol=1e-12)
    axis = mrs.rotations.rotate(mrs.rotations.normalize(TURN[None]), np.array([[0.0, 0, 1]]))[0]
    matrix = rigid_oracle.stokeslets(sim.now.points, np.full(15, 0.15), 1.0)
    for direction in (axis, np.cross(axis, [0, 0, 1.0])):
        unit = direction / np.linalg.norm(direction)
        drag = np.linalg.solve(matrix, np.tile(unit, 15)).reshape(-1, 3).sum(axis=0) @ unit
        assert velocity @ unit == pytest.approx(unit[0] / drag, rel=1e-8)


def test_sphere_near_a_wall():
    """Lorentz: along the wall the drag grows by 1 / (1 - 9/16 a/h), away from it by 9/8."""
    wall = mrs.Fluid(boundary=mrs.Wall((0, 0, 0), (0, 0, 1)))
    far = mrs.resistance(ball(100, positions=[[0, 0, 8.0]]), wall)
    alone = mrs.resistance(ball(100), mrs.Fluid())
    np.testing.assert_allclose(far, far.T, atol=1e-5 * far[0, 0])
    ratio = 1 / 8.0
    along, across = 1 - 9 / 16 * ratio + ratio**3 / 8, 1 - 9 / 8 * ratio + ratio**3 / 2
    assert far[0, 0] / alone[0, 0] == pytest.approx(1 / along, rel=2e-3)
    assert far[2, 2] / alone[2, 2] == pytest.approx(1 / across, rel=2e-3)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: mrs.Rigid(wagging), r"shape must not be a function; wrap it: mrs\.Moving"),
        (lambda: ball(motion="stuck"), r"motion must be .*'free'.*'held'.*'stuck'"),
        (lambda: ball(motion="held", force=(0, 0, 1)), "force and torque must be zero unless"),
        (lambda: ball(orientations=[[0, 0, 0, 0]]), "orientations must not be zero"),
        (lambda: ball(epsilon=[0.1, 0.2]), r"epsilon must be a number, or have shape \(60,\)"),
        (lambda: mrs.surfaces.capsule(1.0, 1.5, 10), "length must be .*2.*1.5"),
        (lambda: mrs.Mount("head", number=-1).numbers(2), "number must be integers"),
    ],
)
def test_refusals(make, message):
    with pytest.raises((TypeError, ValueError), match=message):
        make()


def test_mount_must_be_there():
    line = mrs.geometry.straight(1.0, 5)
    moduli = {"bending": 1.0, "twisting": 1.0, "shearing": 1.0, "stretching": 1.0}
    hair = mrs.Rods(line, **moduli, base=mrs.Mount("head"))
    with pytest.raises(ValueError, match=r"base of 'rods' must be fixed to a Rigid .* got 'head'"):
        mrs.Simulation(mrs.Fluid(epsilon=0.1), [hair, ball(10, name="body")])
    far = mrs.Rods(line, **moduli, base=mrs.Mount("head", number=3))
    with pytest.raises(ValueError, match="number must be less than 1, the bodies of 'head'"):
        mrs.Simulation(mrs.Fluid(epsilon=0.1), [far, ball(10, name="head")])
