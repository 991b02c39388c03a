"""Paired-particle swimmers against physics.md 5 and an integrated oracle; steric repulsion."""

import numpy as np
import pytest

import mrs
from tests.cases import rod_oracle as oracle

L, F, EPSILON = 1.0, 1.0, 0.1
U0 = 0.7165921717683815
PAIR = np.array([[0.0, 0.0, 0.0], [1.0, 0.3, 0.5]]), np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0]])
SIGNS = {"pusher": 1.0, "puller": -1.0}


def swim(x, p, stroke="pusher", integrator="bs32", fluid=None, **parameters):
    """Return a simulation of swimmers."""
    parameters = {"length": L, "force": F} | parameters
    swimmers = mrs.Swimmers(x, p, stroke=stroke, **parameters)
    fluid = fluid or mrs.Fluid(viscosity=1.0, epsilon=EPSILON)
    return mrs.Simulation(fluid, [swimmers], backend="direct", integrator=integrator)


def rates(sim):
    """Return dx_B/dt and dp/dt = w x p."""
    values = sim.now.rates
    count = len(sim.state.positions)
    p = sim.bodies[0].orientations(sim.state.quaternions)
    return values[:count], np.cross(values[count:], p)


def where(sim):
    return sim.state.positions, sim.bodies[0].orientations(sim.state.quaternions)


@pytest.mark.parametrize("stroke", SIGNS)
@pytest.mark.parametrize("direction", [(0, 0, 1), (0, 0, -1), (1, 2, -2), (1e-9, 0, -1)])
def test_alone(stroke, direction):
    """f / (4 pi mu) (1/e_B - 1/sqrt(l^2 + e_F^2)) along p, without turning."""
    p = np.array(direction) / np.linalg.norm(direction)
    u, dp = rates(swim([[3.0, -2.0, 1.0]], [direction], stroke))
    # Roundings of coordinates of size 3 at distances of l = 1, and of 1/e times some ten.
    np.testing.assert_allclose(u[0], U0 * p, rtol=0, atol=1e-14)
    np.testing.assert_allclose(dp, 0.0, atol=1e-14)


def test_alone_with_two_blob_sizes():
    mu, f, length, eB, eF = 0.7, -1.3, 0.8, 0.05, 0.2
    fluid = mrs.Fluid(viscosity=mu, epsilon=9.0)
    sim = swim(
        [[0, 0, 0]],
        [[1, 0, 0]],
        fluid=fluid,
        force=f,
        length=length,
        epsilon=eB,
        flagellum_epsilon=eF,
    )
    expected = f / (4 * np.pi * mu) * (1 / eB - 1 / np.hypot(length, eF))
    np.testing.assert_allclose(rates(sim)[0], [[expected, 0.0, 0.0]], rtol=1e-14, atol=1e-14)


def test_alone_it_swims_straight():
    """At U0 for good: after a time of ten, by either kind."""
    for stroke in SIGNS:
        sim = swim([[0, 0, 0]], [[0, 0.6, 0.8]], stroke, mrs.Integrator("heun", 0.5)).run(10.0)
        expected = [[0.0, 6.0 * U0, 8.0 * U0]]
        np.testing.assert_allclose(sim.state.positions, expected, rtol=0, atol=1e-13)


def test_pair_rates():
    """Eight digits are given."""
    u, dp = rates(swim(*PAIR))
    digit = 0.5e-8
    expected = [[0.01964091, -0.00188968, 0.72641263], [0.00294938, 0.71747699, 0.0044354]]
    turning = [[0.01385874, -0.00099112, 0.0], [0.00257455, 0.0, 0.00281899]]
    np.testing.assert_allclose(u, expected, rtol=0, atol=digit)
    np.testing.assert_allclose(dp, turning, rtol=0, atol=digit)


AT_HALF = {
    "pusher": [[0.013685846, -0.000138590, 0.362107334], [0.999167550, 0.657697029, 0.500579835]],
    # DOP853 on the oracle gives 1.008618044867 for the fourth.
    "puller": [[0.000870370, 0.001748026, 0.358490525], [1.008618045, 0.662894596, 0.499264424]],
}


@pytest.mark.parametrize("stroke", SIGNS)
def test_pair_at_half(stroke):
    """Nine digits are given; steps of 1/80 by a method of fourth order err by 4e-12."""
    sim = swim(*PAIR, stroke, mrs.Integrator("rk4", 0.0125)).run(0.5)
    np.testing.assert_allclose(sim.state.positions, AT_HALF[stroke], rtol=0, atol=0.5e-9)


def random_swimmers(count, seed=0):
    rng = np.random.default_rng(seed)
    x, p = mrs.random_suspension(count, 2.0, 0.4, reach=1.0, seed=seed)
    sizes = {
        "length": rng.uniform(0.8, 1.2, count),
        "force": rng.uniform(0.5, 1.5, count),
        "epsilon": rng.uniform(0.1, 0.2, count),
        "flagellum_epsilon": rng.uniform(0.2, 0.3, count),
    }
    return x, p, sizes


@pytest.mark.parametrize("stroke", SIGNS)
def test_random_swimmers(stroke):
    """Five that differ in everything: the rates to rounding, the trajectories to the tolerance."""
    x, p, sizes = random_swimmers(5)
    mu = 0.8
    sim = swim(
        x, p, stroke, mrs.Integrator("bs32", tolerance=1e-9), mrs.Fluid(viscosity=mu), **sizes
    )
    epsilons = np.concatenate([sizes["epsilon"], sizes["flagellum_epsilon"]])
    own = sizes["length"], sizes["force"], SIGNS[stroke], epsilons, mu
    for mine, theirs in zip(rates(sim), oracle.swimmer_rates(x, p, *own), strict=True):
        np.testing.assert_allclose(mine, theirs, rtol=0, atol=1e-13)
    sim.run(0.5)
    ends = oracle.swim(x, p, 0.5, *own)
    # 1e-9 a step, times steps (some hundred), times the growth of differences in the flow.
    for mine, theirs in zip(where(sim), ends, strict=True):
        np.testing.assert_allclose(mine, theirs, rtol=0, atol=2e-7)


def test_in_shear():
    """A flow turns a swimmer alone as Jeffery's equation for a slender rod: dp = (I - p p)(G p)."""
    p = np.array([0.48, 0.6, 0.64])
    fluid = mrs.Fluid(1.0, EPSILON, mrs.flows.shear(2.0))
    u, dp = rates(swim([[1.0, 2.0, 3.0]], [p], fluid=fluid))
    G = np.array([[0, 0, 2.0], [0, 0, 0], [0, 0, 0]])
    np.testing.assert_allclose(u[0], U0 * p + G @ [1.0, 2.0, 3.0], rtol=0, atol=1e-13)
    np.testing.assert_allclose(dp[0], G @ p - p * (p @ G @ p), rtol=0, atol=1e-13)


# --- steric repulsion -----------------------------------------------------------------

STERIC = mrs.Steric(strength=3.0, radius=0.2, chi=1.25)


def pair_force(r):
    """Return the force on the first of two points at r = x_i - x_j, from physics.md 5."""
    strength, a, chi, r2 = 3.0, 0.2, 1.25, r @ r
    if r2 >= (2 * chi * a) ** 2:
        return np.zeros(3)
    nearness = (chi**2 * 4 * a**2 - r2) / (chi**2 * 4 * a**2 - 4 * a**2)
    return strength / (2 * a) * nearness**4 * r


def crowd(seed=1):
    """Return points in a cube with many near pairs, their pieces, and their places along them."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-0.6, 0.6, (60, 3))
    return points, np.repeat(np.arange(6), 10), np.tile(0.11 * np.arange(10), 6)


def test_steric_formula():
    points, pieces, places = crowd()
    expected = np.zeros_like(points)
    for i in range(len(points)):
        for j in range(len(points)):
            neighbours = pieces[i] == pieces[j] and abs(places[i] - places[j]) <= 0.5
            if i != j and not neighbours:
                expected[i] += pair_force(points[i] - points[j])
    forces = STERIC.between(points, pieces, places, np.full(len(points), np.inf))
    assert abs(expected).max() > 1.0
    np.testing.assert_allclose(forces, expected, rtol=0, atol=1e-13 * abs(expected).max())
    # Pairwise: no net force and no net torque. 60 sums of roundings of the largest force.
    scale = abs(forces).max()
    np.testing.assert_allclose(forces.sum(axis=0), 0.0, atol=60 * 2.0**-53 * scale)
    torque = np.cross(points, forces).sum(axis=0)
    np.testing.assert_allclose(torque, 0.0, atol=120 * 2.0**-53 * scale)


@pytest.mark.parametrize(("distance", "share"), [(2.0, 1.0), (2.499, None), (2.5, 0.0), (2.6, 0.0)])
def test_steric_at_contact_and_at_reach(distance, share):
    """The force is `strength` where spheres of radius a touch and fades out smoothly at 2 chi a."""
    points = 0.2 * np.array([[0.0, 0.0, 0.0], [0.0, distance, 0.0]])
    force = STERIC.between(points, np.arange(2), np.zeros(2), np.full(2, np.inf))[1, 1]
    if share is None:
        # nearness = (2.5^2 - 2.499^2) / (2.5^2 - 2^2) = 2.2e-3, to the fourth power.
        assert 0.0 < force < STERIC.strength * 1e-9
    else:
        assert force == pytest.approx(share * STERIC.strength, rel=1e-14)


def test_steric_in_a_scene():
    """Swimmers that nearly touch: rates as the oracle's with the repulsion among the forces."""
    x, p = np.array([[0.0, 0.0, 0.0], [0.41, 0.05, 0.1]]), PAIR[1]
    swimmers = mrs.Swimmers(x, p, length=0.3, force=F)  # shorter than the reach of the repulsion
    fluid = mrs.Fluid(viscosity=1.0, epsilon=EPSILON)
    sim = mrs.Simulation(fluid, [swimmers], backend="direct", forces=[STERIC])
    points = oracle.swimmer_points(x, p, np.full(2, 0.3), 1.0)
    push = np.zeros_like(points)
    for i in range(4):
        for j in range(4):
            if i % 2 != j % 2:
                push[i] += pair_force(points[i] - points[j])
    blobs, own = np.full(4, EPSILON), (np.full(2, 0.3), np.full(2, F))

    def extra(targets):
        return oracle.flow(points, blobs, push, np.zeros_like(push), targets)[0]

    expected = oracle.swimmer_rates(x, p, *own, 1.0, blobs, extra=extra)
    assert abs(push).max() > 1.0
    for mine, theirs in zip(rates(sim), expected, strict=True):
        np.testing.assert_allclose(mine, theirs, rtol=0, atol=1e-12)
    # The forces of swimmers and of repulsion, together: nothing pulls on the fluid.
    loads = sim.now.loads
    np.testing.assert_allclose(loads.sum(axis=0), 0.0, atol=1e-14)


def test_steric_spares_neighbours_on_a_ring():
    """The first and the last node of a closed rod are neighbours."""
    ring = mrs.geometry.ring(1.0, 40)  # 0.157 from node to node, the reach is 0.5
    rod = mrs.Rods(ring, bending=1.0, twisting=1.0, shearing=1.0, stretching=1.0, epsilon=0.3)
    sim = mrs.Simulation(mrs.Fluid(), [rod], backend="direct", forces=[STERIC])
    np.testing.assert_allclose(sim.now.loads, 0.0, atol=1e-13)


# --- suspensions ----------------------------------------------------------------------


def least_distance(x, p, reach):
    """Return the least distance of particles of different swimmers."""
    points = oracle.swimmer_points(x, p, np.full(len(x), reach), 1.0)
    number = np.tile(np.arange(len(x)), 2)
    return min(
        np.linalg.norm(points[i] - points[j])
        for i in range(len(points))
        for j in range(i)
        if number[i] != number[j]
    )


@pytest.mark.parametrize("reach", [1.0, -1.0, 0.0])
def test_random_suspension(reach):
    """All in the box, none nearer than asked, directions uniform on the sphere."""
    x, p = mrs.random_suspension(60, (2.0, 3.0, 4.0), 0.25, reach=reach, seed=5)
    assert x.shape == p.shape == (60, 3)
    assert (abs(x) <= [1.0, 1.5, 2.0]).all()
    assert least_distance(x, p, reach) >= 0.25
    np.testing.assert_allclose(np.linalg.norm(p, axis=1), 1.0, rtol=1e-14)
    again = mrs.random_suspension(60, (2.0, 3.0, 4.0), 0.25, reach=reach, seed=5)
    np.testing.assert_array_equal(x, again[0])


def test_random_suspension_in_a_periodic_box():
    """Images keep the distance as well; the same draws without them do not."""
    box = np.array([2.0, 3.0, 4.0])
    least = {}
    for periodic in (True, False):
        x, p = mrs.random_suspension(60, box, 0.25, reach=1.0, seed=5, periodic=periodic)
        points = oracle.swimmer_points(x, p, np.ones(60), 1.0)
        apart = points[:, None] - points
        apart -= box * np.round(apart / box)
        number = np.tile(np.arange(60), 2)
        distance = np.linalg.norm(apart, axis=2)
        least[periodic] = distance[number[:, None] != number].min()
    assert least[True] >= 0.25 > least[False]


def test_random_directions_are_uniform():
    """Mean of p: 0, of p p: 1/3, within five standard deviations of 4000 draws."""
    _, p = mrs.random_suspension(4000, 100.0, 0.0, seed=2)
    np.testing.assert_allclose(p.mean(axis=0), 0.0, atol=5 * np.sqrt(1 / 3 / 4000))
    np.testing.assert_allclose(p.T @ p / 4000, np.eye(3) / 3, atol=5 * np.sqrt(4 / 45 / 4000))


def test_random_suspension_refuses_what_does_not_fit():
    with pytest.raises(ValueError, match=r"count: 100 swimmers .* do not fit"):
        mrs.random_suspension(100, 1.0, 0.5)


def test_lattice():
    """Every neighbour at the spacing, centred, in the direction asked for."""
    x, p = mrs.lattice_suspension((2, 3, 4), 0.7, direction=(0, 3, 4))
    assert len(x) == 24
    np.testing.assert_allclose(x.mean(axis=0), 0.0, atol=1e-15)
    np.testing.assert_allclose(np.ptp(x, axis=0), [0.7, 1.4, 2.1], rtol=1e-14)
    apart = np.linalg.norm(x[:, None] - x[None], axis=-1) + 9.0 * np.eye(24)
    np.testing.assert_allclose(apart.min(axis=1), 0.7, rtol=1e-14)
    np.testing.assert_allclose(p, [[0.0, 0.6, 0.8]] * 24, atol=1e-15)


def test_grid():
    """In the plane z = 0 if nothing is said of z."""
    expected = [[-0.25, -0.5, 0.0], [-0.25, 0.0, 0.0], [-0.25, 0.5, 0.0]]
    x = mrs.geometry.grid((2, 3), 0.5)
    np.testing.assert_array_equal(x[:3], expected)
    np.testing.assert_array_equal(x, mrs.geometry.grid((2, 3, 1), 0.5))
    with pytest.raises(ValueError, match="shape must be two or three numbers"):
        mrs.geometry.grid((4,), 0.5)
