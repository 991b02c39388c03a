"""Methods and steps: orders, stability, triads, step sizes, and what ends a run."""

import itertools
import warnings

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import mrs
from mrs import rotations
from mrs.time.integrators import METHODS, Problem, Tableau
from mrs.time.integrators.runge_kutta import BOGACKI_SHAMPINE, HEUN, RK4, rooted_trees
from mrs.time.state import State
from mrs.time.stepper import Stepper
from tests.cases import rod_oracle as oracle

ORDERS = {"euler": 1, "heun": 2, "rkc2": 2, "bs32": 3, "rk4": 4}
each_method = pytest.mark.parametrize("name", ORDERS)


# --- problems ----------------------------------------------------------------------------


class Coupled:
    """Two points and a triad that drive each other, nonlinearly and in time."""

    error_scale = np.ones((3, 1))
    perturbation = 1e-6 * np.ones((3, 1))

    @staticmethod
    def motion(t, X, D):
        """Return velocities, (2, 3), and the angular velocity, (1, 3)."""
        u0 = D[0, 2] + 0.5 * np.sin(2 * t) * X[1]
        u1 = np.cross(D[0, 0], X[0]) - 0.3 * X[1] * (X[0] @ X[0])
        w = X[0] + 2.0 * np.cos(t) * D[0, 1] + (X[1] @ D[0, 2]) * D[0, 0]
        return np.array([u0, u1]), np.array([w])

    def rates(self, t, state):
        return np.concatenate(self.motion(t, state.positions, oracle.triads(state.quaternions)))

    @staticmethod
    def start():
        x = np.array([[0.3, -0.2, 0.5], [0.1, 0.4, -0.6]])
        return State(x, Rotation.from_rotvec([[0.4, -0.3, 0.8]]).as_quat())

    def exact(self, t):
        start = self.start()
        return oracle.integrate(self.motion, start.positions, oracle.triads(start.quaternions), t)


def advance(stepper, problem, state, t_end):
    t = 0.0
    while t < t_end:
        t, state = stepper.step(problem, t, state, t_end)
    return state


def difference(state, exact):
    """Return the largest difference of positions and of triads from (X, D)."""
    X, D = exact
    triads = oracle.triads(state.quaternions)
    return max(np.abs(state.positions - X).max(), np.abs(triads - D).max())


def assert_order(name, error, finest, halvings=2, slack=0.06):
    """Assert that error(dt) falls with the order of the method, at dt = 4, 2, 1 times `finest`.

    The next term of the error is smaller by a factor of the size of dt, here 1/80 to 1/4 of a unit
    of time; it shifts an observed order by 0.04 at most.
    """
    errors = [error(finest * 2**k) for k in range(halvings, -1, -1)]
    assert METHODS[name].order == ORDERS[name]
    np.testing.assert_allclose(oracle.orders(errors), ORDERS[name], atol=slack)


@each_method
def test_order_with_triads(name):
    exact = Coupled().exact(1.0)

    def error(dt):
        stepper = Stepper(mrs.Integrator(name, dt))
        return difference(advance(stepper, Coupled(), Coupled.start(), 1.0), exact)

    assert_order(name, error, 1 / 320 if name == "euler" else 1 / 80)


@each_method
def test_order_of_swimmers(name):
    """Two swimmers, one of them rather near: against DOP853 on the oracle."""
    x = np.array([[0.0, 0.0, 0.0], [0.4, 0.3, 0.1]])
    p = np.array([[0.0, 0.0, 1.0], [0.0, 0.6, 0.8]])
    one = np.ones(2)
    exact, _ = oracle.swim(x, p, 1.0, one, one, 1.0, np.full(4, 0.3))

    def error(dt):
        swimmers = mrs.Swimmers(x, p, length=1, force=1)
        sim = mrs.Simulation(
            mrs.Fluid(1.0, 0.3), [swimmers], backend="direct", integrator=mrs.Integrator(name, dt)
        )
        return np.abs(sim.run(1.0).state.positions - exact).max()

    assert_order(name, error, 1 / 80 if name == "euler" else 1 / 16)


ROD = {"bending": 0.02, "twisting": 0.03, "shearing": 0.3, "stretching": 0.4}
STRAIN = np.array([1.0, 0.0, 2.0])


def small_rod(nodes, integrator, noise=0.0, seed=0, **options):
    """Return a simulation of a straight rod that wants to be a helix."""
    line = mrs.geometry.straight(0.2 * (nodes - 1), nodes)
    rod = mrs.Rods(line, intrinsic_curvature=STRAIN, **ROD)
    sim = mrs.Simulation(
        mrs.Fluid(1.0, 0.3), [rod], backend="direct", integrator=integrator, **options
    )
    rng = np.random.default_rng(seed)
    turned = Rotation.from_rotvec(noise * rng.normal(size=(nodes, 3))).as_quat()
    sim.state = State(line.nodes + 0.2 * noise * rng.normal(size=(nodes, 3)), turned)
    return sim


def rod_motion(t, X, D):
    """Return the oracle's velocities and angular velocities of `small_rod`."""
    segments = len(X) - 1
    a, b = np.array([0.02, 0.02, 0.03]), np.array([0.3, 0.3, 0.4])
    f, n = oracle.rod_loads(X, D, np.full(segments, 0.2), a, b, np.tile(STRAIN, (segments, 1)))
    return oracle.flow(X, np.full(len(X), 0.3), f, n, X)


@pytest.fixture(scope="module")
def relaxed():
    """Return the oracle's rod of 5 nodes at time 0.4."""
    start = small_rod(5, "euler", 0.1).state
    return oracle.integrate(rod_motion, start.positions, oracle.triads(start.quaternions), 0.4)


@each_method
def test_order_of_a_rod(name, relaxed):
    """Against DOP853 on the oracle."""

    def error(dt):
        return difference(small_rod(5, mrs.Integrator(name, dt), 0.1).run(0.4).state, relaxed)

    assert_order(name, error, 1 / 320 if name == "euler" else 1 / 80)


# --- methods ------------------------------------------------------------------------------


def pendulum(t, z):
    return np.stack([z[1], -np.sin(z[0]) + 0.3 * np.cos(2 * t) - 0.2 * z[1]])


def one_step(method, f, t, z, h, stages=2):
    """Return z at t + h, and the error estimate; `stages` is how many RKC is to take."""
    radius = ((stages - 0.5) ** 2 - 1.0) / 1.54 / (1.1 * h)  # SSV eq. 2.5, and the code's margin
    if method.name == "rkc2":
        assert method.stages(1.1 * h * radius) == stages
    return method.step(Problem(f, f(t, z), radius), t, z, h, method.init(z))[:2]


def fixed_steps(method, stages, f, z, steps):
    """Return z at t = 1, and the last error estimate."""
    h, estimate = 1.0 / steps, None
    for i in range(steps):
        z, estimate = one_step(method, f, i * h, z, h, stages)
    return z, estimate


@pytest.mark.parametrize("stages", [2, 3, 6, 13, 40])
def test_rkc2_is_of_second_order_with_any_number_of_stages(stages):
    start = np.array([[1.0], [0.5]])
    exact, _ = fixed_steps(RK4, 4, pendulum, start, 2000)  # errs by 1e-14
    runs = [fixed_steps(METHODS["rkc2"], stages, pendulum, start, n) for n in (20, 40, 80)]
    errors = [np.abs(z - exact).max() for z, _ in runs]
    np.testing.assert_allclose(oracle.orders(errors), 2.0, atol=0.1)


@pytest.mark.parametrize("name", ["bs32", "rkc2"])
def test_error_estimates_are_of_third_order_in_the_step(name):
    """That of one step, of a second order solution; the step size controller counts on it."""
    method, start = METHODS[name], np.array([[1.0], [0.5]])
    estimates = [
        np.abs(one_step(method, pendulum, 0.0, start, h, 5)[1]).max() for h in (0.04, 0.02, 0.01)
    ]
    assert method.error_order == 2
    np.testing.assert_allclose(oracle.orders(estimates), 3.0, atol=0.15)


def amplification(name, x, stages=2):
    """Return R(-x) of one step, for an array of x."""
    factors, _ = one_step(METHODS[name], lambda t, z: -x * z, 0.0, np.ones_like(x), 1.0, stages)
    return factors


@pytest.mark.parametrize(
    ("name", "interval"),
    [("euler", 2.0), ("heun", 2.0), ("rk4", 2.785293563), ("bs32", 2.512745327)],
)
def test_stability_interval(name, interval):
    """Textbook numbers; within them no mode grows, beyond them one does."""
    assert METHODS[name].stability_interval() == pytest.approx(interval, rel=1e-9)
    inside = amplification(name, np.linspace(0.0, interval * (1 - 1e-9), 1000))
    assert np.abs(inside).max() <= 1.0 + 1e-15
    assert np.abs(amplification(name, np.array([interval * 1.001]))).min() > 1.0


@pytest.mark.parametrize("h_lambda", [0.0, 1e-3, 0.5, 1.0, 3.0, 10.0, 77.0, 274.0, 1e3, 9e3, 4e4])
def test_rkc2_is_stable_with_the_stages_it_takes(h_lambda):
    """On all of [0, h lambda], and damped by SSV's two thirds on most of it."""
    rkc2 = METHODS["rkc2"]
    stages = rkc2.stages(h_lambda)
    estimate = np.sqrt(1.0 + 1.54 * h_lambda)
    assert stages == 2 or 0.0 <= stages - estimate <= 1.0
    factors = amplification("rkc2", np.linspace(0.0, h_lambda, 5001), stages)
    # Rounding grows as the square of the number of stages.
    assert np.abs(factors).max() <= 1.0 + 1e-15 * stages**2
    # Damping 2/13: beyond the first mode |R| stays below 1 - (2/13) / 3 of SSV.
    rest = factors[np.linspace(0.0, h_lambda, 5001) > 5.0]
    assert np.abs(rest).max(initial=0.0) <= 1.0 - 0.9 * (2 / 13) / 3
    assert rkc2.stages(rkc2.stability_interval()) >= 250


def test_rooted_trees():
    """As many as there are order conditions (Hairer, Norsett & Wanner I, table II.2.3)."""
    assert [len(list(rooted_trees(n))) for n in range(1, 8)] == [1, 1, 2, 4, 9, 20, 48]


@pytest.mark.parametrize("method", [HEUN, RK4, BOGACKI_SHAMPINE], ids=lambda m: m.name)
def test_wrong_coefficients_are_refused(method):
    """Any single coefficient that is off by 1e-6 breaks an order condition."""
    tried = 0
    for field in ("a", "b", "embedded"):
        rows = [getattr(method, field) or ()] if field != "a" else method.a
        for i, row in enumerate(rows):
            for j in range(len(row)):
                off = tuple(v + 1e-6 * (k == j) for k, v in enumerate(row))
                changed = off if field != "a" else (*method.a[:i], off, *method.a[i + 1 :])
                own = {k: getattr(method, k) for k in ("name", "order", "a", "b", "embedded")}
                with pytest.raises(ValueError, match="not of order"):
                    Tableau(**(own | {field: changed}))
                tried += 1
    assert tried >= 3


def test_other_tableaus():
    """The 3/8 rule is of order 4 and passes; a method that claims more than it has does not."""
    a = ((), (1 / 3,), (-1 / 3, 1.0), (1.0, -1.0, 1.0))
    b = (1 / 8, 3 / 8, 3 / 8, 1 / 8)
    assert Tableau("3/8", 4, a, b).stability_interval() == pytest.approx(2.785293563, rel=1e-9)
    with pytest.raises(ValueError, match="3/8: not of order 5"):
        Tableau("3/8", 5, a, b)
    with pytest.raises(ValueError, match="as many rows"):
        Tableau("short", 2, a, b[:3])
    with pytest.raises(ValueError, match="embedded must be as long as b"):
        Tableau("short", 2, a, b, embedded=(1.0,))


# --- triads -------------------------------------------------------------------------------


@each_method
def test_triads_stay_orthonormal(name):
    """After 1000 large steps: they are quaternions of unit length, whatever the method does."""
    stepper = Stepper(mrs.Integrator(name, 0.2))
    state = Coupled.start()
    for _ in range(1000):
        _, state = stepper.step(_Spinning(), 0.0, state, 0.2)
    D = rotations.axes(state.quaternions)[0]
    np.testing.assert_allclose(D @ D.T, np.eye(3), rtol=0, atol=1e-12)
    assert np.linalg.det(D) == pytest.approx(1.0, abs=1e-12)


class _Spinning(Coupled):
    """A triad that turns by some two radians a step, about an axis that turns with it."""

    def rates(self, t, state):
        D = oracle.triads(state.quaternions)[0]
        return np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], 8.0 * D[0] + np.array([3.0, -5.0, 4.0])])


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


class _Burst:
    """A point at rest until t = 1, which then begins to shake."""

    error_scale = perturbation = np.ones((1, 1))

    def rates(self, t, state):
        return np.array([[0.0, 0.0, 50.0 * np.cos(50.0 * t) * (t > 1.0)]]) - 0.0 * state.positions


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


# --- eigenvalues --------------------------------------------------------------------------


def jacobian(sim):
    """Return the derivative of the rates by local coordinates, by central differences."""
    state, z = sim.state, sim.state.coordinates()
    columns = []
    for i in range(z.size):
        step = np.zeros(z.size)
        step[i] = 1e-5
        ends = [z + sign * step.reshape(z.shape) for sign in (1, -1)]
        plus, minus = (state.local_rates(y, sim.scene.rates(0.0, state.moved(y))) for y in ends)
        columns.append((plus - minus).ravel() / 2e-5)
    return np.array(columns).T


@pytest.mark.parametrize("seed", range(5))
def test_spectral_radius(seed):
    """Power iteration against dense eigenvalues: from below, and within the margin of 1.1."""
    sim = small_rod(10, mrs.Integrator("rkc2", 1e-3), 0.2, seed)
    largest = np.abs(np.linalg.eigvals(jacobian(sim))).max()
    sim.step(1e-3)
    assert sim.stepper.radius * 1.1 >= largest
    assert sim.stepper.radius <= 1.01 * largest


@pytest.mark.parametrize("strain", [np.zeros(3), STRAIN], ids=["straight", "helix"])
def test_eigenvalues_at_rest_are_real_and_negative(strain):
    """The mobility is positive definite and the elastic energy has a minimum at rest.

    Six are zero: rigid motions. (The discrete torques of a curved rod are the gradient of its
    energy only up to ds^2; at twice this ds one close pair of the helix is complex, by 2e-3.)
    """
    line = mrs.geometry.at_rest(strain, 0.1, 15)
    rod = mrs.Rods(line, intrinsic_curvature=strain, **ROD)
    sim = mrs.Simulation(mrs.Fluid(1.0, 0.3), [rod], backend="direct")
    values = np.linalg.eigvals(jacobian(sim))
    values = values[np.argsort(-values.real)] / np.abs(values).max()
    # Differences over 1e-5 of numbers with 16 digits are good to 1e-10, times the norm of the
    # inverse of the eigenvectors (about 50). The slowest bending mode is at 2e-3.
    assert np.abs(values.imag).max() <= 1e-8
    assert np.abs(values[:6]).max() <= 1e-8
    assert values[6:].real.max() <= -1e-3


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
    ("name", "dt"), [*((name, 0.1) for name in ORDERS), ("bs32", "auto"), ("rkc2", "auto")]
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


@pytest.mark.parametrize("name", ["euler", "heun", "rk4"])
def test_automatic_steps_follow_motion_without_eigenvalues(name):
    """A tracer in U = (1, 0, 0) has no stability limit; it moves a tenth of its cloud a step."""
    flow = mrs.flows.QuadraticFlow(constant=[1.0, 0.0, 0.0])
    tracers = mrs.Tracers([[0.0, 0, 0], [2.0, 0, 0]])
    integrator = mrs.Integrator(name, "auto")
    sim = mrs.Simulation(mrs.Fluid(background=flow), [tracers], integrator=integrator).run(1.0)
    assert sim.stepper.steps == 5
