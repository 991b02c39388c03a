"""Methods of time stepping: orders, stability, coefficients, and triads that stay orthonormal."""

import numpy as np
import pytest

import mrs
from mrs import rotations
from mrs.time.integrators import METHODS, Problem, Tableau
from mrs.time.integrators.runge_kutta import BOGACKI_SHAMPINE, HEUN, RK4, rooted_trees
from mrs.time.stepper import Stepper
from tests.cases import rod_oracle as oracle
from tests.cases.linearization import jacobian
from tests.cases.motions import ROD, STRAIN, Coupled, advance, small_rod

ORDERS = {"euler": 1, "heun": 2, "rkc2": 2, "bs32": 3, "rk4": 4}
each_method = pytest.mark.parametrize("name", ORDERS)


# --- orders -------------------------------------------------------------------------------


def difference(state, exact):
    """Return the largest difference of positions and of triads from (X, D)."""
    X, D = exact
    triads = oracle.triads(state.quaternions)
    return max(np.abs(state.positions - X).max(), np.abs(triads - D).max())


def assert_order(name, error, finest):
    """Assert that error(dt) falls with the order of the method, at dt = 4, 2, 1 times `finest`.

    The next term of the error is smaller by a factor of the size of dt, here 1/80 to 1/4 of a unit
    of time; it shifts an observed order by 0.04 at most.
    """
    errors = [error(finest * 2**k) for k in (2, 1, 0)]
    assert METHODS[name].order == ORDERS[name]
    np.testing.assert_allclose(oracle.orders(errors), ORDERS[name], atol=0.06)


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
    return method.step(Problem(f, lambda: f(t, z), radius), t, z, h, method.init(z))[:2]


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

    def rates(self, t, state, near=None):
        D = oracle.triads(state.quaternions)[0]
        return np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], 8.0 * D[0] + np.array([3.0, -5.0, 4.0])])


# --- eigenvalues --------------------------------------------------------------------------


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
