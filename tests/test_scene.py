"""Whole scenes: fast sums, channels that are needed, background flows, held bases, the oracle."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import mrs
import treecode as tc
from mrs.fluid.mobility import Mobility
from mrs.time.state import State
from tests.cases import rod_oracle as oracle

MODULI = {"bending": 0.02, "twisting": 0.03, "shearing": 0.3, "stretching": 0.4}
A, B = np.array([0.02, 0.02, 0.03]), np.array([0.3, 0.3, 0.4])
STRAIN = np.array([1.0, 0.5, -0.7])


def pairs(sim):
    """Return the pairs of targets with sources, or terms of expansions, in the last evaluation."""
    return sum(info["near_pairs"] + info["far_pairs"] for info in sim.mobility.infos())


def fixed(name, dt):
    return mrs.Integrator(name, dt)


# --- fast sums ----------------------------------------------------------------------------


def forest(backend):
    """Return 60 rods of 40 nodes and 300 swimmers, 3000 points in all; blobs of two sizes."""
    rng = np.random.default_rng(0)
    turns, origins = Rotation.random(60, rng), rng.uniform(-2.0, 2.0, (60, 3))
    line = mrs.geometry.straight(1.0, 40)
    lines = [line.moved(o, t) for o, t in zip(origins, turns, strict=True)]
    rods = mrs.Rods(lines, intrinsic_curvature=STRAIN, epsilon=0.1, **MODULI)
    x, p = mrs.random_suspension(300, 5.0, 0.15, reach=0.3, seed=1)
    swimmers = mrs.Swimmers(x, p, length=0.3, force=0.1, epsilon=0.06)
    return mrs.Simulation(
        mrs.Fluid(), [rods, swimmers], backend=backend, integrator=fixed("heun", 0.01)
    )


@pytest.fixture(scope="module")
def displaced():
    """Return the direct rates of the forest, where it is after five steps, and how far that is."""
    sim = forest("direct")
    start = sim.state.positions
    motion = sim.now.motion
    end = sim.run(0.05).state.positions
    assert pairs(sim) == 3000**2
    return motion, end, np.linalg.norm(end - start)


def strayed(backend, displaced):
    """Return how far a trajectory is from the direct one, relative to its length."""
    sim = forest(backend).run(0.05)
    assert pairs(sim) < 3000**2
    _, end, way = displaced
    return np.linalg.norm(sim.state.positions - end) / way


@pytest.mark.parametrize(("name", "degrees"), [("kitc", (1, 3, 5)), ("taylor", (2, 5, 8))])
def test_treecode_trajectories(name, degrees, displaced):
    """They stay near the direct one, the nearer the higher the degree.

    By theta for each degree at least, as the error of the sums; 1e-4 is what the default
    `Backend.tolerance` asks of one sum.
    """
    theta = 0.5
    errors = [strayed(mrs.Backend(name, theta, n, leaf_size=300), displaced) for n in degrees]
    assert np.all(np.diff(np.log(errors)) <= np.diff(degrees) * np.log(theta))
    assert errors[-1] <= 1e-4 <= errors[0]


@pytest.mark.parametrize("name", ["auto", "kitc", "taylor"])
@pytest.mark.parametrize("tolerance", [1e-2, 1e-3, 1e-4])
def test_sums_keep_their_tolerance(tolerance, name, displaced):
    """For velocities and for angular velocities, of which one is 30 times the other here."""
    sim = forest(mrs.Backend(name, tolerance=tolerance))
    motion, exact = sim.now.motion, displaced[0]
    for part in (np.s_[:, :3], np.s_[:2400, 3:]):
        error = np.linalg.norm(motion[part] - exact[part]) / np.linalg.norm(exact[part])
        assert error <= tolerance


def test_bodies_at_rest_are_summed_directly():
    """Forces that are nothing but rounding cancel to no digit: no reason to stop a simulation."""
    x = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    epsilons, yes, no = np.full(2, 0.1), np.ones(2, bool), np.zeros(2, bool)
    loads = np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]])
    for backend in ("auto", "kitc", "fmm"):
        some = 1.0, epsilons, yes, no, no, np.zeros(2, int)
        sums = Mobility(*some, mrs.Backend(backend, tolerance=1e-11))
        assert np.abs(sums(1e-6 * x, loads)).max() < 1e-9
        assert [choice.backend for choice in sums.choices] == ["direct"]


# --- channels -----------------------------------------------------------------------------


@pytest.fixture
def sums(monkeypatch):
    """Return a list that receives kernel, sources, targets and columns of each sum."""
    done, execute = [], tc.Plan.execute

    def recorded(plan, strengths):
        values = execute(plan, strengths)
        name = type(plan.kernel).__name__
        done.append((name, len(strengths), len(values), strengths.shape[1], values.shape[1]))
        return values

    monkeypatch.setattr(tc.Plan, "execute", recorded)
    return done


def swimmers(count=7, **options):
    x, p = mrs.random_suspension(count, 3.0, 0.5, seed=3)
    options = {"length": 0.4, "force": 1.0, "epsilon": 0.1} | options
    return mrs.Swimmers(x + 6.0 * np.eye(3)[2], p, **options)


def tracers(count=11, **options):
    return mrs.Tracers(np.random.default_rng(4).uniform(-2.0, 2.0, (count, 3)), **options)


def rods(**options):
    line = mrs.geometry.at_rest(STRAIN, 0.2, 6)
    options = {"intrinsic_curvature": [0.3, 0.2, 0.1], "epsilon": 0.2} | MODULI | options
    return mrs.Rods([line, line.moved([1.0, 2.0, 0.5])], **options)


def test_swimmers_need_no_torques(sums):
    """The 3 by 3 kernel, and no columns for torques or angular velocities anywhere."""
    sim = mrs.Simulation(mrs.Fluid(), [swimmers()], backend="direct")
    now = sim.now
    assert sums == [("RegularizedStokeslet", 14, 14, 3, 3)]
    assert now.loads.shape == now.motion.shape == (14, 3)
    assert pairs(sim) == 14**2


def test_tracers_are_targets_only(sums):
    sim = mrs.Simulation(mrs.Fluid(), [tracers(), swimmers()], backend="direct")
    assert sim.now
    assert sums == [("RegularizedStokeslet", 14, count, 3, 3) for count in (14, 11)]
    assert pairs(sim) == 14 * (11 + 14)


def test_only_rods_are_asked_for_angular_velocities(sums):
    """Torques act on all, swimmers' forces turn rods, and nobody else is turned."""
    sim = mrs.Simulation(mrs.Fluid(), [swimmers(), rods(), tracers()], backend="direct")
    assert sim.now
    assert sorted(sums) == [
        ("RegularizedStokeslet", 14, 11, 3, 3),
        ("RegularizedStokeslet", 14, 14, 3, 3),
        ("RegularizedStokesletRotlet", 12, 11, 6, 6),
        ("RegularizedStokesletRotlet", 12, 14 + 12, 6, 6),
        ("RegularizedStokesletRotlet", 14, 12, 6, 6),
    ]
    assert pairs(sim) == (14 + 12) * (14 + 12 + 11)


def test_every_blob_size_is_one_sum(sums):
    sim = mrs.Simulation(mrs.Fluid(), [swimmers(flagellum_epsilon=0.2)], backend="direct")
    assert sim.now
    assert sums == [("RegularizedStokeslet", 7, 14, 3, 3)] * 2


# --- background flows ---------------------------------------------------------------------


def test_tracers_alone_in_shear(sums):
    """x = x0 + rate z t, whatever the method and the step, and not one sum."""
    for name in ("euler", "rkc2"):
        dust = tracers()
        fluid = mrs.Fluid(background=mrs.flows.shear(2.0))
        sim = mrs.Simulation(fluid, [dust], integrator=name).run(3.0)
        expected = dust.positions + 6.0 * np.outer(dust.positions[:, 2], [1.0, 0.0, 0.0])
        np.testing.assert_allclose(sim.state.positions, expected, rtol=0, atol=1e-13)
        assert pairs(sim) == 0
    assert sums == []


def test_tracers_in_extension():
    """x = x0 exp(rate t); 100 steps of fourth order with rate dt = 0.01 err by 1e-10."""
    dust = tracers()
    fluid = mrs.Fluid(background=mrs.flows.extension(1.0))
    sim = mrs.Simulation(fluid, [dust], integrator=fixed("rk4", 0.01)).run(1.0)
    expected = dust.positions * np.exp([1.0, -0.5, -0.5])
    np.testing.assert_allclose(sim.state.positions, expected, rtol=0, atol=1e-9)


def test_tracers_in_a_tube():
    """Poiseuille: straight lines at speed (1 - (r / radius)^2), zero on the wall."""
    points = np.array([[0.0, 0.0, 0.0], [1.0, 0.6, -0.8], [2.0, 3.0, 4.0], [5.0, 1.0, 2.0]])
    fluid = mrs.Fluid(background=mrs.flows.poiseuille(2.0, 5.0))
    sim = mrs.Simulation(fluid, [mrs.Tracers(points)]).run(0.5)
    along = (2.0 * (1.0 - (points[:, 1] ** 2 + points[:, 2] ** 2) / 25.0) * 0.5)[:, None]
    np.testing.assert_allclose(sim.state.positions, points + along * [1, 0, 0], atol=1e-13)


FLOWS = {
    "shear": mrs.flows.shear(1.3),
    "extension": mrs.flows.extension(0.7),
    "poiseuille": mrs.flows.poiseuille(2.0, 3.0),
    "quadratic": mrs.flows.QuadraticFlow(
        gradient=[[1.0, 2.0, 3.0], [4.0, -3.0, 5.0], [6.0, 7.0, 2.0]],
        quadratic=np.einsum("i,jk->ijk", [1.0, -2.0, 0.0], np.diag([0.0, 0.0, 1.5])),
        constant=[0.1, 0.2, 0.3],
    ),
}


@pytest.mark.parametrize("name", FLOWS)
def test_vorticity_is_the_curl(name):
    """Central differences are exact for quadratic flows, and there is no divergence."""
    flow, x, h = FLOWS[name], np.random.default_rng(5).normal(size=(9, 3)), 0.5
    ends = [[flow.velocity(x + s * h * e, 0.0) for s in (1, -1)] for e in np.eye(3)]
    G = np.array([(plus - minus) / (2 * h) for plus, minus in ends])  # axes d, point, component
    curl = [G[1, :, 2] - G[2, :, 1], G[2, :, 0] - G[0, :, 2], G[0, :, 1] - G[1, :, 0]]
    np.testing.assert_allclose(flow.vorticity(x, 0.0), np.transpose(curl), rtol=0, atol=1e-13)
    np.testing.assert_allclose(np.einsum("dnd->n", G), 0.0, atol=1e-13)


@pytest.mark.parametrize("name", FLOWS)
def test_pressure_balances_the_viscous_stress(name):
    """Stokes' equation, grad p = mu lap U, by differences that are exact for quadratic flows."""
    flow, x, mu = FLOWS[name], np.concatenate([np.eye(3), -np.eye(3)]), 0.7
    stress = mu * (flow.velocity(x, 0.0).sum(axis=0) - 6.0 * flow.velocity(0.0 * x, 0.0)[0])
    pressure = flow.pressure(x, 0.0, mu)
    np.testing.assert_allclose((pressure[:3] - pressure[3:]) / 2.0, stress, rtol=0, atol=1e-14)


@pytest.mark.parametrize(
    "bad",
    [
        {"gradient": np.eye(3)},
        {"quadratic": np.einsum("i,j,k->ijk", [1, 0, 0], [1, 0, 0], [0, 1, 0])},
    ],
)
def test_flows_with_divergence_are_refused(bad):
    with pytest.raises(ValueError, match=r"trace 0|without divergence"):
        mrs.flows.QuadraticFlow(**bad)


def test_shear_turns_triads_by_half_its_vorticity():
    """A rod at rest in U = (rate z, 0, 0): u = U, w = (0, rate / 2, 0), to rounding."""
    rod = rods(intrinsic_curvature="initial")
    fluid = mrs.Fluid(background=mrs.flows.shear(3.0))
    sim = mrs.Simulation(fluid, [rod], backend="direct")
    u, w = np.split(sim.now.rates, 2)
    expected = np.outer(rod.positions[:, 2], [3.0, 0.0, 0.0])
    # Forces of a rod at rest are rounding, 1e-16 of its moduli, times 1 / eps^3.
    np.testing.assert_allclose(u, expected, rtol=0, atol=1e-13)
    np.testing.assert_allclose(w, [[0.0, 1.5, 0.0]] * 12, rtol=0, atol=1e-13)


def test_rods_follow_a_rigid_rotation():
    """In U = W x x rods at rest turn as they are, triads and all, by the exact rotation.

    100 steps of fourth order of |W| dt = 0.02 err by 100 (0.02)^5 / 120 of distances up to 4; this
    fails if triads turn by any other than half the vorticity, since the rods would then bend.
    """
    W = np.array([1.0, -0.5, 1.5])
    flow = mrs.flows.QuadraticFlow(gradient=np.cross(np.eye(3), W))  # columns W x e_i
    rod = rods(intrinsic_curvature="initial")
    sim = mrs.Simulation(
        mrs.Fluid(background=flow), [rod], backend="direct", integrator=fixed("rk4", 0.01)
    ).run(1.0)
    turn = Rotation.from_rotvec(W)
    np.testing.assert_allclose(sim.state.positions, turn.apply(rod.positions), rtol=0, atol=1e-8)
    before, after = oracle.triads(rod.quaternions), oracle.triads(sim.state.quaternions)
    np.testing.assert_allclose(
        after.reshape(-1, 3), turn.apply(before.reshape(-1, 3)), rtol=0, atol=1e-8
    )


def test_rods_need_the_vorticity():
    flow = mrs.flows.UserFlow(lambda points, t: 0.0 * points)
    with pytest.raises(ValueError, match="background must have a vorticity"):
        mrs.Simulation(mrs.Fluid(background=flow), [rods()])
    mrs.Simulation(mrs.Fluid(1.0, 0.1, flow), [swimmers(), tracers()])


# --- the dense oracle -----------------------------------------------------------------------


class Mixed:
    """Two sets of rods, swimmers and tracers, blobs of five sizes, a shear flow, any base."""

    mu, rate, blobs = 0.7, 1.7, (0.11, 0.17)

    def __init__(self, base="free"):
        rng = np.random.default_rng(6)
        self.bodies = [
            tracers(),
            rods(base=base),
            swimmers(3, epsilon=self.blobs[0], flagellum_epsilon=self.blobs[1], stroke="puller"),
            rods(epsilon=0.35, base=base, name="others"),
        ]
        fluid = mrs.Fluid(self.mu, background=mrs.flows.shear(self.rate))
        self.sim = mrs.Simulation(fluid, self.bodies, backend="direct")
        X, q = self.sim.state
        turns = Rotation.from_rotvec(0.2 * rng.normal(size=(len(q), 3)))
        X = X + 0.05 * rng.normal(size=X.shape)
        self.sim.state = State(X, (turns * Rotation.from_quat(q)).as_quat())

    def sources(self):
        """Return points, blobs, forces and torques of rods, swimmers and rods."""
        parts = []
        for body in self.bodies[1:]:
            X, q = self.sim.body_state(body)
            swims = body.kind == "swimmers"
            parts.append(self._swimmers(X, q) if swims else self._rods(body, X, q))
        return [np.concatenate(column) for column in zip(*parts, strict=True)]

    def _rods(self, body, X, q):
        D, (f, n) = oracle.triads(q), np.zeros((2, 12, 3))
        for rod in (slice(0, 6), slice(6, 12)):
            omega = np.tile([0.3, 0.2, 0.1], (5, 1))
            f[rod], n[rod] = oracle.rod_loads(X[rod], D[rod], np.full(5, 0.2), A, B, omega)
        if body.base != "free":
            f[[0, 6]] = n[[0, 6]] = 0.0
        return X, np.full(12, body.epsilon), f, n

    def _swimmers(self, X, q):
        p = oracle.triads(q)[:, 2]
        points = oracle.swimmer_points(X, p, np.full(3, 0.4), -1.0)
        thrust = np.concatenate([p, -p])
        return points, np.repeat(self.blobs, 3), thrust, np.zeros((6, 3))

    def flow(self, points):
        """Return velocity and angular velocity at points."""
        u, w = oracle.flow(*self.sources(), points, self.mu)
        u += self.rate * np.outer(points[:, 2], [1, 0, 0])
        w[:, 1] += 0.5 * self.rate
        return u, w

    def rates(self):
        """Return what the rates should be."""
        velocities, spins = [], []
        for body in self.bodies:
            X, q = self.sim.body_state(body)
            if body.kind == "swimmers":
                p = oracle.triads(q)[:, 2]
                u, _ = self.flow(oracle.swimmer_points(X, p, np.full(3, 0.4), -1.0))
                velocities.append(u[:3])
                # d = -p: dd/dt = w x d, w = d x (u_B - u_F) / l.
                spins.append(np.cross(-p, u[:3] - u[3:]) / 0.4)
                continue
            u, w = self.flow(X)
            if body.kind == "rods" and body.base == "clamped":
                u[[0, 6]] = w[[0, 6]] = 0.0
            velocities.append(u)
            if body.kind == "rods":
                spins.append(w)
        return np.concatenate([*velocities, *spins])


@pytest.mark.parametrize("base", ["free", "clamped"])
def test_mixed_scene(base):
    """Every velocity and angular velocity is that of the dense sums over all pairs."""
    mixed = Mixed(base)
    expected = mixed.rates()
    # The matrix root of the oracle is good to 1e-14; b / ds, and 1 / (8 pi mu eps^3), amplify.
    scale = 1e-13 * np.abs(expected).max()
    np.testing.assert_allclose(mixed.sim.now.rates, expected, atol=scale)


def test_velocity_anywhere():
    """The field between the bodies, and inside them."""
    mixed = Mixed()
    points = np.concatenate([tracers(20).positions, mixed.bodies[1].positions])
    expected, _ = mixed.flow(points)
    np.testing.assert_allclose(
        mixed.sim.velocity(points), expected, rtol=0, atol=1e-13 * np.abs(expected).max()
    )


# --- held and driven bases ------------------------------------------------------------------


def rods_with(base, t_end=0.5, **options):
    """Return a simulation of moving rods after a run, and their first nodes."""
    rod = rods(base=base, **options)
    sim = mrs.Simulation(mrs.Fluid(), [rod], backend="direct", integrator=fixed("heun", 0.02))
    sim.run(t_end)
    moved = np.abs(sim.state.positions - rod.positions).max()
    assert moved > 1e-3
    return rod, sim


def test_clamped_base():
    """Neither the node nor its triad moves: not in the last bit of the position."""
    rod, sim = rods_with("clamped")
    np.testing.assert_array_equal(sim.state.positions[[0, 6]], rod.positions[[0, 6]])
    np.testing.assert_allclose(
        sim.state.quaternions[[0, 6]], rod.quaternions[[0, 6]], rtol=0, atol=2.0**-52
    )


def test_base_bears_what_the_fluid_does_not():
    """Forces on the fluid and on the holder cancel, for the rods' internal forces do."""
    rod, sim = rods_with("clamped")
    now = sim.now
    np.testing.assert_array_equal(now.loads[[0, 6]], 0.0)
    on_fluid = now.loads[:, :3].reshape(2, 6, 3).sum(axis=1)
    on_holder = rod.base_force(sim.time, sim.state)
    assert np.abs(on_holder).max() > 1e-4
    np.testing.assert_allclose(on_fluid + on_holder, 0.0, atol=1e-16)


def test_driven_base():
    """A constant velocity and a constant angular velocity: a straight line and a screw, exactly."""
    v, W = np.array([0.3, -0.2, 0.1]), np.array([2.0, 1.0, -1.0])
    rod, sim = rods_with(mrs.Drive(v, W))
    # 25 roundings.
    np.testing.assert_allclose(
        sim.state.positions[[0, 6]], rod.positions[[0, 6]] + 0.5 * v, rtol=0, atol=1e-15 * 25
    )
    turn = Rotation.from_rotvec(0.5 * W)
    before, after = (oracle.triads(q[[0, 6]]) for q in (rod.quaternions, sim.state.quaternions))
    np.testing.assert_allclose(
        after.reshape(-1, 3), turn.apply(before.reshape(-1, 3)), rtol=0, atol=1e-15 * 25
    )


def test_driven_base_with_delays():
    """A motion that is linear in each rod's own time: Heun's method integrates it exactly."""
    v, g, W = np.array([0.3, 0.0, 0.1]), 0.8, np.array([0.0, 0.0, 2.0])
    delay = np.array([0.2, -0.5])
    drive = mrs.Drive(lambda t: v + g * np.outer(t, [0, 1, 0]), lambda t: np.outer(t, W))
    rod, sim = rods_with(drive, delay=delay)
    t = 0.5
    way = 0.5 * t**2 - delay * t  # the integral of t - delay
    expected = rod.positions[[0, 6]] + v * t + g * np.outer(way, [0, 1, 0])
    np.testing.assert_allclose(sim.state.positions[[0, 6]], expected, rtol=0, atol=1e-15 * 25)
    before, after = (oracle.triads(q[[0, 6]]) for q in (rod.quaternions, sim.state.quaternions))
    for k in range(2):
        turned = Rotation.from_rotvec(way[k] * W).apply(before[k])
        np.testing.assert_allclose(after[k], turned, rtol=0, atol=1e-15 * 25)
