"""The no-slip wall: against its oracle, and as the physics of any wall (physics.md 3)."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import mrs
import treecode as tc
from tests.cases import wall_oracle
from tests.test_drag import fibonacci_sphere, sphere_blob
from tests.test_identities import assert_identity, curl, divergence
from tests.test_plugins import bodies_above
from treecode.choice import search

EPSILON, MU = 0.1, 0.7
WALL = tc.Wall(point=(0.0, 0.0, 0.0), normal=(0.0, 0.0, 1.0))
FORCE = tc.RegularizedStokeslet(EPSILON, MU)
FORCE_TORQUE = tc.RegularizedStokesletRotlet(EPSILON, MU)
KERNELS = [FORCE, FORCE_TORQUE, tc.Stokeslet()]
each_kernel = pytest.mark.parametrize("kernel", KERNELS, ids=lambda kernel: type(kernel).__name__)
ON_WALL = np.array([1.0, 1.0, 0.0])


def over_wall(kernel, n, seed, targets=100):
    """Return points in a unit cube that stands on the wall, strengths, and targets there."""
    rng = np.random.default_rng(seed)
    strengths = rng.uniform(-1.0, 1.0, (n, kernel.strength_size))
    return rng.random((n, 3)), strengths, rng.random((targets, 3))


def direct(kernel, points, strengths, targets=None, boundary=WALL):
    return tc.evaluate(kernel, points, strengths, targets, backend="direct", boundary=boundary)


def free(kernel, points, strengths, targets=None):
    return tc.evaluate(kernel, points, strengths, targets, backend="direct")


def exact(kernel, points, strengths, targets):
    """Return the oracle's sum."""
    if isinstance(kernel, tc.Stokeslet):
        return wall_oracle.blake(targets, points, strengths)
    loads = np.zeros((len(points), 6))
    loads[:, : kernel.strength_size] = strengths
    motion = wall_oracle.flow(targets, points, loads, kernel.epsilon, kernel.viscosity)
    return motion[:, : kernel.value_size]


def errors(values, expected):
    """Return the relative errors, K eq. (8.1), of velocities and of angular velocities."""
    assert values.shape == expected.shape
    parts = np.split(values, [3], axis=1), np.split(expected, [3], axis=1)
    return [tc.relative_error(a, b) for a, b in zip(*parts, strict=True) if a.size]


# --- direct sums ----------------------------------------------------------------------------------


@each_kernel
def test_is_the_oracle(kernel):
    """Any points, some of them on the wall, moved in one plan; targets apart, and the sources."""
    plan = tc.Plan(kernel, "direct", boundary=WALL)
    for seed in (0, 1):
        points, strengths, targets = over_wall(kernel, 200, seed)
        points[:5] *= ON_WALL
        values = plan.set_points(points, targets).execute(strengths)
        assert max(errors(values, exact(kernel, points, strengths, targets))) <= 1e-12
        double = plan.execute(2.0 * strengths)
        np.testing.assert_array_equal(double, 2.0 * values)  # exact in binary numbers
    at_sources = plan.set_points(points).execute(strengths)
    assert max(errors(at_sources, exact(kernel, points, strengths, points))) <= 1e-12


@pytest.mark.parametrize("epsilon", [1e-3, 0.3, 10.0])
def test_any_blob(epsilon):
    """Blobs much smaller and much larger than the heights of their points."""
    kernel = tc.RegularizedStokesletRotlet(epsilon, MU)
    points, strengths, targets = over_wall(kernel, 200, seed=2)
    values = direct(kernel, points, strengths, targets)
    # Of a blob that is 10 heights wide the images leave (h / eps)^2 = 1e-2 of u and of w.
    assert max(errors(values, exact(kernel, points, strengths, targets))) <= 1e-12


@each_kernel
def test_nothing_moves_on_the_wall(kernel):
    """There the fluid neither flows nor turns about the normal."""
    points, strengths, targets = over_wall(kernel, 200, seed=3)
    at_wall = direct(kernel, points, strengths, targets * ON_WALL)
    without = free(kernel, points, strengths, targets * ON_WALL)
    assert np.abs(at_wall[:, :3]).max() <= 1e-12 * np.abs(without[:, :3]).max()
    if kernel is FORCE_TORQUE:
        assert np.abs(at_wall[:, 5]).max() <= 1e-12 * np.abs(without[:, 5]).max()


# Turns of the normal to -z, to x and to anywhere.
TURNS = [
    Rotation.from_euler("x", 180.0, degrees=True),
    Rotation.from_euler("y", 90.0, degrees=True),
    Rotation.random(rng=np.random.default_rng(4)),
]


@each_kernel
@pytest.mark.parametrize("turn", TURNS, ids=["down", "along_x", "any"])
@pytest.mark.parametrize("length", [1.0, 1e-3, 70.0])
def test_any_plane(kernel, turn, length):
    """Walls that are turned and shifted have the flow turned; the length of a normal is nothing."""
    points, strengths, targets = over_wall(kernel, 100, seed=5)
    points[:, 2] += 0.01
    targets[:, 2] += 0.01
    Q, shift = turn.as_matrix(), np.array([0.3, -2.0, 1.1])

    def turned(rows):
        return (rows.reshape(len(rows), -1, 3) @ Q.T).reshape(rows.shape)

    wall = tc.Wall(point=shift + Q[:, 0], normal=length * Q[:, 2])
    places = turned(points) + shift, turned(strengths), turned(targets) + shift
    values = direct(kernel, *places, boundary=wall)
    # Shifted coordinates are rounded by 2^-53 of 2, at heights and distances down to 0.01.
    assert max(errors(values, turned(direct(kernel, points, strengths, targets)))) <= 1e-12


def test_far_above_the_wall():
    """It changes velocities by the order a/h of themselves, h the height; angular ones by (a/h)^3.

    No force turns its own point at the order 1/h^2: forces a/h aside and torques do at 1/h^3.
    """
    points, strengths, targets = over_wall(FORCE_TORQUE, 50, seed=6)

    def change(height):
        up = np.array([0.0, 0.0, height])
        values = direct(FORCE_TORQUE, points + up, strengths, targets + up)
        return np.array(errors(values, free(FORCE_TORQUE, points, strengths, targets)))

    changes = np.array([change(height) for height in (100.0, 200.0, 400.0)])
    orders = np.log2(changes[:-1] / changes[1:])
    # The next terms are a/h of the first, some 1e-2 and 5e-3, of which half remains in an order.
    np.testing.assert_allclose(orders, [[1.0, 3.0]] * 2, rtol=0, atol=0.02)
    assert changes[0, 0] <= 1e-2


def test_mobility_is_symmetric_positive_definite():
    """The 6N x 6N matrix from unit loads, of points half an epsilon and more above the wall."""
    points, _, _ = over_wall(FORCE_TORQUE, 12, seed=7)
    points[:, 2] += 0.5 * EPSILON
    points[:3, 2] = 0.5 * EPSILON
    plan = tc.Plan(FORCE_TORQUE, "direct", boundary=WALL).set_points(points)
    mobility = np.array([plan.execute(e.reshape(12, 6)).ravel() for e in np.eye(72)])
    # Scaled to a unit diagonal: torques move particles eps^-2 times more than forces.
    scale = 1.0 / np.sqrt(np.diag(mobility))
    mobility = scale[:, None] * mobility * scale
    np.testing.assert_allclose(mobility, mobility.T, rtol=0, atol=1e-14)
    assert np.linalg.eigvalsh(mobility).min() > 1e-3


@pytest.mark.parametrize("columns", [slice(0, 3), slice(3, 6)], ids=["force", "torque"])
def test_half_the_curl_and_no_divergence(columns):
    """From velocities at displaced targets, for blobs as wide as those of test_identities."""
    kernel = tc.RegularizedStokesletRotlet(1.0, MU)
    points, strengths, targets = over_wall(kernel, 8, seed=8, targets=20)
    targets[:, 2] += 0.3  # more than differences reach down
    acting = np.zeros_like(strengths)
    acting[:, columns] = strengths[:, columns]
    slope = direct(kernel, points, acting, targets)[:, 3:]

    def velocity(x):
        return direct(kernel, points, acting, x)[:, :3]

    assert_identity(lambda h: 0.5 * curl(velocity, targets, h) - slope, slope)
    assert_identity(lambda h: divergence(velocity, targets, h), slope)


# --- spheres --------------------------------------------------------------------------------------

SPHERE = fibonacci_sphere(200)


def drag(height=0.0, **options):
    """Return the drag on a sphere of blobs, (3,), along the axes, over 6 pi mu a U."""
    n = len(SPHERE)
    points = SPHERE.copy()
    points[:, 2] += height
    kernel = tc.RegularizedStokeslet(sphere_blob(n))
    plan = tc.Plan(kernel, "direct", **options).set_points(points)
    mobility = np.array([plan.execute(e.reshape(n, 3)).ravel() for e in np.eye(3 * n)])
    forces = np.linalg.solve(mobility, np.tile(np.eye(3), (n, 1)))
    return np.diag(forces.reshape(n, 3, 3).sum(axis=0)) / (6.0 * np.pi)


def test_drag_near_the_wall():
    """Lorentz and Faxen: 1 + 9/16 a/h along the wall and 1 + 9/8 a/h towards it, and more terms.

    A sphere of blobs has the drag of one of radius 1.0067, which is `a` here, and moments of other
    spheres, 1 to 2 percent larger: of the terms in (a/h)^3, 1/8 and 1/2, this is 0.03 at most.
    """
    alone = drag()
    for k in (0.1, 0.2):
        along_x, along_y, across = alone / drag(alone.mean() / k, boundary=WALL)
        parallel = 1.0 - 9 / 16 * k + 1 / 8 * k**3 - 45 / 256 * k**4 - 1 / 16 * k**5
        perpendicular = 1.0 - 9 / 8 * k + 1 / 2 * k**3 - 57 / 100 * k**4 + 1 / 5 * k**5
        expected = [parallel, parallel, perpendicular]
        np.testing.assert_allclose([along_x, along_y, across], expected, rtol=0, atol=0.03 * k**3)


# --- fast sums ------------------------------------------------------------------------------------


FAST = [("kitc", {"leaf_size": 100}, kernel) for kernel in KERNELS] + [("fmm", {}, FORCE)]


@pytest.mark.parametrize(
    ("backend", "options", "kernel"), FAST, ids=[f"{f[0]}-{type(f[2]).__name__}" for f in FAST]
)
def test_nothing_moves_on_the_wall_by_fast_sums(backend, options, kernel):
    """Within the tolerance, relative to the flow at the other targets."""
    tol = 1e-5
    points, strengths, targets = over_wall(kernel, 2000, seed=9, targets=1000)
    targets[500:] *= ON_WALL
    plan = tc.Plan(kernel, backend, tol=tol, boundary=WALL, **options).set_points(points, targets)
    values = plan.execute(strengths)
    assert max(errors(values, direct(kernel, points, strengths, targets))) <= tol
    assert np.linalg.norm(values[500:, :3]) <= tol * np.linalg.norm(values[:500, :3])


BACKENDS = ["auto"] * 5 + ["kitc"] * 5 + ["fmm"] * 2


def random_case(seed):
    """Return backend, kernel, points, strengths and tolerance; sizes uniform in their logarithms.

    For fmm forces alone, to 1e-4: operators of more channels or digits take minutes to build.
    """
    backend = BACKENDS[seed]
    rng = np.random.default_rng([seed, 3])
    n = int(300.0 * 10.0 ** rng.random())
    epsilon = 0.3 * 10.0 ** rng.uniform(np.log10(1e-3 / 0.3), 0.0)
    points = rng.random((n, 3)) * [1.0, 1.0, (1.0, 0.02)[seed % 2]]  # a cube or a carpet
    kernels = [tc.RegularizedStokeslet(epsilon)]
    if backend != "fmm":
        kernels += [tc.RegularizedStokesletRotlet(epsilon), tc.Stokeslet()]
    kernel = kernels[seed % len(kernels)]
    tol = 10.0 ** rng.uniform(-4.0 if backend == "fmm" else -8.0, -3.0)
    return backend, kernel, points, rng.standard_normal((n, kernel.strength_size)), tol


@pytest.mark.parametrize("seed", range(len(BACKENDS)))
def test_reaches_what_is_asked(monkeypatch, seed):
    """Error of velocities and of angular velocities from direct sums, cubes and flat carpets."""
    monkeypatch.setattr(search, "FEW", 0)
    backend, kernel, points, strengths, tol = random_case(seed)
    values = tc.evaluate(kernel, points, strengths, backend=backend, tol=tol, boundary=WALL)
    assert max(errors(values, direct(kernel, points, strengths))) <= tol


# --- simulations ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("backend", "error"), [("direct", 1e-12), (mrs.Backend("auto", tolerance=1e-6), 1e-5)]
)
def test_bodies_over_a_wall(backend, error):
    """A rod, a swimmer and a tracer move as their loads make them by the oracle."""
    sim = mrs.Simulation(mrs.Fluid(MU, boundary=WALL), bodies_above(), backend=backend)
    points, loads = sim.now.points, sim.now.loads
    rod, swimmer = slice(0, 7), slice(7, 9)
    motion = sum(
        wall_oracle.flow(points, points[body], loads[body], epsilon, MU)
        for body, epsilon in ((rod, 0.15), (swimmer, 0.1))
    )
    for rows, columns in ((slice(None), slice(0, 3)), (rod, slice(3, 6))):
        expected = motion[rows, columns]
        size = np.abs(expected).max()
        np.testing.assert_allclose(sim.now.motion[rows, columns], expected, atol=error * size)
    on_wall = np.random.default_rng(11).random((50, 3)) * ON_WALL
    assert np.abs(sim.velocity(on_wall)).max() <= error * np.abs(motion[:, :3]).max()


# --- refusals -------------------------------------------------------------------------------------

BELOW = np.array([[0.5, 0.5, 1.0]] * 5)
BELOW[3, 2] = -0.25


@pytest.mark.parametrize("name", ["sources", "targets"])
def test_points_below_the_wall_are_refused(name):
    """By name and row; the plan keeps the points that it had."""
    points, strengths, targets = over_wall(FORCE, 20, seed=12)
    plan = tc.Plan(FORCE, "direct", boundary=WALL).set_points(points, targets)
    values = plan.execute(strengths)
    told = rf"^{name} must be in the fluid, within Wall.* got row 3, \(0\.5, 0\.5, -0\.25\)"
    with pytest.raises(ValueError, match=told):
        plan.set_points(**{"sources": points, "targets": targets, name: BELOW})
    np.testing.assert_array_equal(plan.execute(strengths), values)


@pytest.mark.parametrize("name", ["points", "targets"])
def test_evaluate_refuses_by_the_name_that_was_typed(name):
    given = {"points": np.ones((5, 3)), "targets": np.ones((5, 3)), name: BELOW}
    with pytest.raises(ValueError, match=rf"^{name} must be in the fluid, within Wall.* got row 3"):
        tc.evaluate(FORCE, strengths=np.ones((5, 3)), boundary=WALL, **given)


def test_the_side_of_the_fluid_is_that_of_the_normal():
    """The same points lie below the wall whose normal is the opposite one."""
    ceiling = tc.Wall(point=(0.0, 0.0, 0.0), normal=(0.0, 0.0, -1.0))
    with pytest.raises(ValueError, match=r"^sources must be in the fluid, within Wall.* got row 0"):
        tc.Plan(FORCE, "direct", boundary=ceiling).set_points(BELOW)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("normal", (0.0, 0.0, 0.0)),
        *[
            (name, value)
            for name in ("point", "normal")
            for value in ((0.0, np.nan, 1.0), (np.inf, 0.0, 1.0), (0.0, 1.0), [[0.0, 0.0, 1.0]])
        ],
        *[(name, value) for name in ("point", "normal") for value in (None, "up", 1.0, (0, 0, 1j))],
    ],
)
def test_arguments_of_a_wall(name, value):
    with pytest.raises((TypeError, ValueError), match=f"^{name} must"):
        tc.Wall(**{"point": (0.0, 0.0, 0.0), "normal": (0.0, 0.0, 1.0), name: value})


@pytest.mark.parametrize("value", ["wall", 3, tc.Wall])
def test_a_boundary_is_refused_by_name(value):
    with pytest.raises(TypeError, match=r"^boundary must be a treecode\.Boundary, got"):
        tc.Plan(FORCE, boundary=value)


def test_a_kernel_without_a_wall():
    """Images of stresslets are not known to it."""
    with pytest.raises(ValueError, match="StokesletStresslet"):
        direct(tc.StokesletStresslet(), np.ones((5, 3)), np.ones((5, 9)))


@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_singular_sources_on_a_tilted_wall(precision):
    """They are on it but for rounding, and have no flow: an image that was off by it made 1e16."""
    rng = np.random.default_rng(14)
    wall = tc.Wall((0.3, -1.1, 0.7), (1.0, 2.0, -0.5))
    points, forces = rng.random((60, 3)) @ wall.frame + wall.point, rng.standard_normal((60, 3))
    points[:20] -= np.outer(wall.heights(points[:20]), wall.normal)
    options = {"backend": "direct", "boundary": wall, "precision": precision}
    flow = tc.evaluate(tc.Stokeslet(), points, forces, **options)
    without = tc.evaluate(tc.Stokeslet(), points[20:], forces[20:], points, **options)
    size = np.abs(forces).max() / np.abs(wall.heights(points[20:])).mean()
    error = {"float64": 1e-12, "float32": 1e-5}[precision]
    np.testing.assert_allclose(flow, without, atol=error * size * len(points))


@pytest.mark.parametrize("kernel", [FORCE, tc.Stokeslet()])
def test_taylor_converges(kernel):
    """Errors of forces over a wall fall as 0.6^p for theta = 0.5, or faster."""
    points, strengths, _ = over_wall(kernel, 2000, seed=13)
    exact = direct(kernel, points, strengths)
    options = {"backend": "taylor", "theta": 0.5, "leaf_size": 100, "boundary": WALL}
    found = [
        tc.relative_error(tc.evaluate(kernel, points, strengths, degree=p, **options), exact)
        for p in (1, 3, 5)
    ]
    assert found[1] < 0.6**2 * found[0]
    assert found[2] < 0.6**2 * found[1]
    assert found[2] > 1e-6  # expansions were used


def test_taylor_says_why_not():
    """The correction of torques has no Taylor coefficients."""
    with pytest.raises(ValueError, match=r"backend must be 'direct', 'kitc', 'fmm' or 'auto'"):
        tc.Plan(FORCE_TORQUE, "taylor", boundary=WALL)
