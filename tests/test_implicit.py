"""Implicit steps: the Jacobian by its parts, orders, what they cost, and what if they fail."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import mrs
from mrs import rotations
from mrs.time.integrators import METHODS, Problem
from mrs.time.state import State
from mrs.time.stepper import Stepper
from tests.cases import rod_oracle as oracle
from tests.cases.linearization import jacobian
from tests.cases.motions import ROD, STRAIN, Coupled, advance, small_rod

BDF = METHODS["bdf"]


def rods(spacing=1.0, count=2, nodes=13, **changes):
    """Return helical rods in a row that beat, each a little later."""
    origins = mrs.geometry.grid((count, 1), spacing)
    lines = mrs.geometry.array(mrs.geometry.helix(0.3, np.pi, 2.0, nodes), origins)
    options = {
        "bending": 10.0,
        "twisting": 12.0,
        "shearing": 200.0,
        "stretching": 300.0,
        "beat": mrs.TravellingWave((0.6, 0.0, 0.0), 2.0, 1.0),
        "delay": 0.1 * np.arange(count),
        "name": "rods",
    }
    return mrs.Rods(lines, **(options | changes))


def simulation(*bodies, boundary=None, integrator="auto", **options):
    """Return a simulation of bodies in a fluid with blobs of 0.3."""
    where = {} if boundary is None else {"boundary": boundary}
    backend = {"backend": "direct"} | options
    return mrs.Simulation(mrs.Fluid(1.0, 0.3, **where), bodies, integrator=integrator, **backend)


# --- the Jacobian -------------------------------------------------------------------------


def test_stiffness_is_the_derivative_of_the_loads():
    """By differences of whole states, where moments act, but no forces: their part is left out."""
    line = mrs.geometry.at_rest(STRAIN, 0.2, 9)
    rod = mrs.Rods(line, bending=[[1.0, 2.0]], twisting=3.0, shearing=[[20.0, 30.0]], stretching=40)
    count, start = len(rod.positions), State(rod.positions, rod.quaternions)
    found = rod.stiffness(0.0, start).matrix.toarray().reshape(count, 2, 3, count, 2, 3)
    expected, h = np.empty_like(found), 1e-5
    for node, kind, axis in np.ndindex(count, 2, 3):
        z = np.zeros((2 * count, 3))
        z[node + kind * count, axis] = h
        loads = [
            np.stack(rod.loads(0.0, start.moved(start.coordinates() + sign * z)), axis=1)
            for sign in (1.0, -1.0)
        ]
        expected[:, :, :, node, kind, axis] = (loads[0] - loads[1]) / (2.0 * h)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8 * np.abs(expected).max())


def test_a_rod_at_rest_has_the_jacobian_that_is_approximated():
    """Without loads a change of the mobility changes nothing: equal but for single precision."""
    line = mrs.geometry.at_rest(STRAIN, 0.2, 9)
    sim = simulation(mrs.Rods(line, intrinsic_curvature=STRAIN, **ROD))
    exact, g = jacobian(sim), 0.01
    placed = sim.scene.linearized(0.0, sim.state).at(sim.state)
    system = np.eye(len(exact)) - g * exact
    solved = np.array([placed.solve(g, column.reshape(-1, 3)).ravel() for column in system.T]).T
    np.testing.assert_allclose(solved, np.eye(len(exact)), rtol=0, atol=2e-4)


@pytest.mark.parametrize(
    "boundary", [None, mrs.Wall((0.0, 0.0, -5.0))], ids=["free", "over a wall"]
)
def test_a_rod_in_a_plane_has_two_independent_halves(boundary):
    """By the whole matrix; a rod that leaves the plane has none."""
    bent = mrs.geometry.at_rest((0.8, 0.0, 0.0), 0.2, 11)
    planar = {"intrinsic_curvature": (0.5, 0.0, 0.0)} | ROD
    sim = simulation(mrs.Rods(bent, **planar), boundary=boundary)
    linear, g = sim.scene.linearized(0.0, sim.state), 0.01
    assert len(linear._blocks) == 2
    rows = np.arange(11)
    mobility = sim.mobility.matrix(rows, sim.state.positions, sim.fluid.boundary)
    whole = np.eye(66) - g * mobility @ linear._stiffness.toarray()
    right = np.random.default_rng(1).standard_normal((22, 3))
    solved = linear.at(sim.state).solve(g, right)
    mixed = np.stack([solved[:11], solved[11:]], axis=1).ravel()
    expected = np.stack([right[:11], right[11:]], axis=1).ravel()
    np.testing.assert_allclose(whole @ mixed, expected, rtol=0, atol=1e-3 * np.abs(right).max())
    out_of_plane = simulation(mrs.Rods(mrs.geometry.at_rest(STRAIN, 0.2, 11), **planar))
    assert len(out_of_plane.scene.linearized(0.0, out_of_plane.state)._blocks) == 1


def contraction(sim, g):
    """Return by how much a correction with the approximate Jacobian shrinks the worst error."""
    exact = np.eye(sim.state.coordinates().size) - g * jacobian(sim)
    placed = sim.scene.linearized(sim.time, sim.state).at(sim.state)
    left = (
        np.eye(len(exact))
        - np.array([placed.solve(g, column.reshape(-1, 3)).ravel() for column in exact.T]).T
    )
    return np.abs(np.linalg.eigvals(left)).max()


WALL = mrs.Wall((0.0, 0.0, -0.15))


@pytest.mark.parametrize(
    ("options", "boundary"),
    [
        ({}, None),
        ({"base": "clamped"}, WALL),
        ({"base": mrs.Drive(velocity=(0.1, 0.0, 0.0))}, WALL),
        ({"spacing": 0.2}, None),  # closer than a blob: one block
        ({"epsilon": mrs.Taper(0.3, 0.2, 2.0, steps=2)}, None),
    ],
    ids=["free", "on a wall", "driven", "near", "tapered"],
)
def test_corrections_with_the_approximation_converge(options, boundary):
    """Of bent rods: an error of any kind is at most .3 of what it was after a correction."""
    sim = simulation(rods(**options), boundary=boundary).run(0.02)
    assert contraction(sim, 0.02) < 0.3


def test_proxies_make_rods_feel_each_other():
    """Without them a correction leaves more of the error."""
    sim = simulation(rods(spacing=0.8, count=3)).run(0.02)
    with_proxies = contraction(sim, 0.2)
    linear = sim.scene.linearized(sim.time, sim.state)
    linear._proxies = None
    linear._equations.clear()
    assert with_proxies < 0.8 * contraction(sim, 0.2)


# --- orders -------------------------------------------------------------------------------


@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_order_at_variable_steps(order, monkeypatch):
    """With an exact Jacobian and past; every third step is 1.6 times as long as the others."""
    monkeypatch.setattr("mrs.time.integrators.bdf._HIGHEST", order)
    monkeypatch.setattr("mrs.time.integrators.bdf._CHANGED", 1.0 + 1e-9)
    z = np.array([[1.0, 0.3, -0.2]])

    def f(t, z):
        x, y, w = z[0]
        return np.array([[y - 3.0 * x**3, -x * w - 0.5 * y + np.cos(3.0 * t), np.sin(x) - w]])

    def linearized(time, state):
        x, _, w = state.positions[0]
        matrix = np.array([[-9.0 * x**2, 1.0, 0.0], [-w, -0.5, -x], [np.cos(x), 0.0, -1.0]])

        def solve(g, right):
            return np.linalg.solve(np.eye(3) - g * matrix, right[0])[None]

        return SimpleNamespace(solve=solve, product=lambda x: x @ matrix.T)

    exact = solve_ivp(
        lambda t, y: f(t, y[None])[0],
        (0.0, 1.0),
        z[0],
        "DOP853",
        rtol=1e-12,
        atol=1e-13,
        dense_output=True,
    ).sol
    errors = []
    for steps in (80, 160, 320):
        sizes = np.tile([1.0, 1.0, 1.6], -(-steps // 3))[:steps]
        t, state, memory = 0.0, State(z, np.empty((0, 4))), {}
        for h in sizes / sizes.sum():
            rates = lambda t=t, state=state: f(t, state.positions)  # noqa: E731
            problem = Problem(f, rates, 0.0, state, linearized, np.full((1, 3), 1e-10))
            step = BDF.step(problem, t, state.positions, h, memory)
            t, state, memory = t + h, state.moved(step.z), step.memory
            if len(memory["times"]) <= order:  # with an exact past
                state.positions[:] = memory["positions"][0] = exact(t)
            memory["order"] = np.asarray(min(order, len(memory["times"]) - 1))
        errors.append(np.abs(state.positions[0] - exact(1.0)).max())
    np.testing.assert_allclose(oracle.orders(errors)[-1], order, atol=0.2)


def test_triads_and_points_that_are_not_stiff():
    """Without any Jacobian, corrections are evaluations: the tolerance is kept all the same."""
    exact, triads = Coupled().exact(1.0)
    state = advance(Stepper(mrs.Integrator("bdf", tolerance=1e-6)), Coupled(), Coupled.start(), 1.0)
    np.testing.assert_allclose(state.positions, exact, rtol=0, atol=1e-4)
    np.testing.assert_allclose(oracle.triads(state.quaternions), triads, rtol=0, atol=1e-4)


# --- costs --------------------------------------------------------------------------------


def test_a_coiling_rod_takes_a_fraction_of_the_sums():
    """The rod of Olson, Lim & Cortez to 0.02 s, beside rkc2 at 1e-6."""
    runs = {}
    for name, tolerance in (("rkc2", 1e-6), ("auto", 3e-4), ("rkc2 ", 3e-4)):
        nodes = np.zeros((76, 3))
        nodes[:, 2] = np.arange(76) * np.pi / 40
        turn = np.tile([-np.sin(5e-5), 0.0, 0.0, np.cos(5e-5)], (76, 1))
        rod = mrs.Rods(
            mrs.geometry.Centerline(nodes, turn),
            bending=3.5e-3,
            twisting=3.5e-3,
            shearing=0.8,
            stretching=0.8,
            intrinsic_curvature=(1.3, 0.0, np.pi / 2),
        )
        fluid = mrs.Fluid(1e-6, 6 * np.pi / 40)
        integrator = mrs.Integrator(name.strip(), tolerance=tolerance)
        sim = mrs.Simulation(fluid, [rod], backend="direct", integrator=integrator).run(0.02)
        runs[name] = sim.state.positions, sim.scene.evaluations
    exact, _ = runs["rkc2"]
    moved = np.linalg.norm(exact - nodes)
    assert np.linalg.norm(runs["auto"][0] - exact) < 1e-3 * moved
    assert runs["auto"][1] < 200 < 0.3 * runs["rkc2 "][1]


def test_frames_do_not_shorten_steps():
    """A run that is stopped often takes the same steps, and passes its states."""
    one, other = (simulation(rods(base="clamped")) for _ in range(2))
    times = []

    class Often(mrs.Tracker):
        when = mrs.Interval(1e-3)

        def handle(self, sim):
            times.append(sim.time)

    other.trackers.append(Often())
    one.run(0.1)
    other.run(0.1)
    assert len(times) == 100 > 2 * one.stepper.steps
    assert other.stepper.steps == one.stepper.steps
    assert other.state.equals(one.state)


def test_states_between_steps_are_on_the_motion():
    """Beside a run of rkc2 at a tolerance a hundred times smaller."""
    sims = [
        simulation(rods(base="clamped"), integrator=mrs.Integrator(name, tolerance=tolerance))
        for name, tolerance in (("bdf", 1e-4), ("rkc2", 1e-6))
    ]
    places = ([], [])
    for sim, found in zip(sims, places, strict=True):

        class Often(mrs.Tracker):
            when = mrs.Interval(0.01)

            def handle(self, sim, found=found):
                found.append(sim.state.positions)

        sim.trackers.append(Often())
        sim.run(0.1)
    length = sims[0].bodies[0].length_scale
    np.testing.assert_allclose(*places, rtol=0, atol=1e-4 * length)


# --- whatever happens ---------------------------------------------------------------------


def test_a_run_goes_on_bitwise_from_any_step():
    """From the snapshots within and between steps, in a new simulation."""

    def made():
        return simulation(rods(base="clamped"), boundary=WALL)

    sim, saved = made(), []

    class Save(mrs.Tracker):
        when = mrs.Interval(0.004)

        def handle(self, sim):
            saved.append(sim.snapshot())

    sim.trackers.append(Save())
    sim.run(0.06)
    assert len(saved) > 12
    for arrays, values in saved[1::4]:
        other = made()
        other.restore(arrays, values)
        other.trackers.append(Save())
        assert other.run(0.06).state.equals(sim.state)
        assert other.stepper.steps == sim.stepper.steps


def test_explicit_steps_take_over_where_corrections_diverge(monkeypatch):
    """With solutions of the wrong sign, and no products; the motion is that of rkc2."""
    right = simulation(rods(), integrator=mrs.Integrator("rkc2", tolerance=1e-5)).run(0.02)
    sim = simulation(rods(), integrator=mrs.Integrator(tolerance=1e-5))
    linearized = sim.scene.linearized

    def wrong(time, state):
        found = linearized(time, state)
        return SimpleNamespace(
            at=lambda state: SimpleNamespace(
                solve=lambda g, right: -found.at(state).solve(g, right),
                product=lambda x: np.nan * x,
            )
        )

    monkeypatch.setattr(sim.scene, "linearized", wrong)
    sim.run(0.02)
    assert sim.stepper.method.name in ("rkc2", "bs32")
    np.testing.assert_allclose(sim.state.positions, right.state.positions, rtol=0, atol=1e-4)


def test_rods_that_stretch_a_thousand_times_less():
    """Steps are not as many times shorter as those of an explicit method."""
    steps = [
        simulation(rods(stretching=300.0 * stiff, shearing=200.0 * stiff)).run(0.1).stepper.steps
        for stiff in (1.0, 1e3)
    ]
    assert steps[1] < 2 * steps[0]


def test_a_rod_that_hardly_stretches():
    """Where corrections fail steps become shorter: explicit ones would take thousands of sums."""
    sim = simulation(rods(count=1, base="clamped", stretching=3e7)).run(0.1)
    assert sim.stepper.method.name == "bdf"
    assert sim.scene.evaluations < 1000


def test_swimmers_are_not_stiff():
    """Accuracy limits their steps: the explicit method of third order."""
    swimmers = mrs.Swimmers(
        [[0.0, 0.0, 0.0], [0.6, 0.3, 0.1]], [[0, 0, 1.0], [0, 0.6, 0.8]], length=1, force=1
    )
    assert simulation(swimmers).run(0.5).stepper.method.name == "bs32"


@pytest.mark.parametrize("nodes", [500, 501])
def test_very_long_rods_take_explicit_steps(nodes):
    """Their matrices would be too large: 3006 rows and columns at 501 nodes."""
    line = mrs.geometry.straight(10.0, nodes)
    rod = mrs.Rods(line, bending=1.0, twisting=1.0, shearing=1.0, stretching=1.0)
    assert simulation(rod).scene.is_stiff == (nodes == 500)


def test_too_many_rods_take_explicit_steps(monkeypatch):
    """Each has a matrix and two factorisations of 78 x 78 singles: 73,008 bytes."""
    monkeypatch.setattr("mrs.linearization._MEMORY", 5 * 73_008)
    assert simulation(rods(count=5)).scene.is_stiff
    assert not simulation(rods(count=6)).scene.is_stiff


def test_logarithm_is_the_inverse_of_the_exponential():
    phi = np.random.default_rng(0).normal(size=(50, 3))
    phi *= np.linspace(0.0, 3.1, 50)[:, None] / np.linalg.norm(phi, axis=1)[:, None]
    q = rotations.exponential(phi)
    np.testing.assert_allclose(rotations.logarithm(q), phi, rtol=0, atol=1e-14)
    np.testing.assert_allclose(rotations.logarithm(-q), phi, rtol=0, atol=1e-14)


def test_a_rod_keeps_what_it_must_over_many_steps():
    """A free rod at rest in still fluid stays, and its triads stay orthonormal."""
    sim = small_rod(8, "auto", 0.1).run(2000.0)
    assert sim.energy() < 1e-10 * ROD["bending"]
    loads = sim.now.loads
    size = np.abs(STRAIN).max() * ROD["bending"]
    assert np.abs(loads[:, :3].sum(axis=0)).max() < 1e-12 * size
    norms = np.linalg.norm(sim.state.quaternions, axis=1)
    np.testing.assert_allclose(norms, 1.0, rtol=0, atol=1e-14)
