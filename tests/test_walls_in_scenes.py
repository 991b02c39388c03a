"""Scenes over a no-slip wall: what is refused, what holds bodies off it, and their files."""

import numpy as np
import pytest

import mrs
from mrs.scenarios.swimmer_at_wall import SwimmerAtWall
from tests.cases import wall_oracle
from tests.plugins.registered import weights

EPSILON, MU = 0.1, 0.7
WALL = mrs.Wall()
TILTED = mrs.Wall([1.0, -2.0, 0.5], [0.36, 0.48, 0.8])


def swimmer(position=(0.0, 0.0, 1.0), direction=(0.0, 0.0, -1.0), **options):
    options = {"length": 0.5, "force": 1.0, "epsilon": EPSILON} | options
    return mrs.Swimmers([position], [direction], **options)


def rod(height=2.0, direction=(1.0, 0.0, 0.0), **options):
    line = mrs.geometry.straight(0.5, 5, origin=(0.0, 0.0, height), direction=direction)
    moduli = {"bending": 0.1, "twisting": 0.1, "shearing": 1.0, "stretching": 1.0}
    return mrs.Rods(line, **moduli, epsilon=0.2, name="rod", **options)


# --- what is behind the wall --------------------------------------------------------------------


@pytest.mark.parametrize(
    ("body", "name"),
    [
        (rod(-0.1), "node 0 of 'rod'"),
        (swimmer((0.0, 0.0, 0.3), (0.0, 0.0, 1.0)), "node 1 of 'swimmers'"),  # its flagellum
        (mrs.Tracers([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]), "node 1 of 'tracers'"),
    ],
    ids=lambda value: getattr(value, "name", ""),
)
def test_a_body_behind_the_wall_is_refused(body, name):
    with pytest.raises(ValueError, match=f"^{name} must be in the fluid, within .*Wall"):
        mrs.Simulation(mrs.Fluid(MU, boundary=WALL), [body])


def test_there_is_no_flow_behind_the_wall():
    sim = mrs.Simulation(mrs.Fluid(boundary=WALL), [swimmer()])
    with pytest.raises(ValueError, match=r"^points must be .*got row 1, \(0\.0, 0\.0, -1\.0\)"):
        sim.velocity([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])


def towards_the_wall():
    """Return the flow (2 x z, 0, -z^2), which comes down to the wall and turns along it."""
    quadratic = np.zeros((3, 3, 3))
    quadratic[0, 0, 2], quadratic[2, 2, 2] = 2.0, -1.0
    return mrs.flows.QuadraticFlow(quadratic=quadratic)


def test_too_long_a_fixed_step_names_the_node():
    """From z = 2 a step of 1 leads to z = -2; the simulation stays where it was."""
    fluid = mrs.Fluid(boundary=WALL, background=towards_the_wall())
    sim = mrs.Simulation(fluid, [rod()], integrator=mrs.Integrator("euler", dt=1.0))
    told = r"^at time 0: node 0 of 'rod' must be in .*Wall"
    with (
        pytest.warns(UserWarning, match="beyond the stability limit"),
        pytest.raises(mrs.SimulationError, match=told),
    ):
        sim.run(1.0)
    assert sim.time == 0.0
    np.testing.assert_array_equal(sim.state.positions, rod().positions)


@pytest.mark.parametrize("integrator", ["rkc2", "bs32"])
def test_steps_through_the_wall_are_shortened(integrator):
    """A swimmer that dives at constant speed takes long steps, until one is too long."""
    sim = mrs.Simulation(mrs.Fluid(boundary=WALL), [swimmer((0, 0, 3.0))], integrator=integrator)
    sim.run(10.0)
    assert sim.stepper.rejections > 0
    assert 0.0 < WALL.heights(sim.now.points).min() < 0.5 * EPSILON


@pytest.mark.parametrize("integrator", ["rkc2", "euler"])
def test_a_cilium_may_stand_on_the_wall(integrator):
    """Its base is held there. The spectral radius is not taken from states with it in the wall."""
    beat = mrs.TravellingWave((0.5, 0.0, 0.0), 1.0, 1.0)
    cilium = rod(0.0, (0.0, 0.0, 1.0), base="clamped", beat=beat)
    sim = mrs.Simulation(mrs.Fluid(boundary=WALL), [cilium], integrator=integrator).run(0.05)
    np.testing.assert_array_equal(sim.state.positions[0], 0.0)
    assert np.ptp(sim.state.positions[:, 1]) > 1e-3
    alone = mrs.Simulation(mrs.Fluid(), [cilium], integrator="rkc2").run(1e-4)
    assert sim.stepper.radius == pytest.approx(alone.stepper.radius, rel=0.1)  # of short modes


# --- backgrounds ----------------------------------------------------------------------------------


def test_shear_is_zero_on_its_plane():
    along = TILTED.frame[0]
    flow = mrs.flows.shear(2.0, along, TILTED.normal, TILTED.point)
    on_plane = np.random.default_rng(0).standard_normal((20, 2)) @ TILTED.frame[:2] + TILTED.point
    above = on_plane + 1.5 * np.array(TILTED.normal)
    np.testing.assert_allclose(flow.velocity(on_plane, 0.0), 0.0, atol=1e-14)
    np.testing.assert_allclose(flow.velocity(above, 0.0), np.tile(3.0 * along, (20, 1)), atol=1e-13)
    mrs.Fluid(boundary=TILTED, background=flow)


@pytest.mark.parametrize(
    "flow",
    [
        mrs.flows.shear(1.0, origin=(0.0, 0.0, 0.1)),
        mrs.flows.extension(1.0),
        mrs.flows.UserFlow(lambda x, t: np.array([1.0, 0.0, 0.0])),
    ],
    ids=["shear", "extension", "uniform"],
)
def test_a_background_that_flows_at_the_wall_is_refused(flow):
    with pytest.raises(
        ValueError, match=r"^background must be zero at the wall, .*got velocity \["
    ):
        mrs.Fluid(boundary=WALL, background=flow)


# --- steric repulsion -----------------------------------------------------------------------------


def test_steric_repulsion_from_a_wall():
    """`strength` at a height of one radius, nothing beyond chi radii, along the normal."""
    steric = mrs.Steric(strength=3.0, radius=0.2, chi=1.25)
    heights = np.array([0.2, 0.2249, 0.25, 0.3])
    points = TILTED.point + np.outer(heights, TILTED.normal)
    forces = steric.from_wall(points, TILTED)
    assert np.linalg.norm(np.cross(forces, TILTED.normal)) < 1e-14
    along = forces @ TILTED.normal
    assert along[0] == pytest.approx(3.0, rel=1e-12)
    share = ((1.25**2 * 0.04 - 0.2249**2) / (1.25**2 * 0.04 - 0.04)) ** 4
    assert along[1] == pytest.approx(3.0 * share * 0.2249 / 0.2, rel=1e-9)
    np.testing.assert_allclose(along[2:], 0.0, atol=1e-12)


def test_a_sedimenting_point_comes_to_rest_on_the_wall():
    """There the repulsion bears its weight."""
    steric = mrs.Steric(strength=4.0, radius=EPSILON)
    weight = weights.Weights([(0.3, -0.2, 0.5)], (0.0, 0.0, -1.0), EPSILON)
    sim = mrs.Simulation(mrs.Fluid(boundary=WALL), [weight], forces=[steric]).run(10.0)
    (height,) = WALL.heights(sim.state.positions)
    assert EPSILON < height < 1.1 * EPSILON
    np.testing.assert_allclose(steric.from_wall(sim.state.positions, WALL), [[0, 0, 1]], atol=1e-4)
    np.testing.assert_allclose(sim.state.positions[0, :2], [0.3, -0.2], atol=1e-12)


# --- files ----------------------------------------------------------------------------------------


def scene(directory):
    """Return a rod, a swimmer of two blob sizes and tracers over a tilted wall, in shear."""
    along, normal = TILTED.frame[0], np.array(TILTED.normal)
    fluid = mrs.Fluid(
        MU, boundary=TILTED, background=mrs.flows.shear(0.3, along, normal, TILTED.point)
    )
    line = mrs.geometry.straight(1.0, 7, origin=TILTED.point + 0.4 * normal, direction=along)
    bodies = [
        mrs.Rods(
            line, bending=1.0, twisting=0.7, shearing=20.0, stretching=20.0, epsilon=0.15,
            intrinsic_curvature=[1.0, 0.4, 0.8],
        ),
        swimmer(TILTED.point + 0.5 * normal - along, along - normal, flagellum_epsilon=0.15),
        mrs.Tracers(TILTED.point + np.outer([0.2, 0.0], normal)),
    ]  # fmt: skip
    forces, output = [mrs.Steric(1.0, EPSILON)], mrs.Output(directory, interval=0.05)
    return mrs.Simulation(fluid, bodies, forces=forces, backend="direct", output=output)


def test_a_stored_run_and_a_resumed_one(tmp_path):
    """The velocity in a frame is that of the run, and two halves have the bits of the whole."""
    whole = scene(tmp_path / "whole").run(0.1)
    points = TILTED.point + np.random.default_rng(1).random((40, 3)) @ TILTED.frame
    exact = whole.velocity(points)
    _, velocity = mrs.frame_velocity(tmp_path / "whole")
    # Forces are stored in singles, and those of a rod cancel to a hundredth.
    np.testing.assert_allclose(velocity(points), exact, atol=1e-5 * np.abs(exact).max())
    np.testing.assert_array_equal(velocity(points - 5.0 * np.array(TILTED.normal)), 0.0)

    scene(tmp_path / "halves").run(0.1, max_walltime=0.0)
    halves = mrs.restart(scene(tmp_path / "halves"))
    assert 0.0 < halves.time < 0.1
    halves.run(0.1)
    for a, b in zip(whole.state, halves.state, strict=True):
        np.testing.assert_array_equal(a, b)
    tracers = whole.scene.layout.parts[2]
    above, on_wall = TILTED.heights(tracers.state(whole.state).positions)
    assert above > 0.1
    assert abs(on_wall) < 1e-12  # a point on the wall stays where it is
    rest = tracers.body.positions[1]
    np.testing.assert_allclose(tracers.state(whole.state).positions[1], rest, atol=1e-12)


# --- swimmers -------------------------------------------------------------------------------------


def motion_of(height, angle, stroke, epsilons=(EPSILON, EPSILON)):
    """Return the simulation of a swimmer of length 1 whose middle is at a height."""
    along = np.array([np.cos(angle), 0.0, np.sin(angle)])
    reach = 0.5 if stroke == "pusher" else -0.5
    pair = swimmer(
        np.array([0.0, 0.0, height]) + reach * along, along, length=1.0, stroke=stroke,
        epsilon=epsilons[0], flagellum_epsilon=epsilons[1],
    )  # fmt: skip
    return mrs.Simulation(mrs.Fluid(MU, boundary=WALL), [pair], backend="direct")


def test_both_particles_have_images():
    """With blob sizes of their own."""
    sim = motion_of(0.7, 0.4, "puller", (0.1, 0.25))
    points, loads = sim.now.points, np.pad(sim.now.loads, ((0, 0), (0, 3)))
    expected = sum(
        wall_oracle.flow(points, points[[k]], loads[[k]], epsilon, MU)
        for k, epsilon in enumerate((0.1, 0.25))
    )
    np.testing.assert_allclose(sim.now.motion, expected[:, :3], rtol=0, atol=1e-14)


@pytest.mark.parametrize("angle", [0.0, 0.5, -1.0])
@pytest.mark.parametrize("stroke", ["pusher", "puller"])
def test_far_from_the_wall_a_swimmer_is_a_dipole(stroke, angle):
    """Berke et al. (2008), with p = f l for a pusher, and angles from the wall.

    u_z = -3 p (1 - 3 sin^2) / (64 pi mu h^2) of the middle, which would stay without the wall, and
    d angle/dt = -3 p sin cos [1 + (1 + sin^2) / 2] / (64 pi mu h^3) of a body that is all axis.
    """
    dipole = 1.0 if stroke == "pusher" else -1.0
    sin, unit = np.sin(angle), dipole * 3.0 / (64.0 * np.pi * MU)
    errors = []
    for height in (10.0, 20.0):
        sim = motion_of(height, angle, stroke)
        climb = sim.now.motion[:, 2].mean() * height**2 / unit
        turn = -sim.now.rates[1, 1] * height**3 / unit
        turning = -sin * np.cos(angle) * (1.0 + 0.5 * (1.0 + sin**2))
        errors.append([climb + 1.0 - 3.0 * sin**2, turn - turning])
    # The next terms are (l / h)^2 of these.
    np.testing.assert_allclose(errors[0], 0.0, atol=0.02)
    np.testing.assert_allclose(errors[1], np.array(errors[0]) / 4.0, atol=1e-4)


def test_a_swimmer_comes_to_swim_along_the_wall():
    """The scenario: it comes down, and steric repulsion lets it go no further."""
    scenario = SwimmerAtWall(height=1.5, angle=-0.6)
    sim = scenario.simulation().run(15.0)
    heights = WALL.heights(sim.now.points)
    np.testing.assert_allclose(heights, 1.05 * scenario.epsilon, atol=0.05 * scenario.epsilon)
    assert sim.now.motion[0, 0] > 0.5
