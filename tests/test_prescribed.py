"""Prescribed beats: the table and its points, and the flow that they drive, by a dense solve."""

import numpy as np
import pytest

import mrs
from mrs.run import scenario_files
from tests.cases import wall_oracle

PERIOD, LENGTH, MU = 0.8, 1.5, 0.7
BASE = np.array([0.0, 0.0, 0.06])
OPTIONS = {"length": LENGTH, "period": PERIOD, "thickness": 0.08, "spacing": 0.9}
TOLERANCE = 1e-9
BACKEND = mrs.Backend("direct", tolerance=TOLERANCE)
RECIPROCAL = np.zeros((2, 2, 4, 3))  # (sines, cosines), modes, powers, directions
RECIPROCAL[0, 0, 1] = [0.1, 0.0, 0.9]
RECIPROCAL[0, 1, 1:] = [[0.2, 0.1, -0.1], [0.5, 0.1, -0.2], [-0.1, 0.2, 0.1]]


def lung():
    return mrs.Beat.read("lung_cilium", **OPTIONS)


def reciprocal():
    return mrs.Beat(*RECIPROCAL, **OPTIONS)


def cilium(shape, **options):
    """Return bodies on the wall z = 0; their bases are a little above it."""
    return mrs.Prescribed(shape, **{"positions": [BASE]} | options)


def scene(*bodies, backend=BACKEND, **options):
    fluid = mrs.Fluid(MU, epsilon=0.1, boundary=mrs.Wall())
    return mrs.Simulation(fluid, list(bodies), backend=backend, **options)


def at(sim, time):
    """Return the evaluation at another time, in the state at the start."""
    return sim.scene.evaluate(time, sim.state)


def dense(points, velocities, epsilon):
    """Return the forces that give points their velocities, by the whole matrix (physics.md 3)."""
    count = len(points)
    matrix = wall_oracle.mobility(points, points, epsilon, MU)
    of_forces = matrix.reshape(count, 6, count, 6)[:, :3, :, :3].reshape(3 * count, 3 * count)
    return np.linalg.solve(of_forces, velocities.ravel()).reshape(-1, 3)


def flow(targets, points, forces, epsilon):
    """Return the velocity at targets, by the formulas of physics.md 3."""
    loads = np.pad(forces, ((0, 0), (0, 3)))
    return wall_oracle.flow(targets, points, loads, epsilon, MU)[:, :3]


# --- beats ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("shape", [lung(), reciprocal()], ids=["lung", "reciprocal"])
def test_velocities_are_the_rates_of_points(shape):
    """Differences of eighth order over a thousandth of a period have nothing but rounding."""
    weights = {1: 4 / 5, 2: -1 / 5, 3: 4 / 105, 4: -1 / 280}
    step = 1e-3 * PERIOD
    for time in (0.0, 0.1, 0.37):
        rates = sum(
            weight * (shape.points(time + k * step) - shape.points(time - k * step)) / step
            for k, weight in weights.items()
        )
        np.testing.assert_allclose(shape.velocities(time), rates, rtol=0, atol=1e-11)


def test_a_tilted_cone_is_as_it_is_given():
    """A straight cilium on a cone, as those of a node: the fit keeps the length."""
    tilt, half, rate = 0.6, 0.5, 2.0 * np.pi / PERIOD
    table = np.zeros((2, 2, 2, 3))
    table[0, 0, 1] = np.cos(half) * np.array([0.0, np.sin(tilt), np.cos(tilt)])
    table[0, 1, 1] = np.sin(half) * np.array([0.0, np.cos(tilt), -np.sin(tilt)])
    table[1, 1, 1] = np.sin(half) * np.array([1.0, 0.0, 0.0])
    shape = mrs.Beat(*table, **OPTIONS)
    place = (np.arange(len(shape.surface.points)) + 0.5) / len(shape.surface.points) * LENGTH
    time = 0.13
    axis, out, side = table[0, 0, 1], table[0, 1, 1], table[1, 1, 1]
    cos, sin = np.cos(rate * time), np.sin(rate * time)
    np.testing.assert_allclose(
        shape.points(time), np.outer(place, axis + cos * out + sin * side), atol=1e-14
    )
    np.testing.assert_allclose(
        shape.velocities(time), rate * np.outer(place, cos * side - sin * out), atol=1e-13
    )


def test_a_base_moves_as_it_is_given():
    table = np.zeros((2, 3, 2, 3))
    table[0, 0, 1] = [0.0, 0.0, 1.0]
    table[1, 2, 0] = [0.2, 0.0, 0.0]
    shape = mrs.Beat(*table, **OPTIONS)
    place = shape.points(0.0)
    np.testing.assert_allclose(place[:, :2], 0.0, atol=1e-15)
    np.testing.assert_allclose(
        shape.points(PERIOD / 8.0) - place, [[0.2 * LENGTH, 0, 0]] * len(place)
    )


def fitted(beat, times):
    """Return the centrelines of the table itself, of length 1 or so, at times of period 1."""
    s = np.linspace(0.0, 1.0, 201)
    for time in times:
        angle = 2.0 * np.pi * time * np.arange(len(beat.cosine))[:, None, None]
        table = (beat.cosine * np.cos(angle) + beat.sine * np.sin(angle)).sum(axis=0)
        yield np.polynomial.polynomial.polyval(s, table).T


def test_the_lung_cilium_is_one():
    """The fit keeps its length within some per cent, and beats as airway cilia do.

    Sleigh, Blake & Liron (1988), Am. Rev. Respir. Dis. 137, 726: the effective stroke is fast and
    upright, in the recovery stroke the cilium is bent and stays low.
    """
    beat = lung()
    times = np.arange(60) / 60.0
    lines = list(fitted(beat, times))
    lengths = np.array([np.linalg.norm(np.diff(x, axis=0), axis=1).sum() for x in lines])
    assert lengths.mean() == pytest.approx(0.975, abs=5e-4)
    np.testing.assert_allclose(lengths, lengths.mean(), rtol=0.053)
    points = np.array([beat.points(PERIOD * time) for time in times])
    chords = np.linalg.norm(np.diff(points, axis=1), axis=2)
    spacing = LENGTH / len(beat.surface.points)
    np.testing.assert_allclose(chords, spacing, rtol=0.03)  # a chord is shorter than its arc
    assert (chords <= spacing).all()
    assert (points[:, :, 2] > 0.0).all()
    np.testing.assert_allclose(points[:, :, 1], 0.0, atol=1e-15)
    forward = np.array([beat.velocities(PERIOD * time)[-1, 0] > 0.0 for time in times])
    assert 0.2 < forward.mean() < 0.4
    middle = np.abs(points[:, -1, 0]) < 0.2 * LENGTH
    effective, recovery = (points[middle & of, -1, 2] for of in (forward, ~forward))
    assert effective.min() > 0.85 * LENGTH
    assert recovery.max() < 0.85 * LENGTH


def test_a_beat_is_read(tmp_path):
    path = tmp_path / "beat.csv"
    path.write_text(
        "# mine\n0,1, 0.1,0,0.9, 0,0,0\n2,3, 1,2,3, 4,5,6  # out of order\n1,0,0,1,0,0,0,0\n"
    )
    beat = mrs.Beat.read(path, **OPTIONS)
    assert beat.cosine.shape == (3, 4, 3)
    expected = np.zeros((2, 3, 4, 3))
    expected[0, 0, 1] = [0.1, 0.0, 0.9]
    expected[:, 2, 3] = [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]
    expected[0, 1, 0] = [0.0, 1.0, 0.0]
    np.testing.assert_array_equal([beat.cosine, beat.sine], expected)


SCENE = """
scenario = "scene"
[[options.prescribed]]
shape = { path = "lung_cilium", length = 1.5, period = 0.8, thickness = 0.08, spacing = 0.9 }
positions = [[0, 0, 1], [2, 0, 1]]
delay = [0.0, 0.3]
"""


def test_a_beat_in_toml(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(SCENE)
    (body,) = scenario_files.make(*scenario_files.read_input(path)).simulation().bodies
    assert (body.kind, body.name, body.motion) == ("prescribed", "prescribed", "held")
    expected = mrs.Prescribed(lung(), positions=[[0, 0, 1], [2, 0, 1]], delay=[0.0, 0.3])
    start = mrs.State(body.positions, body.quaternions)
    np.testing.assert_array_equal(body.points(0.1, start), expected.points(0.1, start))
    path.write_text(SCENE.replace("period = 0.8", "period = 0.0"))
    scenario = scenario_files.make(*scenario_files.read_input(path))
    with pytest.raises(mrs.ScenarioError, match=r"prescribed\.0: shape: period must be"):
        scenario.simulation()


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("0,1,0,0,1,0,0\n", "must have lines of n, m"),
        ("0,1.5,0,0,1,0,0,0\n", "must have lines of n, m"),
        ("-1,1,0,0,1,0,0,0\n", "must have lines of n, m"),
        ("0,1,0,0,1,0,0,0\n0,1,0,0,1,0,0,0\n", "one line for each n and m"),
        ("0,1,0,0,one,0,0,0\n", "one"),
    ],
)
def test_files_that_hold_no_beat(tmp_path, content, message):
    path = tmp_path / "beat.csv"
    path.write_text(content)
    with pytest.raises(ValueError, match=message):
        mrs.Beat.read(path, **OPTIONS)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"cosine": np.zeros((2, 4))}, r"cosine must have shape \(2, 4, 3\), got shape \(2, 4\)"),
        ({"sine": np.zeros((2, 2, 3))}, r"sine must have shape \(2, 4, 3\)"),
        ({"cosine": np.zeros((2, 4, 3))}, r"\|dx/ds\| of at least 0.1, got 0 at time 0"),
        ({"period": 0.0}, "period must be"),
        ({"length": -1.0}, "length must be"),
        ({"thickness": 0.0}, "thickness must be"),
    ],
)
def test_beats_that_are_refused(options, message):
    arguments = {"cosine": RECIPROCAL[0], "sine": RECIPROCAL[1]} | OPTIONS
    with pytest.raises(ValueError, match=message):
        mrs.Beat(**arguments | options)


# --- flow -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("time", [0.0, 0.3 * PERIOD])
def test_flow_of_a_cilium_is_that_of_a_dense_solve(time):
    """Forces, tracers and the flow in space, from the velocities of the shape alone."""
    shape, targets = lung(), np.array([[0.5, 0.4, 1.2], [-1.0, 0.2, 0.5]])
    sim = scene(cilium(shape), mrs.Tracers(targets))
    now = at(sim, time)
    count, epsilon = len(shape.surface.points), shape.surface.epsilon
    points = BASE + shape.points(time)
    forces = dense(points, shape.velocities(time), epsilon)
    np.testing.assert_allclose(now.points[:count], points, atol=1e-15)
    expected = flow(targets, points, forces, epsilon)
    size = np.abs(shape.velocities(time)).max()
    # The residual is within tolerance of the norm of all velocities, at most sqrt(count) of `size`.
    atol = np.sqrt(count) * TOLERANCE * size
    np.testing.assert_allclose(now.motion[count:], expected, rtol=0, atol=atol)
    np.testing.assert_allclose(sim.scene.velocity(targets, now), expected, rtol=0, atol=atol)
    reached = flow(points, points, now.loads[:count], epsilon)
    np.testing.assert_allclose(reached, shape.velocities(time), rtol=0, atol=atol)


def test_mean_flow_of_a_beat():
    """Means over a period by equal steps, of velocities in space and of the flux along the wall."""
    shape, target = lung(), np.array([[0.3, 0.2, 1.8]])
    sim = scene(cilium(shape))
    epsilon, times = shape.surface.epsilon, PERIOD * np.arange(12) / 12.0
    means = []
    for time in times:
        now, points = at(sim, time), BASE + shape.points(time)
        forces = dense(points, shape.velocities(time), epsilon)
        expected = *flow(target, points, forces, epsilon)[0], points[:, 2] @ forces[:, 0]
        pumped = mrs.observables.pumped_flux(now.points, now.loads, MU) * np.pi * MU
        means.append([[*sim.scene.velocity(target, now)[0], pumped], expected])
    got, expected = np.mean(means, axis=0)
    np.testing.assert_allclose(got, expected, rtol=0, atol=10 * TOLERANCE * np.abs(means).max())
    assert expected[3] > 0.02 * np.abs(means)[:, 1, 3].max()  # along the effective stroke


def test_a_reciprocal_beat_pumps_nothing():
    """Times before and after a turning point cancel; the true beat has no turning point."""
    sim = scene(cilium(reciprocal()))
    times = PERIOD * (np.arange(8) + 0.5) / 8.0
    flows = [mrs.observables.pumped_flux(*at(sim, time)[2:4], MU) for time in times]
    assert abs(np.mean(flows)) < 10 * TOLERANCE * np.abs(flows).max()


def swum(shape):
    """Return how far a free beat has come after a quarter of a period, and after all of it."""
    free = mrs.Prescribed(shape, motion="free")
    integrator = mrs.Integrator("rk4", dt=PERIOD / 16)
    sim = mrs.Simulation(mrs.Fluid(MU), [free], backend=BACKEND, integrator=integrator)
    return [np.linalg.norm(sim.run(part * PERIOD).state.positions) for part in (0.25, 1.0)]


def test_a_reciprocal_beat_swims_nowhere():
    """The scallop theorem. What is left is the error of steps, 30 times less with half of dt."""
    quarter, whole = swum(reciprocal())
    assert quarter > 0.05 * LENGTH
    assert whole < 2e-4 * quarter
    quarter, whole = swum(lung())
    assert whole > 0.1 * quarter


def test_a_delay_is_a_shift_of_phase():
    """Two cilia with delays, at a time and at a time that is later by both their delays."""
    both = BASE + np.array([[0.0, 0.0, 0.0], [2.0, 0.5, 0.0]])
    early = scene(cilium(lung(), positions=both, delay=[0.0, 0.25]))
    late = scene(cilium(lung(), positions=both, delay=[0.1, 0.35]))
    one, other = at(early, 0.2), at(late, 0.3)
    np.testing.assert_allclose(one.points, other.points, atol=1e-14)
    size = np.abs(one.loads).max()
    np.testing.assert_allclose(one.loads, other.loads, rtol=0, atol=1e-6 * size)
    np.testing.assert_allclose(one.motion, other.motion, rtol=0, atol=1e-13)
    count = len(one.points) // 2
    np.testing.assert_allclose(one.points[count:] - both[1], lung().points(0.2 - 0.25), atol=1e-14)


def test_a_beat_is_one_as_a_function_too():
    """`Moving` has velocities by differences of fourth order over a thousandth of a period."""
    beat = lung()
    moving = mrs.Moving(beat.points, period=PERIOD, epsilon=beat.surface.epsilon)
    one, other = (at(scene(cilium(shape)), 0.1) for shape in (beat, moving))
    np.testing.assert_array_equal(one.points, other.points)
    size = np.abs(one.loads).max()
    np.testing.assert_allclose(one.loads, other.loads, rtol=0, atol=1e-6 * size)


def test_points_that_meet_are_named():
    """A body that moves past one at rest, nearly through its points; their own are far apart."""
    line, along = np.outer(np.arange(1.0, 6.0), [0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])
    still = mrs.Rigid(line + 1e-9 * along, motion="held", epsilon=0.1, name="still")
    moving = mrs.Moving(lambda time: line + time * along, period=1.0, epsilon=0.1)
    told = (
        r"'.*' .* could not be found in .* that point is 1e-08 epsilon from the next.*bodies apart"
    )
    sim = scene(still, mrs.Prescribed(moving))
    with pytest.raises(ArithmeticError, match=told):
        at(sim, 0.0)


# --- runs -----------------------------------------------------------------------------------------


def carpet(directory):
    """Return four cilia and tracers."""
    places = BASE + mrs.geometry.grid((2, 2), 1.2)
    cilia = cilium(lung(), positions=places, delay=[0.0, 0.1, 0.2, 0.3])
    tracers = mrs.Tracers([[0.1, 0.2, 1.7], [0.5, -0.4, 0.8]])
    return scene(
        cilia,
        tracers,
        backend=mrs.Backend("direct", tolerance=1e-4),
        integrator=mrs.Integrator("heun", dt=0.02),
        output=mrs.Output(directory, interval=0.05),
    )


def test_a_resumed_run_is_the_run(tmp_path):
    """To the bit: iterations begin with the solution that the checkpoint holds."""
    whole = carpet(tmp_path / "whole").run(0.2)
    carpet(tmp_path / "halves").run(0.2, max_walltime=0.0)
    halves = mrs.restart(carpet(tmp_path / "halves"))
    assert 0.0 < halves.time < 0.2
    halves.run(0.2)
    for one, other in zip(whole.state, halves.state, strict=True):
        np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal(whole.now.loads, halves.now.loads)
