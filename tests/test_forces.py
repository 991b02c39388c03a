"""Gravity, springs and functions of one's own: momentum, energy, balance at rest, refusals."""

import itertools

import numpy as np
import pytest

import mrs
from mrs.run import scenario_files
from mrs.time.state import State
from tests.cases import rod_oracle as oracle

MODULI = {"bending": 0.3, "twisting": 0.3, "shearing": 9.0, "stretching": 9.0}
FLUID = mrs.Fluid(viscosity=0.7, epsilon=0.2)


def rods(name="rods", nodes=6, **options):
    lines = [
        mrs.geometry.straight(1.0, nodes, grading="cosine"),
        mrs.geometry.ring(0.4, 7, origin=(1.5, 0.2, 0.3)),
    ]
    return mrs.Rods(lines, name=name, **(MODULI | options))


def swimmers(count=3):
    rng = np.random.default_rng(0)
    x, p = rng.normal(size=(2, count, 3))
    return mrs.Swimmers(x, p, length=0.4, force=0.2)


def simulate(bodies, forces, fluid=FLUID, **options):
    return mrs.Simulation(fluid, bodies, forces=forces, backend="direct", **options)


def added(sim):
    """Return the loads that the forces of a simulation add to those of its bodies, (N, 6)."""
    return sim.now.loads - sim.scene.layout.loads(sim.time, sim.state)


# --- gravity --------------------------------------------------------------------------------------


def test_gravity_on_each_length():
    """A node bears half of the segments that meet there; all of a rod bear its length."""
    body, g = rods(), np.array([0.1, 0.0, -2.0])
    loads = added(simulate([body, swimmers()], [mrs.Gravity(per_length=g, bodies=["rods"])]))
    s = 0.5 - 0.5 * np.cos(np.pi * np.arange(6) / 5)
    half = 0.5 * np.diff(s)
    open_rod = np.append(half, 0.0) + np.append(0.0, half)
    np.testing.assert_allclose(loads[:6, :3], np.outer(open_rod, g), atol=1e-15)
    side = 0.8 * np.sin(np.pi / 7) * np.cos(np.pi / 7)  # along D3 halfway, which is the chord
    np.testing.assert_allclose(loads[6:13, :3].sum(axis=0), body.lengths[1] * g, rtol=1e-14)
    assert body.lengths[1] == pytest.approx(7 * side / np.cos(np.pi / 7), rel=1e-12)
    np.testing.assert_array_equal(loads[13:], 0.0)
    np.testing.assert_array_equal(loads[:, 3:], 0.0)


def test_gravity_on_each_point():
    g = [0.0, 3.0, -1.0]
    some = added(simulate([rods(), swimmers()], [mrs.Gravity(per_point=g, bodies=["swimmers"])]))
    np.testing.assert_allclose(some[:, :3], [[0, 0, 0]] * 13 + [g] * 6, atol=1e-15)
    dust = mrs.Tracers([[0.0, 0.0, 5.0]])
    both = added(simulate([dust, rods(), swimmers()], [mrs.Gravity(per_point=g)]))
    np.testing.assert_allclose(both[:, :3], [[0, 0, 0]] + [g] * 19, atol=1e-15)


# --- springs --------------------------------------------------------------------------------------

STARTS = [("rods", 0), ("rods", 9), ("swimmers", 1), ("others", 2), ("rods", 0)]
LINKS = [("swimmers", 5), ("others", 12), ("swimmers", 4), ("rods", 12), ("rods", 3)]
STIFFNESS, REST = np.array([1.0, 2.0, 0.5, 4.0, 3.0]), np.array([0.0, 0.3, 0.2, 5.0, 0.1])


def linked(starts=STARTS, ends=LINKS, **options):
    options = {"stiffness": STIFFNESS, "rest_length": REST} | options
    others = mrs.Rods(
        [line.moved((0.3, 1.0, -0.5)) for line in (mrs.geometry.ring(0.3, 13),)],
        name="others",
        **MODULI,
    )
    return simulate([rods(), swimmers(), others], [mrs.Springs(starts, ends, **options)])


def test_springs_between_bodies():
    """Each pulls by its stiffness times its extension; no net force, no net torque."""
    sim = linked()
    points, forces = sim.now.points, added(sim)[:, :3]
    first = {"rods": 0, "swimmers": 13, "others": 19}
    expected, energy = np.zeros_like(forces), 0.0
    for (a, i), (b, j), k, rest in zip(STARTS, LINKS, STIFFNESS, REST, strict=True):
        i, j = first[a] + i, first[b] + j
        step = points[j] - points[i]
        r = np.sqrt(step @ step)
        expected[i] += k * (r - rest) * step / r
        expected[j] -= k * (r - rest) * step / r
        energy += 0.5 * k * (r - rest) ** 2
    np.testing.assert_allclose(forces, expected, rtol=0, atol=1e-14 * np.abs(expected).max())
    size = 64 * 2.0**-53 * np.abs(expected).max()
    assert np.abs(forces.sum(axis=0)).max() <= size
    assert np.abs(np.cross(points, forces).sum(axis=0)).max() <= size * np.abs(points).max()
    bodies = sum(body.energy(0.0, sim.body_state(body)) for body in sim.bodies)
    assert sim.energy() - bodies == pytest.approx(energy, rel=1e-13)


def test_forces_of_springs_are_the_slope_of_their_energy():
    """Central differences over 1e-5: the third derivative leaves 1e-10, rounding 1e-11."""
    places = [(1.0, 2.0, 0.5), *LINKS[1:]]  # a tether, and links
    sim = linked(ends=places)
    (force,), layout = sim.scene.forces, sim.scene.layout
    points, small = sim.now.points.copy(), 1e-5
    forces = force.forces(0.0, points, layout, FLUID)
    slopes = np.zeros_like(points)
    for i, axis in itertools.product(range(len(points)), range(3)):
        sides = []
        for sign in (1, -1):
            moved = points.copy()
            moved[i, axis] += sign * small
            sides.append(force.energy(0.0, moved, layout, FLUID))
        slopes[i, axis] = (sides[0] - sides[1]) / (2 * small)
    np.testing.assert_allclose(forces, -slopes, rtol=0, atol=1e-8)


def test_springs_at_rest():
    """At their initial lengths, and with both ends in one place."""
    np.testing.assert_allclose(added(linked(rest_length="initial")), 0.0, atol=1e-14)
    tether = linked([("rods", 0)], [(0, 0, 0)], stiffness=1.0, rest_length=0.5)
    np.testing.assert_array_equal(tether.state.positions[0], 0.0)
    np.testing.assert_array_equal(added(tether), 0.0)


def test_a_swimmer_on_a_tether():
    """It pulls by f (1 - eps / sqrt(l^2 + eps^2)): the force under which a blob does not swim."""
    length, thrust, epsilon, stiffness = 0.5, 2.0, 0.1, 3.0
    swimmer = mrs.Swimmers([[0, 0, 0]], [[0, 0, 1]], length=length, force=thrust)
    tether = mrs.Springs([("swimmers", 0)], [(0, 0, -0.7)], stiffness=stiffness)
    steps = mrs.Integrator("rk4", 0.1)
    sim = simulate([swimmer], [tether], mrs.Fluid(epsilon=epsilon), integrator=steps).run(10.0)
    expected = thrust * (1.0 - epsilon / np.hypot(length, epsilon))
    # Rate of relaxation stiffness / (4 pi epsilon) = 2.4: exp(-24) is left, times 0.5.
    assert stiffness * sim.state.positions[0, 2] == pytest.approx(expected, abs=1e-9)
    assert np.abs(sim.now.motion[:1]).max() < 1e-9
    np.testing.assert_allclose(added(sim)[0], [0, 0, -expected], atol=1e-9)


def test_a_rod_on_a_tether():
    """In a stream it comes to rest where the spring bears its drag, that of a dense mobility."""
    mu, epsilon, nodes, speed, stiffness = 0.7, 0.2, 8, 0.3, 20.0
    flow = mrs.flows.QuadraticFlow(constant=[0.0, 0.0, speed])
    fluid = mrs.Fluid(mu, epsilon, flow)
    rod = mrs.Rods(mrs.geometry.straight(1.0, nodes), **MODULI)
    tether = mrs.Springs([("rods", 0)], [(0, 0, 0)], stiffness=stiffness, rest_length=0.0)
    sim = simulate([rod], [tether], fluid, integrator=mrs.Integrator("rkc2", 0.05)).run(12.0)
    X, columns = sim.now.points, []
    for k, axis in itertools.product((0, 1), range(3 * nodes)):
        loads = np.zeros((2, nodes, 3))
        loads[k].flat[axis] = 1.0
        u, w = oracle.flow(X, np.full(nodes, epsilon), *loads, X, mu)
        columns.append(np.concatenate([u.ravel(), w.ravel()]))
    still = np.zeros(6 * nodes)
    still[2 : 3 * nodes : 3] = -speed  # what the loads must do to the fluid
    loads = np.linalg.solve(np.array(columns).T, still)
    drag = -loads[2 : 3 * nodes : 3].sum()
    assert np.abs(sim.now.motion).max() < 1e-6 * speed
    assert stiffness * X[0, 2] == pytest.approx(drag, rel=1e-5)
    np.testing.assert_allclose(sim.now.loads[:, :3].sum(axis=0), [0, 0, -drag], atol=1e-5 * drag)


@pytest.mark.parametrize(
    "box",
    [
        mrs.Periodic((2.0, 3.0, 4.0)),
        mrs.Periodic(((2.0, 0.0, 0.0), (1.8, 1.0, 0.0), (0.3, -0.4, 3.0))),
        mrs.Periodic(((2.0, 0.0, 0.0), (0.8, 1.5, 0.0)), axes="xy"),
    ],
    ids=["box", "skewed", "slab"],
)
def test_springs_in_a_periodic_box(box):
    """They go to the nearest image at the start, and stay with it however far they are drawn."""
    rng = np.random.default_rng(4)
    starts, ends = 3.0 * rng.normal(size=(2, 10, 3))
    body = mrs.Swimmers(np.concatenate([starts, ends]), np.ones((20, 3)), length=0.1, force=1.0)
    force = mrs.Springs(
        [("swimmers", i) for i in range(10)],
        [*(("swimmers", i) for i in range(10, 15)), *map(tuple, ends[5:])],
        stiffness=2.0,
        rest_length=0.0,
    )
    scene = mrs.Scene(mrs.Fluid(epsilon=0.1, boundary=box), [body], [force])
    multiples = itertools.product(range(-12, 13), repeat=len(box.vectors))
    shifts = np.array(list(multiples)) @ box.vectors
    images = (ends - starts)[:, None] + shifts
    nearest = images[np.arange(10), np.argmin(np.linalg.norm(images, axis=2), axis=1)]
    points = scene.layout.initial_points
    forces = force.forces(0.0, points, scene.layout, scene.fluid)
    np.testing.assert_allclose(forces[:10], 2.0 * nearest, atol=1e-12)
    np.testing.assert_allclose(forces[10:15], -2.0 * nearest[:5], atol=1e-12)
    drawn = points.copy()
    drawn[:10] += [5.0, 0.0, 1.0]
    forces = force.forces(0.0, drawn, scene.layout, scene.fluid)
    np.testing.assert_allclose(forces[:10], 2.0 * (nearest - [5.0, 0.0, 1.0]), atol=1e-12)


def test_springs_in_a_sheared_box():
    """A spring across a face is drawn out as the images on both sides move apart."""
    box, shear = mrs.Periodic((2.0, 2.0, 2.0)), mrs.flows.shear(rate=1.5)  # along x, of z
    body = mrs.Swimmers([[0, 0, 0.1], [0, 0, 1.9]], np.ones((2, 3)), length=0.1, force=1.0)
    force = mrs.Springs([("swimmers", 0)], [("swimmers", 1)], stiffness=1.0, rest_length=0.0)
    scene = mrs.Scene(mrs.Fluid(epsilon=0.1, boundary=box, background=shear), [body], [force])
    points = scene.layout.initial_points
    for time in (0.0, 0.4, 2.5):
        pull = force.forces(time, points, scene.layout, scene.fluid)[0]
        np.testing.assert_allclose(pull, [-1.5 * time * 2.0, 0.0, -0.2], atol=1e-14)
        lattice = scene.fluid.boundary_at(time)
        image = lattice.places((pull - (points[1] - points[0]))[None])
        np.testing.assert_allclose(image, np.round(image), atol=1e-12)


# --- functions of one's own -----------------------------------------------------------------------


def test_functions_of_time_and_state():
    """A trap on one body, and a torque that turns another along a field."""
    field = np.array([0.0, 1.0, 0.0])

    def trap(time, points, state):
        return -(1.0 + time) * points

    def turn(time, points, state):
        along = mrs.rotations.axes(state.quaternions)[:, 2]
        return 0.1 * np.cross(along, field)

    forces = [mrs.UserForce("swimmers", trap), mrs.UserForce("rods", torque=turn)]
    sim = simulate([swimmers(), rods()], forces)
    sim.time = 0.5
    loads = added(sim)
    x = swimmers().points(0.0, State(swimmers().positions, swimmers().quaternions))
    np.testing.assert_allclose(loads[:6, :3], -1.5 * x, rtol=1e-14)
    np.testing.assert_array_equal(loads[6:, :3], 0.0)
    D = oracle.triads(sim.bodies[1].quaternions)
    np.testing.assert_allclose(loads[6:, 3:], 0.1 * np.cross(D[:, 2], field), atol=1e-14)
    np.testing.assert_array_equal(loads[:6, 3:], 0.0)


def test_a_rod_turns_along_a_field():
    """From across the field to along it, without a net force."""
    rod = mrs.Rods(mrs.geometry.straight(1.0, 6), **MODULI)

    def turn(time, points, state):
        return 0.5 * np.cross(mrs.rotations.axes(state.quaternions)[:, 2], [0.0, 1.0, 0.0])

    sim = simulate([rod], [mrs.UserForce("rods", torque=turn)]).run(20.0)
    along = sim.state.positions[-1] - sim.state.positions[0]
    np.testing.assert_allclose(along / np.linalg.norm(along), [0, 1, 0], atol=1e-3)
    np.testing.assert_allclose(sim.now.loads[:, :3].sum(axis=0), 0.0, atol=1e-13)


# --- options and refusals -------------------------------------------------------------------------


def test_several_forces_of_one_kind_in_toml():
    """As a list of tables, or one as a table; all of them act."""
    rod = MODULI | {"shape": {"kind": "straight", "length": 1, "nodes": 5}, "name": "rod"}
    tables = [
        {"starts": [["rod", 0]], "ends": [[0, 0, -1]], "stiffness": 1.0, "rest_length": 0.5},
        {"starts": [["rod", 4]], "ends": [["rod", 0]], "stiffness": 2.0, "rest_length": 0.0},
    ]
    options = {"fluid": {"epsilon": 0.1}, "rods": [rod], "springs": tables,
               "gravity": {"per_length": [0, 0, -3.0], "bodies": ["rod"]}}  # fmt: skip
    sim = scenario_files.make("scene", options).simulation()
    assert [type(force) for force in sim.scene.forces] == [mrs.Gravity, mrs.Springs, mrs.Springs]
    forces = added(sim)[:, 2]
    np.testing.assert_allclose(forces, [-0.375 - 0.5 + 2, -0.75, -0.75, -0.75, -0.375 - 2])
    changed = scenario_files.make("scene", options | {"springs": tables[:1]}).simulation()
    assert changed.description["forces"] != sim.description["forces"]
    wrong = options | {"springs": [tables[0], tables[1] | {"ends": []}]}
    with pytest.raises(mrs.ScenarioError, match=r"springs\.1: ends must be as many as starts, 1, "):
        scenario_files.make("scene", wrong).simulation()


REFUSED = [
    (lambda: mrs.Gravity(), "per_point or per_length must be given, not both, got per_point=None"),
    (lambda: mrs.Gravity((0, 0, 1), (0, 0, 1)), "per_point or per_length must be given, not both"),
    (lambda: mrs.Gravity(per_point=1.0), r"per_point must have shape \(3,\)"),
    (lambda: mrs.Gravity((0, 0, 1), bodies="rods"), "bodies must be a list of names, got 'rods'"),
    (lambda: mrs.Springs([("rods", 0)], [], stiffness=1.0), "ends must be as many as starts, 1, "),
    (lambda: mrs.Springs([3], [(0, 0, 0)], stiffness=1.0), r"starts\[0\] must be the name .*got 3"),
    (lambda: mrs.Springs([("rods", -1)], [(0, 0, 0)], stiffness=1.0), r"starts\[0\]\[1\] .*got -1"),
    (lambda: mrs.Springs([("rods", 0)], [(0, 0)], stiffness=1.0), r"ends\[0\] .*shape \(3,\)"),
    (lambda: mrs.Springs([("rods", 0)], [(0, 0, 0)], stiffness=0.0), "stiffness .*greater than 0"),
    (lambda: mrs.Springs([("rods", 0)], [(0, 0, 0)], stiffness=1.0, rest_length=-1.0),
     "rest_length must not be negative, got -1"),
    (lambda: mrs.Springs([("rods", 0)], [(0, 0, 0)], stiffness=1.0, rest_length="now"),
     "rest_length must be one of 'initial', got 'now'"),
    (lambda: mrs.UserForce("rods"), "force or torque must be given"),
    (lambda: mrs.UserForce("rods", 3.0), "force must be a function of time, points and state"),
    # in a scene
    (lambda: mrs.Gravity((0, 0, 1), bodies=["rod"]), "bodies must be one of 'rods', 'swimmers', "),
    (lambda: mrs.Gravity(per_length=(0, 0, 1)), "per_length must be for .*got 'swimmers'"),
    (lambda: mrs.Springs([("rods", 13)], [(0, 0, 0)], stiffness=1.0),
     "starts: number must be less than 13, the points of 'rods', got 13"),
    (lambda: mrs.Springs([("rods", 0)], [("dust", 0)], stiffness=1.0), "ends must be one of"),
    (lambda: mrs.UserForce("dust", np.cross), "body must be one of 'rods', 'swimmers', got 'dust'"),
    (lambda: mrs.UserForce("swimmers", torque=np.cross), "torque must be None for 'swimmers', "),
]  # fmt: skip


@pytest.mark.parametrize(("make", "message"), REFUSED)
def test_what_is_refused(make, message):
    with pytest.raises((TypeError, ValueError), match=message):
        simulate([rods(), swimmers(), mrs.Tracers([[0, 0, 3]])], [make()])


def test_what_functions_give_is_checked():
    """By the name of the body; torques of a class only where there are some."""
    wrong = mrs.UserForce("rods", lambda time, points, state: np.zeros(2))
    with pytest.raises(ValueError, match=r"force on 'rods' must give shape \(3,\) or \(13, 3\)"):
        assert simulate([rods()], [wrong]).now
    lost = mrs.UserForce("rods", lambda time, points, state: np.where(points > 1.8, np.nan, points))
    with pytest.raises(ValueError, match=r"force on 'rods' must give finite .*node 6 of 'rods'"):
        assert simulate([rods()], [lost]).now

    class Torque(mrs.Force):
        kind = "torque"

        def loads(self, time, state, points, layout, fluid):
            return np.zeros(3), np.ones(3)

    assert added(simulate([rods()], [Torque()]))[:, 3:].min() == pytest.approx(1.0)
    with pytest.raises(ValueError, match="torque of force 'torque' must be zero at points without"):
        assert simulate([rods(), swimmers()], [Torque()]).now
