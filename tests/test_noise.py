"""Random motion against its laws; the same bits after a kill; nothing random leaves the fluid.

Every seed is fixed. Laws are asked for within four standard errors of their sample, which a right
program misses once in 16,000 draws of a seed.
"""

import dataclasses
import random

import numpy as np
import pytest

import mrs
import treecode
from mrs.observables import mean_square_displacement, orientation_memory
from mrs.run import cli, scenario_files
from tests.plugins.symmetry_plane import SymmetryPlane
from tests.test_runs import assert_equal_runs, begin, kill_on_its_way, state_of
from tests.test_swimmers import U0

AXIS = np.array([[0.0, 0.0, 1.0]])
ERRORS = 4.0  # standard errors


def assert_mean(values, expected):
    """Compare the mean of independent values with a law."""
    error = ERRORS * np.std(values) / np.sqrt(len(values))
    assert np.mean(values) == pytest.approx(expected, rel=0.0, abs=error)


class Runners(mrs.Body):
    """Points that run along a direction at speed 1, and feel no fluid: a body of a user's own."""

    kind = name = "runners"
    has_force = False
    length_scale = 1.0

    def __init__(self, count, **noise):
        self.positions = np.zeros((count, 3))
        self.quaternions = np.tile(mrs.rotations.IDENTITY, (count, 1))
        self.noise = mrs.bodies.Noise(count, **noise)

    def rates(self, time, state, velocity, spin):
        return mrs.rotations.rotate(state.quaternions, AXIS), np.zeros((len(velocity), 3))

    def pieces(self):
        return np.arange(len(self.positions))


def frames(sim, times):
    """Return positions and directions at some times, (T, n, 3) each."""
    states = []
    for time in times:
        states.append(sim.run(time).state if time else sim.state)
    positions = np.array([state.positions for state in states])
    return positions, np.array([mrs.rotations.rotate(s.quaternions, AXIS) for s in states])


# --- laws -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("interval", [0.1, 0.7])
def test_tracers_spread_by_6_d_t(interval):
    """Each with its own D, along each axis alike, whatever the frames are."""
    D = np.repeat([0.05, 0.4], 10_000)
    tracers = mrs.Tracers(np.ones((20_000, 3)), diffusivity=D, seed=1)
    sim = mrs.Simulation(mrs.Fluid(), [tracers])
    for stop in interval * np.arange(1, 3):
        sim.run(stop)
    moved = sim.state.positions - 1.0
    for part in np.split(moved, 2) / np.sqrt(2.0 * D * sim.time)[::10_000, None, None]:
        for one in part.T:
            assert_mean(one, 0.0)
            assert_mean(one**2, 1.0)
        for one, other in ((0, 1), (1, 2), (2, 0)):
            assert_mean(part[:, one] * part[:, other], 0.0)
        assert_mean((part**2).sum(axis=1), 3.0)


@pytest.mark.parametrize("steps", [1, 4, 64])
def test_dispersion_in_shear(steps):
    """<x^2> = 2 D t [1 + (g t)^2 / 3]; the noise of a step moves with the flow from the next on.

    So it is with N steps 2 D h sum_k [1 + (g h k)^2], k from 0 to N - 1.
    """
    D, rate, end, count = 0.3, 2.0, 1.5, 20_000
    tracers = mrs.Tracers(np.zeros((count, 3)), diffusivity=D, seed=2)
    integrator = mrs.Integrator("rk4", dt=end / steps)
    fluid = mrs.Fluid(background=mrs.flows.shear(rate))
    x = mrs.Simulation(fluid, [tracers], integrator=integrator).run(end).state.positions[:, 0]
    h = end / steps
    expected = 2.0 * D * h * (1.0 + (rate * h * np.arange(steps)) ** 2).sum()
    assert_mean(x**2, expected)
    limit = 2.0 * D * end * (1.0 + (rate * end) ** 2 / 3.0)
    assert abs(expected / limit - 1.0) < 1.5 / steps


KINDS = {  # noise, and the rate at which directions are forgotten
    "uniform tumbles": ({"tumble_rate": 1.5}, 1.5),
    "tumbles by an angle": (
        {"tumble_rate": 1.5, "tumble_angle": 1.2},
        1.5 * (1.0 - np.cos(1.2)),
    ),
    "reversals": ({"tumble_rate": 0.5, "tumble_angle": np.pi}, 1.0),
    "rotational diffusion": ({"rotational_diffusivity": 0.5}, 1.0),
    "both": ({"tumble_rate": 0.5, "rotational_diffusivity": 0.25}, 1.0),
}


@pytest.mark.parametrize("kind", KINDS)
def test_persistence_and_diffusivity(kind):
    """Memory exp(-k t), and <x^2> = 2 (U/k)^2 (k t - 1 + exp(-k t)): at last diffusion by U^2/3k.

    In steps of h, x is the sum of h p: the law of its square is the sum over all pairs of steps,
    which is above that of continuous time by (k h)^2 / 12 of its first and of its other terms.
    """
    noise, k = KINDS[kind]
    h, times = 1.0 / 16.0, np.array([0.0, 0.5, 1.0, 8.0])
    integrator = mrs.Integrator("euler", dt=h)
    sim = mrs.Simulation(mrs.Fluid(), [Runners(4000, **noise)], integrator=integrator)
    positions, directions = frames(sim, times)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=2), 1.0, rtol=1e-14)
    for time, x, p in zip(times[1:], positions[1:], directions[1:], strict=True):
        assert_mean(p[:, 2], np.exp(-k * time))
        for side in p[:, :2].T:
            assert_mean(side, 0.0)
        steps = h * np.arange(round(time / h))
        square = h**2 * np.exp(-k * abs(steps[:, None] - steps)).sum()
        assert_mean((x**2).sum(axis=1), square)
        terms = 2.0 / k**2 * np.array([k * time, -1.0 + np.exp(-k * time)])
        assert square - terms.sum() == pytest.approx(
            (k * h) ** 2 / 12.0 * abs(terms).sum(), rel=0.01
        )
    slope = np.sum(positions[3] * directions[3], axis=1)  # half of d<x^2>/dt, 3 D at last
    assert_mean(slope, h * np.exp(-k * (8.0 - steps)).sum())


@pytest.mark.parametrize("step", [0.02, 0.5, 20.0])
def test_memory_of_rotational_diffusion_for_any_step(step):
    """The mean of p(0) . p(t) is exp(-2 Dr t) in one step, and that of P2 to third order in it."""
    count, rate = 40_000, 0.7
    body = Runners(count, rotational_diffusivity=rate)
    before = mrs.time.state.State(body.positions, body.quaternions)
    after = body.noise.kicked(before, step, np.random.default_rng(3))
    cosine = mrs.rotations.rotate(after.quaternions, AXIS)[:, 2]
    assert_mean(cosine, np.exp(-2.0 * rate * step))
    a = np.tanh(rate * step)  # the law of docs/noise.md: the mean of (2 U^a - 1)^2 is known
    second = 1.5 * (4.0 / (2.0 * a + 1.0) - 4.0 / (a + 1.0) + 1.0) - 0.5
    assert_mean(1.5 * cosine**2 - 0.5, second)
    assert abs(second - np.exp(-6.0 * rate * step)) < 0.5 * (2.0 * rate * step) ** 3


def test_numbers_of_tumbles_are_poisson():
    """Of swimmers that a time has not turned there are exp(-rate t), also for steps that are long.

    Two turns by pi leave a direction as it was: after t it is p by (1 + exp(-2 rate t)) / 2.
    """
    for step in (0.1, 1.5):
        for noise, expected in (
            ({}, np.exp(-0.8 * step)),
            ({"tumble_angle": np.pi}, 0.5 + 0.5 * np.exp(-1.6 * step)),
        ):
            body = Runners(20_000, tumble_rate=0.8, **noise)
            before = mrs.time.state.State(body.positions, body.quaternions)
            after = body.noise.kicked(before, step, np.random.default_rng(4))
            same = mrs.rotations.rotate(after.quaternions, AXIS)[:, 2] > 1.0 - 1e-12
            assert_mean(same.astype(float), expected)


def test_swimmers_run_and_tumble_in_the_fluid():
    """Far apart, at their own speed U0: memory and displacement as without a fluid."""
    rate, end = 1.0, 3.0
    x, p = mrs.lattice_suspension((6, 6, 6), 1e4, seed=5)
    swimmers = mrs.Swimmers(x, p, length=1.0, force=1.0, epsilon=0.1, tumble_rate=rate, seed=6)
    sim = mrs.Simulation(mrs.Fluid(), [swimmers], backend="direct")
    moved, directions = frames(sim, [0.0, end])
    assert_mean(np.sum(directions[0] * directions[1], axis=1), np.exp(-rate * end))
    square = np.sum((moved[1] - moved[0]) ** 2, axis=1)
    assert_mean(square, 2.0 * (U0 / rate) ** 2 * (rate * end - 1.0 + np.exp(-rate * end)))
    memory = orientation_memory([0.0, end], directions, "first")[1]
    assert memory == pytest.approx(np.sum(directions[0] * directions[1], axis=1).mean())
    assert mean_square_displacement([0.0, end], moved, "first")[1] == pytest.approx(square.mean())


# --- random numbers -------------------------------------------------------------------------------


def dust(count=5, **options):
    return mrs.Tracers(np.zeros((count, 3)), **({"diffusivity": 1.0} | options))


def test_seeds_bodies_and_steps_have_numbers_of_their_own():
    """And what comes after a body in a scene does not change its own."""

    def ends(*bodies):
        sim = mrs.Simulation(mrs.Fluid(), bodies, integrator=mrs.Integrator("euler", dt=0.5))
        return [sim.run(stop).state.positions.reshape(-1, 5, 3) for stop in (0.5, 1.0)]

    (first,), (second,) = ends(dust())
    assert abs(second - 2.0 * first).min() > 1e-6
    (other,), _ = ends(dust(seed=1))
    assert abs(other - first).min() > 1e-6
    (same, beside), _ = ends(dust(), dust(name="more"))
    np.testing.assert_array_equal(same, first)
    assert abs(beside - first).min() > 1e-6


def test_nothing_is_done_without_noise():
    quiet = mrs.Simulation(mrs.Fluid(), [dust(diffusivity=0.0)])
    assert quiet.scene.kicked(0.0, quiet.state, 1.0, 1) is quiet.state
    assert quiet.scene.longest_step == np.inf
    assert not mrs.Tracers([[0.0, 0.0, 0.0]]).noise


def test_a_step_that_failed_is_taken_again_with_the_same_noise(monkeypatch):
    sims = [mrs.Simulation(mrs.Fluid(), [dust()]) for _ in range(2)]
    kicked = sims[1].scene.kicked

    def fails(*arguments):
        kicked(*arguments)
        raise KeyboardInterrupt

    monkeypatch.setattr(sims[1].scene, "kicked", fails)
    with pytest.raises(KeyboardInterrupt):
        sims[1].step(1.0)
    monkeypatch.undo()
    for sim in sims:
        sim.step(1.0)
    assert sims[0].state.equals(sims[1].state)


# --- runs -----------------------------------------------------------------------------------------

SCENE = """
scenario = "scene"
[options]
t_end = 0.6
interval = 0.1
checkpoint_seconds = 0
[options.fluid]
epsilon = 0.1
[[options.swimmers]]
suspension = { kind = "lattice_suspension", shape = [2, 2, 2], spacing = 0.6 }
length = 0.4
force = 1.0
tumble_rate = 2.0
tumble_angle = 1.2
rotational_diffusivity = [0.1, 0.2, 0.3, 0.1, 0.2, 0.3, 0.1, 0.2]
diffusivity = 0.005
seed = 7
[[options.tracers]]
positions = [[0, 0, 0], [0.3, 0, 0], [0, 0.3, 0.3]]
diffusivity = 0.01
"""

MSD = {"kind": "mean_square_displacement", "body": "tracers"}


@pytest.fixture
def scene(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(SCENE)
    return path


def test_killed_and_resumed_run_is_bitwise_the_same(tmp_path, scene):
    """Kills -9 at random moments, with a checkpoint after every step, and a stop in good order."""
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    assert cli.main(["run", str(scene), "--output", str(whole)]) == 0
    arguments = ["run", scene, "--output", killed]
    assert cli.main([*map(str, arguments), "--max-walltime", "0"]) == 0
    steps, moments = [state_of(killed)[1]["integrator"]["steps"]], random.Random(0)
    for _ in range(2):
        process = begin("resume", killed)
        kill_on_its_way(process, killed / "checkpoint.h5", moments.uniform(0.0, 0.02))
        steps.append(state_of(killed)[1]["integrator"]["steps"])
    assert cli.main(["resume", str(killed)]) == 0
    assert len(set(steps)) == 3, steps
    assert max(steps) < state_of(whole)[1]["integrator"]["steps"]
    assert_equal_runs(whole, killed)


def test_frames_and_log_change_nothing(tmp_path, scene):
    """A run that writes has the bits of one that does not, if it ends no step for a frame."""
    made = scenario_files.read_input(scene)
    sims = [
        scenario_files.make(made[0], made[1] | options).simulation(directory)
        for directory, options in (
            (None, {}),
            (tmp_path / "files", {"interval": 1.0, "observables": {"msd": MSD}}),
        )
    ]
    one, other = (sim.run(1.0) for sim in sims)
    assert one.state.equals(other.state)
    assert one.stepper.steps == other.stepper.steps


def test_ranks_have_the_bits_of_one_process(scene, on_ranks):
    made = scenario_files.read_input(scene)

    def end(comm):
        return scenario_files.make(*made).simulation(comm=comm).run(0.1).state

    alone = end(None)
    assert all(state.equals(alone) for state in on_ranks(2, end))


def test_another_seed_is_another_scene(tmp_path):
    output = mrs.Output(tmp_path / "run", 0.5)
    mrs.Simulation(mrs.Fluid(), [dust()], output=output).run(0.5)
    again = mrs.Simulation(mrs.Fluid(), [dust(seed=1)], output=output)
    with pytest.raises(ValueError, match=r"bodies\.tracers\.seed: 0 became 1"):
        mrs.restart(again)


# --- boundaries -----------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class Slit(treecode.boundaries.base.FreeSpace):
    """The fluid is in |z| < 1."""

    def outside(self, points):
        return np.flatnonzero(abs(points[:, 2]) > 1.0)


def test_tracers_in_a_slit_stay_uniform():
    """What would leave the fluid stays where it is: the uniform distribution is the equilibrium."""
    x = np.random.default_rng(8).uniform(-1.0, 1.0, (20_000, 3))
    integrator = mrs.Integrator("euler", dt=0.05)  # displacements of 0.3, a third of the slit
    tracers = mrs.Tracers(x, diffusivity=1.0, seed=9)
    sim = mrs.Simulation(mrs.Fluid(boundary=Slit()), [tracers], integrator=integrator).run(2.0)
    z = sim.state.positions[:, 2]
    assert abs(z).max() < 1.0
    assert_mean(z, 0.0)
    assert_mean(z**2, 1.0 / 3.0)
    assert_mean(z**4, 1.0 / 5.0)
    assert np.mean(z * x[:, 2]) == pytest.approx(0.0, abs=ERRORS / 3.0 / np.sqrt(len(z)))
    along = sim.state.positions[:, :2] - x[:, :2]
    assert (abs(along).min(axis=1) > 0.0).all()


def test_swimmers_that_tumble_at_a_wall_stay_above_it():
    """Both particles of each; with the same images, but no points outside, they do not."""
    x, p = mrs.lattice_suspension((4, 4, 1), 3.0, direction=(0, 0, -1))
    noise = {"tumble_rate": 5.0, "diffusivity": 0.05, "seed": 10}
    swimmers = mrs.Swimmers(x + 0.3 * AXIS, p, length=1.0, force=0.2, epsilon=0.2, **noise)
    lowest = []
    for boundary in (mrs.Wall(), SymmetryPlane()):
        sim = mrs.Simulation(mrs.Fluid(boundary=boundary), [swimmers], backend="direct")
        lowest.append(np.inf)
        while sim.time < 0.5:
            sim.step(0.5)
            lowest[-1] = min(lowest[-1], swimmers.points(sim.time, sim.state)[:, 2].min())
    assert lowest[0] > 0.0 > lowest[1]


# --- step sizes -----------------------------------------------------------------------------------


@pytest.mark.parametrize("integrator", ["rkc2", "bs32", "rk4"])
def test_steps_resolve_noise(integrator):
    """A tenth of a memory or a tumble; a quarter of a blob size along each axis."""
    x, p = mrs.lattice_suspension((1, 1, 2), 5.0)
    own = {"length": 1.0, "force": 0.01, "epsilon": 0.2}
    for noise, expected in (
        ({"tumble_rate": [1.0, 4.0]}, 0.1 / 4.0),
        ({"tumble_rate": 2.0, "tumble_angle": 0.1}, 0.1 / 2.0),
        ({"tumble_rate": 2.0, "tumble_angle": np.pi}, 0.1 / 4.0),
        ({"rotational_diffusivity": 2.0, "tumble_rate": 1.0}, 0.1 / 5.0),
        ({"diffusivity": 0.5}, (0.25 * 0.2) ** 2),
    ):
        swimmers = mrs.Swimmers(x, p, **own, **noise)
        sim = mrs.Simulation(mrs.Fluid(), [swimmers], integrator=integrator, backend="direct")
        assert sim.scene.longest_step == pytest.approx(expected, rel=1e-14)
        sim.run(2.5 * expected)
        assert sim.stepper.steps >= 3
        assert sim.stepper.taken <= expected


def test_too_long_a_fixed_step_is_told():
    x, p = mrs.lattice_suspension((1, 1, 1), 1.0)
    swimmers = mrs.Swimmers(x, p, length=1.0, force=1.0, epsilon=0.1, tumble_rate=10.0)
    with pytest.warns(UserWarning, match=r"^dt: 0\.05 is longer than 0\.01, .* the noise"):
        mrs.Simulation(mrs.Fluid(), [swimmers], integrator=mrs.Integrator("rkc2", dt=0.05))


# --- refusals -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"tumble_rate": -1.0}, r"^tumble_rate must be finite and at least 0, got -1\.0"),
        ({"diffusivity": [0.0, np.inf]}, r"^diffusivity must be finite and at least 0, got inf at"),
        ({"rotational_diffusivity": [1, 2, 3]}, r"^rotational_diffusivity must be a number, or"),
        ({"tumble_angle": 90}, r"^tumble_angle must be at most pi, got 90\.0"),
        ({"seed": -1}, r"^seed must be an integer from 0 to"),
    ],
)
def test_refusals(options, message):
    with pytest.raises(ValueError, match=message):
        mrs.Swimmers(np.zeros((2, 3)), np.ones((2, 3)), length=1.0, force=1.0, **options)
