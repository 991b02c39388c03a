"""Observables: numbers that are known."""

import itertools

import numpy as np
import pytest
from scipy.spatial.distance import pdist

import mrs
from mrs import observables as obs

BINS = [0.0, 1.0, 2.0]
CUBE = np.stack(np.meshgrid(*[np.arange(4.0)] * 3, indexing="ij"), -1).reshape(-1, 3)


def shells(edges):
    return np.diff(4.0 / 3.0 * np.pi * np.asarray(edges) ** 3)


# --- displacements and directions in time ---------------------------------------------------


@pytest.mark.parametrize("origins", ["all", "first"])
def test_displacement_of_all_random_walks(origins):
    """Over all walks of unit steps along x, either way, the mean square is the number of steps."""
    walks = np.array(list(itertools.product([-1.0, 1.0], repeat=8)))
    positions = np.zeros((9, len(walks), 3))
    positions[1:, :, 0] = walks.cumsum(axis=1).T
    lags = 0.5 * np.arange(9)
    values = obs.mean_square_displacement(3.0 + lags, positions, origins)
    np.testing.assert_allclose(values, np.arange(9), rtol=1e-14)
    assert obs.growth_exponent(lags, values) == pytest.approx(1.0, rel=1e-12)
    assert obs.diffusivity(lags, values, 1) == pytest.approx(1.0, rel=1e-12)  # 2 D t = t / 0.5


@pytest.mark.parametrize("origins", ["all", "first"])
def test_displacement_at_constant_velocity(origins):
    rng = np.random.default_rng(0)
    start, velocity = rng.standard_normal((2, 7, 3))
    times = 0.25 * np.arange(12)
    positions = start + times[:, None, None] * velocity
    values = obs.mean_square_displacement(times, positions, origins)
    square = np.mean(np.sum(velocity**2, axis=1))
    np.testing.assert_allclose(values, square * times**2, rtol=1e-12)
    assert obs.growth_exponent(times, values) == pytest.approx(2.0, rel=1e-12)


def test_displacement_over_origins_is_a_mean_over_origins():
    """A point that jumps once: of the pairs a lag apart, as many as straddle the jump count."""
    positions = np.zeros((6, 1, 3))
    positions[4:, 0, 1] = 2.0
    values = obs.mean_square_displacement(np.arange(6.0), positions)
    straddling = np.array([0, 1, 2, 2, 2, 1])
    np.testing.assert_allclose(values, 4.0 * straddling / np.arange(6, 0, -1))
    first = obs.mean_square_displacement(np.arange(6.0), positions, "first")
    np.testing.assert_array_equal(first, [0, 0, 0, 0, 4, 4])


@pytest.mark.parametrize("origins", ["all", "first"])
def test_memory_of_turning_directions(origins):
    """Turning at one rate about z, from a cone about z: cos^2 + sin^2 cos(rate lag)."""
    times, angle, rate = 0.1 * np.arange(20), 0.7, 2.0
    phase = rate * times[:, None] + np.linspace(0.0, 5.0, 4)
    sine = np.sin(angle)
    directions = np.stack(
        [sine * np.cos(phase), sine * np.sin(phase), np.full_like(phase, np.cos(angle))], -1
    )
    expected = np.cos(angle) ** 2 + sine**2 * np.cos(rate * times)
    values = obs.orientation_memory(times, 3.0 * directions, origins)
    np.testing.assert_allclose(values, expected, rtol=1e-12)


def test_diffusivity_is_of_the_slope():
    """A start that is not diffusive shifts the line; it does not change the slope."""
    lags = np.linspace(5.0, 9.0, 12)
    assert obs.diffusivity(lags, 6.0 * 0.3 * lags - 2.0) == pytest.approx(0.3, rel=1e-12)
    assert obs.growth_exponent(lags, 2.0 * lags**1.5) == pytest.approx(1.5, rel=1e-12)


# --- distances ------------------------------------------------------------------------------


def test_pairs_of_a_cubic_lattice():
    """6, 12 and 8 neighbours at 1, sqrt 2 and sqrt 3, also for points in other images."""
    bins = [0.0, 0.9, 1.1, 1.5, 1.9]
    share = shells(bins) / 64.0
    images = 4.0 * np.random.default_rng(0).integers(-3, 4, CUBE.shape)
    for points in (CUBE, CUBE + images - 0.25):
        g = obs.pair_distribution(points, bins, [4.0, 4.0, 4.0])
        np.testing.assert_allclose(g * 63 * share, [0, 6, 12, 8], rtol=1e-12)


def test_pairs_of_a_lattice_in_a_sheared_cell():
    """Face-centred cubic in multiples of its primitive cell: 12 neighbours, then 6."""
    primitive = 0.5 * (np.ones((3, 3)) - np.eye(3))
    bins = [0.0, 0.6, 0.8, 1.05]
    g = obs.pair_distribution(CUBE @ primitive, bins, 4.0 * primitive)
    share = shells(bins) / (64.0 * 0.25)
    np.testing.assert_allclose(g * 63 * share, [0, 12, 6], rtol=1e-12)


def test_pairs_of_an_ideal_gas():
    """1 in each bin. Distances of different pairs are independent: counts scatter as binomials."""
    count, bins = 800, np.linspace(0.0, 0.5, 11)
    points = np.random.default_rng(1).random((count, 3))
    expected = 0.5 * count * (count - 1) * shells(bins)
    g = obs.pair_distribution(points, bins, np.eye(3))
    assert (np.abs(g - 1.0) < 4.0 / np.sqrt(expected)).all()


def test_pairs_in_an_open_box():
    """The expected pairs are those of two random points in the box: here by quadrature."""
    box, bins = np.array([1.0, 2.0, 1.5]), np.array([0.0, 0.4, 1.0])
    points = np.random.default_rng(2).random((40, 3)) * box
    points[:2] = [[0.0, 0.0, 0.0], box]
    nodes, weights = np.polynomial.legendre.leggauss(20)
    nodes, weights = 0.5 + 0.5 * nodes, 0.5 * weights
    r, u, v = np.meshgrid(nodes, nodes, 0.5 * np.pi * nodes, indexing="ij")  # an eighth of a ball
    across = np.sqrt(1.0 - u**2)
    direction = np.stack([across * np.cos(v), across * np.sin(v), u], -1)
    w = np.einsum("i,j,k->ijk", weights, weights, 0.5 * np.pi * weights)

    def share(radius):
        apart = 1.0 - radius * r[..., None] * direction / box
        return 8.0 * np.sum(w * radius**3 * r**2 * apart.prod(axis=-1)) / box.prod()

    counts, _ = np.histogram(pdist(points), bins)
    expected = 0.5 * 40 * 39 * np.diff([share(radius) for radius in bins])
    # 20 points resolve sqrt(1 - u^2) at its end to 1e-5.
    np.testing.assert_allclose(obs.pair_distribution(points, bins), counts / expected, rtol=1e-4)


def test_correlation_of_a_chequerboard():
    """Neighbours point the other way, second ones the same way, third ones the other way."""
    sign = (-1.0) ** CUBE.sum(axis=1)
    directions = sign[:, None] * [0.0, 3.0, 4.0]
    bins = [0.0, 0.9, 1.1, 1.5, 1.9]
    found = obs.orientation_correlation(CUBE, directions, bins, [4.0, 4.0, 4.0])
    np.testing.assert_allclose(found, [np.nan, -1.0, 1.0, -1.0], rtol=1e-14)
    found = obs.orientation_correlation(CUBE, directions, bins)
    np.testing.assert_allclose(found, [np.nan, -1.0, 1.0, -1.0], rtol=1e-14)


def test_correlation_at_angles():
    """Directions that turn with x by a fixed angle a unit: its cosine, by distance along a row."""
    x = np.arange(6.0)
    points = np.stack([x, 0 * x, 0 * x], -1)
    directions = np.stack([np.cos(0.3 * x), np.sin(0.3 * x), 0 * x], -1)
    found = obs.orientation_correlation(points, directions, [0.5, 1.5, 2.5, 3.5])
    np.testing.assert_allclose(found, np.cos(0.3 * np.array([1, 2, 3])), rtol=1e-14)


def test_density_by_height():
    points = np.array([[0, 0, 0.1], [5, 5, 0.2], [0, 0, 1.7], [0, 0, 9.0]])
    np.testing.assert_allclose(obs.number_density(points, [0.0, 0.5, 2.0], 4.0), [1.0, 1.0 / 6.0])


# --- flow -----------------------------------------------------------------------------------


def test_flux_of_flows_that_are_known():
    tube = mrs.flows.poiseuille(3.0, 2.0)
    square = [[0.0, 2.0, 0.0], [0.0, 0.0, 2.0]]
    exact = 3.0 * (4.0 - 2.0 * (4.0 / 3.0) / 4.0)  # 3 (1 - (y^2 + z^2) / 4) over [-1, 1]^2

    def velocity(points):
        return tube.velocity(points, 0.0)

    corner = [7.0, -1.0, -1.0]
    assert obs.flux(velocity, obs.Rectangle(corner, square, 2)) == pytest.approx(exact, rel=1e-14)
    assert obs.flux(velocity, obs.Rectangle(corner, square[::-1])) == pytest.approx(-exact)
    lying = obs.Rectangle(corner, [[2.0, 0.0, 0.0], [0.0, 2.0, 0.0]])
    assert obs.flux(velocity, lying) == 0.0
    tilted = obs.Rectangle(corner, [[0.0, 2.0, 0.0], [5.0, 0.0, 2.0]])  # of the same shadow
    assert obs.flux(velocity, tilted) == pytest.approx(exact, rel=1e-14)


def test_order_of_the_rule():
    """Polynomials of degree 2 n - 1 are exact, and of degree 2 n are not; others converge fast."""
    sides = [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    for order in (1, 2, 3, 5):
        rectangle = obs.Rectangle([0.0, 0.0, 0.0], sides, order)
        for degree, exact in ((2 * order - 1, True), (2 * order, False)):
            value = obs.flux(lambda x, p=degree: x[:, [2, 0, 0]] ** p, rectangle)
            assert (abs(value * (degree + 1) - 1.0) < 1e-13) == exact

    def wave(points):
        return np.cos(5.0 * points[:, [2, 0, 0]])

    rectangles = [obs.Rectangle([0.0, 0.0, 0.0], sides, order) for order in (2, 4, 8, 16)]
    errors = [abs(obs.flux(wave, rectangle) - np.sin(5.0) / 5.0) for rectangle in rectangles]
    assert errors[1] < 1e-2 * errors[0]
    assert errors[2] < 1e-4 * errors[1]
    assert errors[3] < 1e-14


def test_profile_of_a_shear_flow():
    flow = mrs.flows.shear(2.0)
    floor = obs.Rectangle([1.0, 1.0, 0.5], [[3.0, 0.0, 0.0], [0.0, 2.0, 0.0]])
    heights = np.linspace(0.0, 4.0, 5)
    profile = obs.velocity_profile(lambda x: flow.velocity(x, 0.0), floor, heights)
    np.testing.assert_allclose(profile, np.outer(2.0 * (heights + 0.5), [1, 0, 0]), atol=1e-14)


def above_wall(points, y, f, n, e):
    """Return the velocity for unit viscosity: blobs 7/2 with their images (Ainley et al. 2008)."""
    h, (_, _, z), dot = y[2], points.T, np.matmul
    mirror, up = np.array([1.0, 1.0, -1.0]), np.array([0.0, 0.0, 1.0])
    r, X, g, p = points - y, points - y * mirror, f * mirror, np.cross(up, n)
    S, R = (np.sqrt((v**2).sum(axis=1) + e * e)[:, None] for v in (r, X))
    z, near, far = z[:, None], (r**2).sum(axis=1)[:, None], (X**2).sum(axis=1)[:, None]
    b = 1.0 / R**3 - 3.0 * e * e / R**5
    force = ((near + 2 * e * e) * f + dot(r, f)[:, None] * r) / S**3
    force -= ((far + 2 * e * e) * f + dot(X, f)[:, None] * X) / R**3
    force += 2 * h * (dot(X, g)[:, None] * up + f[2] * X) / R**3
    force -= 2 * h * z * (b * g - 3 * X * dot(X, g)[:, None] / R**5)
    turn = (5 * e * e + 2 * near) * np.cross(n, r) / S**5
    turn -= (1 / R**3 + 3 * e * e / R**5) * np.cross(n, X * mirror) - np.cross(X, n) * mirror / R**3
    turn += -2 * dot(X, p)[:, None] * up / R**3 - 2 * h * p / R**3 + 2 * z * b * p
    turn -= 12 * z * X * dot(X, p)[:, None] / R**5
    turn += 30 * e * e * h * z * np.cross(n, X * mirror) * mirror / R**7
    return (force + 0.5 * turn) / (8 * np.pi)


def half_plane():
    """Return points (y, z) of the half plane z > 0, (n, 2), and their weights.

    In polar coordinates with r = 3 t / (1 - t): 60 and 40 points leave 1e-9 of a blob near 1.
    """
    (t, wt), (a, wa) = (np.polynomial.legendre.leggauss(count) for count in (60, 40))
    t, angle = (0.5 + 0.5 * t)[:, None], 0.5 * np.pi * (1.0 + a)
    r = 3.0 * t / (1.0 - t)
    weights = 0.5 * wt[:, None] * (0.5 * np.pi * wa) * r * 3.0 / (1.0 - t) ** 2
    return np.stack([r * np.cos(angle), r * np.sin(angle)], -1).reshape(-1, 2), weights.ravel()


@pytest.mark.parametrize("epsilon", [1e-6, 0.4])
@pytest.mark.parametrize("plane", [-1.5, 3.0])
def test_pumped_flux_against_quadrature(epsilon, plane):
    """Each component of force and torque, through whole planes on both sides."""
    y = np.array([0.2, -0.1, 0.7])
    places, weights = half_plane()
    points = np.insert(places, 0, plane, axis=1)
    for load in np.eye(6):
        values = above_wall(points, y, load[:3], load[3:], epsilon)
        expected = weights @ values[:, 0]
        assert obs.pumped_flux([y], [load], 1.0) == pytest.approx(expected, abs=1e-8)
    assert obs.pumped_flux([y], [[2.0, 0, 0]], 3.0) == pytest.approx(2.0 * 0.7 / (3.0 * np.pi))


TURN_ABOUT_Z = [[0.8, -0.6, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, 1.0]]
TURN = [[0.6, 0.8, 0.0], [-0.64, 0.48, 0.6], [0.48, -0.36, 0.8]]


@pytest.mark.parametrize("turn", [TURN_ABOUT_Z, TURN], ids=["about_z", "any"])
def test_pumped_flux_along_other_walls(turn):
    """A rotation and a shift of points, loads, direction and wall change nothing."""
    rng = np.random.default_rng(3)
    points, force, torque = rng.random((3, 5, 3))
    turn, shift = np.array(turn), np.array([0.3, -2.0, 1.1])
    one = obs.pumped_flux(points, np.hstack([force, torque]), 1.0, [1.0, 2.0, 0.0])
    loads = np.hstack([force @ turn.T, torque @ turn.T])
    along = turn @ [1.0, 2.0, 0.0]
    wall = mrs.Wall(shift + turn[:, 1], turn[:, 2])
    other = obs.pumped_flux(points @ turn.T + shift, loads, 1.0, along, wall)
    assert other == pytest.approx(one, rel=1e-13)


def test_pumped_flux_over_a_tilted_wall_is_that_of_the_fluid():
    """As a column of the log, through a plane 1.2 before the swimmer."""
    along, across, normal = np.array(TURN)
    wall = mrs.Wall([1.0, 0.0, 0.0], normal)
    swimmer = mrs.Swimmers(
        [wall.point + 0.5 * normal], [along + normal], length=0.4, force=1.0, epsilon=0.1
    )
    sim = mrs.Simulation(mrs.Fluid(2.0, boundary=wall), [swimmer], backend="direct")
    column = obs.PumpedFlux(along)
    column.require(sim)
    places, weights = half_plane()
    points = wall.point + 1.2 * along + places @ np.stack([across, normal])
    through = weights @ sim.velocity(points) @ along
    assert column(sim) == pytest.approx(through, rel=1e-6)


# --- refusals ------------------------------------------------------------------------------

LINE = np.outer(np.arange(3.0), [1.0, 1.0, 1.0])
REFUSED = [
    (lambda: obs.Rectangle([0, 0, 0], [[1, 0, 0], [2, 0, 0]]), "sides must not be parallel"),
    (lambda: obs.Rectangle([0, 0, 0], np.eye(3)[:2], 0), "order must be an integer from 1"),
    (lambda: obs.pumped_flux(LINE, LINE[:2], 1.0), r"loads must have shape \(3, 3\) or \(3, 6\)"),
    (lambda: obs.pumped_flux(LINE, LINE, 1.0, [1, 0, 1]), r"direction must be along .*\[1, 0, 1\]"),
    (lambda: obs.pumped_flux(-LINE, LINE, 1.0), r"points must be .* got row 1, \(-1.0,"),
    (lambda: obs.pumped_flux(LINE, LINE, 1.0, wall=0), r"wall must be mrs\.Wall, got 0"),
    (lambda: obs.PumpedFlux([0, 0, 0]), "direction must not be zero"),
    (lambda: obs.pair_distribution(LINE[:1], BINS), "at least two points, got 1"),
    (lambda: obs.pair_distribution(LINE, [0, 2.5]), "shortest edge 2 of the box .*got 2.5"),
    (lambda: obs.pair_distribution(LINE, [0, 2.5], [4, 9, 9]), "half the width .*, 2, got 2.5"),
    (
        lambda: obs.pair_distribution(LINE, BINS, np.ones((3, 3))),
        "cell must have a positive volume",
    ),
    (lambda: obs.pair_distribution(LINE, [1.0, 1.0]), "bins must be .* that increase"),
    (lambda: obs.pair_distribution(LINE, [-1.0, 1.0]), "bins must not be negative, got -1"),
    (lambda: obs.orientation_correlation(LINE, LINE, BINS), "directions must not be zero, got 1"),
    (lambda: obs.mean_square_displacement([0, 1], LINE), r"shape \(T, n, 3\).*got \(3, 3\)"),
    (lambda: obs.mean_square_displacement([0, 1, 1.5], LINE[:, None]), "from 0.5 to 1: leave"),
    (lambda: obs.mean_square_displacement([0, 2, 1], LINE[:, None]), "times must increase"),
    (lambda: obs.orientation_memory([0, 1, 2], 1 + LINE[:, None], "last"), "origins must be one"),
    (lambda: obs.growth_exponent([1, 2], [1, 0]), "values must be positive.*got 0"),
    (lambda: obs.diffusivity([1, 1], [1, 2]), "lags must be at least two different ones, got 1"),
    (lambda: obs.number_density(LINE, [0, 1], 1.0, 3), "axis must be an integer from 0 to 2"),
    (lambda: obs.flux(lambda x: x[:1], obs.Rectangle([0, 0, 0], np.eye(3)[:2])), "velocity must"),
]  # fmt: skip


@pytest.mark.parametrize(("call", "message"), REFUSED, ids=[message for _, message in REFUSED])
def test_refusals(call, message):
    with pytest.raises((ValueError, TypeError), match=message):
        call()
