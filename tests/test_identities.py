"""The sums obey Stokes' equations, on the library's own values (physics.md 2)."""

import numpy as np
import pytest

import treecode as tc
from tests.cases.oracle import KERNELS, UNIT, each_backend, each_kernel, random_case, with_epsilon

EPSILON, MU = 1.0, 0.7
FORCE_TORQUE = tc.RegularizedStokesletRotlet(EPSILON, MU)
FORCE = tc.RegularizedStokeslet(EPSILON, MU)
# Central differences of eighth order: weights of f(x + k h) - f(x - k h), and of their sum.
FIRST = np.array([4 / 5, -1 / 5, 4 / 105, -1 / 280])
SECOND = np.array([8 / 5, -1 / 5, 8 / 315, -1 / 560])
ORDER = 8
# Fields vary over EPSILON: differences over 0.06 err by some 1e-6, over 0.02 by 1e-10, and there
# rounding adds 1e-15 / 0.02 to a first and 1e-15 / 0.02^2 to a second derivative.
STEPS = (0.06, 0.03)
SMALL_STEP = 0.02
ASIDE = np.array([3.0, 0.0, 0.0])  # out of the cube that holds the sources
LEVI_CIVITA = np.zeros((3, 3, 3))
LEVI_CIVITA[[0, 1, 2], [1, 2, 0], [2, 0, 1]] = 1.0
LEVI_CIVITA[[0, 1, 2], [2, 0, 1], [1, 2, 0]] = -1.0


@pytest.fixture(scope="module")
def case():
    """Return a few sources, their forces and torques, and targets among them."""
    return random_case(FORCE_TORQUE, 8, seed=0, targets=20)


def shifted(field, x, h):
    """Return ``field(x +- k h e_d)``: axes sign, k, d, target, component."""
    steps = h * np.einsum("s,k,de->skde", [1.0, -1.0], np.arange(1.0, 5.0), np.eye(3))
    points = x + steps[..., None, :]
    return field(points.reshape(-1, 3)).reshape((*points.shape[:-1], -1))


def gradient(field, x, h):
    """Return d field_c / dx_d by differences of eighth order, axes d, target, c."""
    plus, minus = shifted(field, x, h)
    return np.einsum("k,kdmc->dmc", FIRST, plus - minus) / h


def laplacian(field, x, h):
    plus, minus = shifted(field, x, h)
    center = 2.0 * field(x)
    return np.einsum("k,kdmc->mc", SECOND, plus + minus - center) / h**2


def curl(field, x, h):
    return np.einsum("cde,dme->mc", LEVI_CIVITA, gradient(field, x, h))


def divergence(field, x, h):
    return np.einsum("dmd->m", gradient(field, x, h))[:, None]


def assert_identity(residual, scale):
    """Assert that `residual` of h falls with the order of the differences, and to 1e-9 `scale`."""
    coarse, fine = (np.linalg.norm(residual(h)) for h in STEPS)
    # Two tenths are for the next term of the series, of a relative (h / EPSILON)^2 times some 30.
    assert abs(np.log2(coarse / fine) - ORDER) <= 0.2
    assert np.linalg.norm(residual(SMALL_STEP)) <= 1e-9 * np.linalg.norm(scale)


def velocity(case, kernel=FORCE_TORQUE, columns=slice(0, 6)):
    """Return x -> u(x) for the strengths in `columns`."""
    points, strengths, _ = case
    kept = np.zeros_like(strengths)
    kept[:, columns] = strengths[:, columns]
    kept = kept[:, : kernel.strength_size]
    return lambda x: tc.evaluate(kernel, points, kept, x, backend="direct")[:, :3]


@pytest.mark.parametrize("columns", [slice(0, 3), slice(3, 6)], ids=["force", "torque"])
def test_angular_velocity_is_half_the_curl(case, columns):
    """Angular velocity w = 1/2 curl u, for forces and for torques."""
    points, strengths, x = case
    kept = np.zeros_like(strengths)
    kept[:, columns] = strengths[:, columns]
    w = tc.evaluate(FORCE_TORQUE, points, kept, x, backend="direct")[:, 3:]
    assert_identity(lambda h: 0.5 * curl(velocity(case, columns=columns), x, h) - w, w)


def test_rotlet_is_half_the_curl_of_the_stokeslet(case):
    """The velocity of torques n is half the curl of the velocity of forces n."""
    points, strengths, x = case
    torques = strengths.copy()
    torques[:, :3] = 0.0
    u = tc.evaluate(FORCE_TORQUE, points, torques, x, backend="direct")[:, :3]
    stokeslets = velocity((points, strengths[:, 3:], x), FORCE, slice(0, 3))
    assert_identity(lambda h: 0.5 * curl(stokeslets, x, h) - u, u)


@each_kernel
def test_no_divergence(kernel):
    """No divergence, inside the blobs too; away from the points for the singular kernels."""
    points, strengths, x = random_case(kernel, 8, seed=1, targets=20)
    if hasattr(kernel, "epsilon"):
        kernel = with_epsilon(kernel, EPSILON)
    else:
        x = x + ASIDE
    field = velocity((points, strengths, x), kernel, slice(0, 9))
    assert_identity(lambda h: divergence(field, x, h), gradient(field, x, SMALL_STEP))


def test_momentum(case):
    """-grad p + mu lap u = -f phi - 1/2 curl(n phi), with p = sum (f.r) Q."""
    points, strengths, x = case

    def pressure(x):
        kernel = tc.RegularizedPressure(EPSILON)
        return tc.evaluate(kernel, points, strengths[:, :3], x, backend="direct")

    r = x[:, None, :] - points
    R2 = (r**2).sum(axis=-1) + EPSILON**2
    blob = (15 * EPSILON**4 / (8 * np.pi * R2**3.5))[..., None]
    curl_of_torque = np.cross(-7.0 * r * blob / R2[..., None], strengths[:, 3:])
    body_force = (strengths[:, :3] * blob + 0.5 * curl_of_torque).sum(axis=1)

    def residual(h):
        stress = MU * laplacian(velocity(case), x, h) - gradient(pressure, x, h)[..., 0].T
        return stress + body_force

    assert_identity(residual, body_force)


def test_mobility_is_symmetric_positive_definite():
    """The 6N x 6N matrix from forces and torques to u and w, dense, near and far particles."""
    points, _, _ = random_case(FORCE_TORQUE, 12, seed=2)
    plan = tc.Plan(tc.RegularizedStokesletRotlet(0.05, MU), "direct").set_points(points)
    mobility = np.array([plan.execute(e.reshape(12, 6)).ravel() for e in np.eye(72)])
    np.testing.assert_allclose(mobility, mobility.T, rtol=0, atol=1e-15 * abs(mobility).max())
    # Scaled to a unit diagonal: torques move particles eps^-2 times more than forces.
    scale = 1.0 / np.sqrt(np.diag(mobility))
    assert np.linalg.eigvalsh(scale[:, None] * mobility * scale).min() > 1e-3


@pytest.mark.parametrize("epsilon", [1e-3, 0.3, 1e5])
def test_self_terms(epsilon):
    """A particle moves itself by f / (4 pi mu eps) and turns itself by 5 n / (16 pi mu eps^3)."""
    f, n = np.array([1.0, -2.0, 3.0]), np.array([0.3, 0.2, -0.1])
    point = [[1.0, 2.0, 3.0]]
    u = f / (4 * np.pi * MU * epsilon)
    w = 5 * n / (16 * np.pi * MU * epsilon**3)
    alone = tc.evaluate(tc.RegularizedStokeslet(epsilon, MU), point, [f], backend="direct")
    both = tc.evaluate(
        tc.RegularizedStokesletRotlet(epsilon, MU), point, [np.append(f, n)], backend="direct"
    )
    # A dozen roundings, and as many in the expectation.
    np.testing.assert_allclose(alone[0], u, rtol=24 * UNIT)
    np.testing.assert_allclose(both[0], np.append(u, w), rtol=24 * UNIT)


def test_singular_limit():
    """8 pi mu times the regularized Stokeslet tends to the Stokeslet as eps^2."""
    points, forces, _ = random_case(FORCE, 30, seed=3)
    targets = points + ASIDE
    limit = tc.evaluate(tc.Stokeslet(), points, forces, targets, backend="direct")

    def error(epsilon):
        kernel = tc.RegularizedStokeslet(epsilon, MU)
        values = tc.evaluate(kernel, points, forces, targets, backend="direct")
        return tc.relative_error(8 * np.pi * MU * values, limit)

    errors = np.array([error(epsilon) for epsilon in (0.08, 0.04, 0.02)])
    # The next term is a relative eps^2/r^2 of the first, r some 2 to 3.
    np.testing.assert_allclose(np.log2(errors[:-1] / errors[1:]), 2.0, atol=0.01)
    assert error(1e-8) <= 1e-15


def transformed(kernel, rows, matrix):
    """Turn triples of components by an orthogonal matrix; n and w are axial vectors."""
    turned = rows.reshape(len(rows), -1, 3) @ matrix.T
    if isinstance(kernel, tc.RegularizedStokesletRotlet):
        turned[:, 1] *= np.linalg.det(matrix)
    return turned.reshape(rows.shape)


ORTHOGONAL = {
    "reflection": np.diag([1.0, -1.0, 1.0]),
    "inversion": -np.eye(3),
    "cyclic": np.eye(3)[[1, 2, 0]],
    "quarter_turn": np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
    "rotation": np.linalg.qr(np.random.default_rng(4).normal(size=(3, 3)))[0],
}


def two_clouds(kernel, seed):
    """Return 2 x 150 points in unit cubes four apart, on a grid of 2^-20, and strengths."""
    points, strengths, _ = random_case(kernel, 300, seed)
    points = np.round(points * 2.0**19) / 2.0**20
    points[150:, 0] += 4.0
    return points, strengths


def solve(kernel, backend, points, strengths, degree=2):
    """Return the sum, with clusters of more points than the (degree + 1)^3 proxies."""
    plan = tc.Plan(kernel, backend, theta=0.5, degree=degree, leaf_size=40).set_points(points)
    values = plan.execute(strengths)
    assert backend == "direct" or plan.info()["far_pairs"] > 0
    return values


@each_kernel
@each_backend
@pytest.mark.parametrize("name", ORTHOGONAL)
def test_rotations_and_reflections(kernel, backend, name):
    """Turning everything turns the values; n and w are axial vectors.

    Matrices that map the axes on the axes map clusters on clusters: to rounding, amplified by the
    interpolation. A general rotation makes other clusters: to the error of both sums.
    """
    matrix = ORTHOGONAL[name]
    points, strengths = two_clouds(kernel, seed=5)
    turned = transformed(kernel, strengths, matrix)
    values = solve(kernel, backend, points @ matrix.T, turned)
    expected = transformed(kernel, solve(kernel, backend, points, strengths), matrix)
    # Turned coordinates are themselves rounded, by 2^-53 of 5, at distances down to 0.02.
    tolerance = 1e-12 if backend == "direct" or name != "rotation" else 2.0 * 0.5**3
    assert tc.relative_error(values, expected) <= tolerance


@each_kernel
@each_backend
def test_translation(kernel, backend):
    """A shift that is exact in floating point changes nothing but the rounding."""
    points, strengths = two_clouds(kernel, seed=6)
    values = solve(kernel, backend, points + np.array([3.0, -5.0, 1024.0]), strengths)
    assert tc.relative_error(values, solve(kernel, backend, points, strengths)) <= 1e-14


@each_kernel
@each_backend
@pytest.mark.parametrize("exponent", [-160, -40, 40, 160])
def test_change_of_units(kernel, backend, exponent):
    """In lengths 2^k times larger every bit is the same: u scales by 2^-k, w by 2^-2k.

    That is, if torques and dipoles scale as forces times lengths. Nothing in the library has a
    length of its own, and no power of one leaves the range of doubles (2^160 is 1e48).
    """
    points, strengths = two_clouds(kernel, seed=8)
    expected = solve(kernel, backend, points, strengths, degree=4)
    unit = 2.0**exponent
    strengths[:, 3:6] *= unit
    scaled = with_epsilon(kernel, 0.1 * unit)
    values = solve(scaled, backend, points * unit, strengths, degree=4)
    values[:, :3] *= unit
    values[:, 3:] *= unit**2
    np.testing.assert_array_equal(values, expected)


@pytest.mark.parametrize(
    "kernel",
    [kernel for kernel in KERNELS if not isinstance(kernel, tc.StokesletStresslet)],
    ids=lambda kernel: type(kernel).__name__,
)
def test_reciprocity(kernel):
    """Lorentz: strengths p on cloud A work on the flow of q on cloud B as q on that of p."""
    points, strengths = two_clouds(kernel, seed=7)
    a, b = points[:150], points[150:]
    p, q = strengths[:150], strengths[150:]
    flow_of_p = tc.evaluate(kernel, a, p, b, backend="direct")
    flow_of_q = tc.evaluate(kernel, b, q, a, backend="direct")
    scale = np.abs(q * flow_of_p).sum()
    assert abs((q * flow_of_p).sum() - (p * flow_of_q).sum()) <= 1e-14 * scale
