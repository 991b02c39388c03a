"""Steps: their sizes, rejected ones, and what ends a run."""

import itertools
import warnings

import numpy as np
import pytest

import mrs
from mrs.time.integrators import METHODS
from mrs.time.state import State
from mrs.time.stepper import Stepper
from mrs.time.system import System
from tests.cases import rod_oracle as oracle
from tests.cases.motions import ROD, STRAIN, Coupled, advance, small_rod

# --- step sizes ---------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["bs32", "rkc2"])
def test_error_follows_the_tolerance(name):
    """Two swimmers in a time of two: a hundredth of the tolerance, at most a tenth of the error.

    The error of a step is of third order and so is kept proportional to the tolerance; that of a
    run of second order falls as its power 2/3, that is by 22 for a hundred.
    """
    x = np.array([[0.0, 0.0, 0.0], [0.3, 0.2, 0.1]])
    p = np.array([[0.0, 0.0, 1.0], [0.0, 0.6, 0.8]])
    one = np.ones(2)
    exact, _ = oracle.swim(x, p, 2.0, one, one, 1.0, np.full(4, 0.2))
    errors, work = [], []
    for tolerance in (1e-3, 1e-5, 1e-7):
        integrator = mrs.Integrator(name, tolerance=tolerance)
        swimmers = mrs.Swimmers(x, p, length=1, force=1)
        sim = mrs.Simulation(
            mrs.Fluid(1.0, 0.2), [swimmers], backend="direct", integrator=integrator
        ).run(2.0)
        errors.append(np.abs(sim.state.positions - exact).max())
        work.append(sim.mobility.evaluations)
    assert errors[1] < 0.1 * errors[0]
    assert errors[2] < 0.1 * errors[1]
    assert np.all(np.diff(work) > 0)


class _Burst(System):
    """A point at rest until t = 1, which then begins to shake."""

    error_scale = perturbation = np.ones((1, 1))

    def rates(self, t, state, near=None):
        return np.array([[0.0, 0.0, 50.0 * np.cos(50.0 * t) * (t > 1.0)]]) - 0.0 * state.positions

    def refusal(self, time, state):
        return None


class _Recorder:
    """A method that notes time and size of each step that is tried."""

    def __init__(self, method):
        self.method, self.tried = method, []

    def __getattr__(self, name):
        return getattr(self.method, name)

    def step(self, problem, t, z, h, memory):
        self.tried.append((t, h))
        return self.method.step(problem, t, z, h, memory)


def test_rejected_steps_are_tried_again_smaller():
    """Steps grow by five while nothing happens; the one that meets the burst is tried again."""
    stepper = Stepper(mrs.Integrator("bs32", tolerance=1e-4))
    stepper.method = recorder = _Recorder(METHODS["bs32"])
    stepper.h = 0.01
    start = State(np.zeros((1, 3)), np.empty((0, 4)))
    state = advance(stepper, _Burst(), start, 2.0)
    times, sizes = np.array(recorder.tried).T
    again = np.flatnonzero(np.diff(times) == 0.0)
    assert stepper.rejections == len(again) >= 1
    assert (sizes[again + 1] < sizes[again]).all()
    assert len(times) == stepper.steps + stepper.rejections
    # Accepted steps follow each other without gaps; some hundred errors of 1e-4 at most.
    assert state.positions[0, 2] == pytest.approx(np.sin(100.0) - np.sin(50.0), abs=1e-2)


def test_fixed_step_is_taken_however_short():
    stepper = Stepper(mrs.Integrator("euler", 1e-14))
    time, _ = stepper.step(Coupled(), 0.0, Coupled.start(), 1.0)
    assert time == pytest.approx(1e-14, rel=1e-12)


def test_fixed_steps_fill_an_interval_late_in_a_run():
    """Fifty of 1/50 in one time unit, though times of 1e6 are rounded to 1e-10."""
    stepper = Stepper(mrs.Integrator("euler", 0.02))
    time, state = 1e6, State(np.zeros((1, 3)), np.empty((0, 4)))
    while time < 1e6 + 1.0:
        time, state = stepper.step(_Burst(), time, state, 1e6 + 1.0)
    assert stepper.steps == 50


def test_nothing_is_kept_of_a_rejected_step():
    """A run whose steps are those that were accepted arrives at the same place."""
    stepper = Stepper(mrs.Integrator("bs32", tolerance=1e-3))
    stepper.h = 2.0  # far too long
    problem, state, t, steps = Coupled(), Coupled.start(), 0.0, []
    while t < 2.0:
        t, state = stepper.step(problem, t, state, 2.0)
        steps.append(t)
    assert stepper.rejections >= 1
    again = Coupled.start()
    fixed = Stepper(mrs.Integrator("bs32", 1.5))  # longer than any of them
    for begin, end in itertools.pairwise([0.0, *steps]):
        _, again = fixed.step(problem, begin, again, end)
    # The sizes are differences of times, rounded.
    np.testing.assert_allclose(again.positions, state.positions, rtol=0, atol=1e-13)


@pytest.mark.parametrize("name", ["euler", "heun", "rk4"])
def test_automatic_steps_are_stable(name):
    """Methods without an error estimate step at the stability limit: the rod comes to rest."""
    sim = small_rod(8, name, 0.1)
    energy = [sim.energy()]
    for t in (1.0, 2.0, 20.0):
        energy.append(sim.run(t).energy())
    assert np.all(np.diff(energy) < 0.0)
    limit = METHODS[name].stability_interval()
    assert 0.5 * limit < sim.stepper.h_lambda < limit


@pytest.mark.parametrize("name", ["euler", "heun", "rk4"])
def test_automatic_steps_follow_motion_without_eigenvalues(name):
    """A tracer in U = (1, 0, 0) has no stability limit; it moves a tenth of its cloud a step."""
    flow = mrs.flows.QuadraticFlow(constant=[1.0, 0.0, 0.0])
    tracers = mrs.Tracers([[0.0, 0, 0], [2.0, 0, 0]])
    integrator = mrs.Integrator(name, "auto")
    sim = mrs.Simulation(mrs.Fluid(background=flow), [tracers], integrator=integrator).run(1.0)
    assert sim.stepper.steps == 5


# --- what is not finite -------------------------------------------------------------------


def poisoned(kind, value):
    """Return a class of bodies whose velocity is `value` at x > 0.5 from the time 0.3 on."""

    class Poisoned(kind):
        def rates(self, time, state, velocity, spin):
            u, w = super().rates(time, state, velocity, spin)
            u[(state.positions[:, 0] > 0.5) & (time > 0.3), 2] = value
            return u, w

    return Poisoned


ALONG = mrs.flows.QuadraticFlow(constant=[0.0, 1.0, 0.0])


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize(
    ("name", "dt"), [*((name, 0.1) for name in METHODS), ("bs32", "auto"), ("rkc2", "auto")]
)
def test_what_is_not_finite_is_named(name, dt, value):
    """Body, node and time: of two bodies the third node of the second one."""
    x = np.array([[0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 2.0, 0.0], [1.0, 3.0, 0.0]])
    bodies = [mrs.Tracers(x[:2], name="dust"), poisoned(mrs.Tracers, value)(x, name="smoke")]
    fluid = mrs.Fluid(background=ALONG)
    sim = mrs.Simulation(fluid, bodies, integrator=mrs.Integrator(name, dt))
    message = r"position of node 2 of 'smoke' is not finite after time 0\.[0-3]"
    with pytest.raises(mrs.SimulationError, match=message):
        sim.run(1.0)
    assert np.isfinite(sim.state.positions).all()


@pytest.mark.parametrize("name", ["euler", "rk4", "rkc2"])
def test_swimmers_that_meet_no_number(name):
    """The same with sums, which refuse what is not finite: still an error of the simulation."""
    kind = poisoned(mrs.Swimmers, np.inf)
    swimmers = kind([[0, 0, 0], [1, 0, 0]], np.eye(3)[:2], length=0.1, force=0.1)
    fluid = mrs.Fluid(1.0, 0.2, ALONG)
    sim = mrs.Simulation(fluid, [swimmers], integrator=mrs.Integrator(name, 0.1))
    with pytest.raises(mrs.SimulationError, match=r"node 1 of 'swimmers' .* after time 0\.[23]"):
        sim.run(1.0)
    assert np.isfinite(sim.state.positions).all()


def test_a_run_that_blows_up():
    """Euler at 50 times its limit: the error names the rod, a node and the time."""
    sim = small_rod(8, mrs.Integrator("euler", 5.0), 0.1)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        with pytest.raises(mrs.SimulationError, match=r"node \d of 'rods' .* after time \d+"):
            sim.run(1e5)
    assert np.ptp(sim.state.positions, axis=0).max() < 3.0, "the last sound state is kept"


@pytest.mark.parametrize("dt", [1e12, "auto"])
def test_rkc2_takes_no_more_stages_than_it_is_stable_with(dt):
    """A rod too stiff for 250 stages: an error of the run, not millions of stages in memory."""
    assert METHODS["rkc2"].stages(np.inf) == METHODS["rkc2"].stages(np.nan) == 250
    line = mrs.geometry.straight(1.0, 8)
    rod = mrs.Rods(line, intrinsic_curvature=STRAIN, **(ROD | {"bending": 1e60}))
    integrator = mrs.Integrator("rkc2", dt)
    sim = mrs.Simulation(mrs.Fluid(1.0, 0.3), [rod], backend="direct", integrator=integrator)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        with pytest.raises(mrs.SimulationError):
            sim.run(1e13)


def test_tolerance_out_of_reach_is_said():
    """Rounding is 1e-16: no step reaches 1e-40, though everything is finite."""
    swimmers = mrs.Swimmers([[0.0, 0, 0], [1, 0, 0]], [[0.0, 0, 1], [0, 1, 0]], length=1, force=1)
    integrator = mrs.Integrator("bs32", tolerance=1e-40)
    sim = mrs.Simulation(mrs.Fluid(epsilon=0.1), [swimmers], integrator=integrator)
    with pytest.raises(mrs.SimulationError, match="tolerance 1e-40"):
        sim.run(1.0)
