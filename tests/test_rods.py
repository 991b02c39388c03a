"""Kirchhoff rods (physics.md 4 and 7): forces against an oracle, invariants, orders, relaxation."""

import itertools
import warnings

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.special import kv

import mrs
from mrs.time.state import State
from tests.cases import rod_oracle as oracle

UNIT = 2.0**-53
Z = np.array([0.0, 0.0, 1.0])


def about(axis, angles):
    """Return quaternions of rotations about one axis."""
    return Rotation.from_rotvec(np.asarray(angles)[:, None] * np.asarray(axis, float)).as_quat()


# --- forces and torques -----------------------------------------------------------------


class Case:
    """Three rods of 7, 9 and 5 nodes, the second closed, with random moduli, in a random state."""

    sizes, closed = (7, 9, 5), (False, True, False)

    def __init__(self, seed, **intrinsic):
        self.rng = np.random.default_rng(seed)
        shapes = [
            mrs.geometry.at_rest(self.rng.normal(size=3), 0.2, 7, origin=self.rng.normal(size=3)),
            mrs.geometry.ring(0.5, 9, twist=0.7),
            mrs.geometry.straight(1.0, 5, origin=(1, 2, 3), direction=self.rng.normal(size=3)),
        ]
        self.moduli = self.rng.uniform(0.5, 2.0, (3, 3)), self.rng.uniform(0.5, 2.0, (3, 3))
        a, b = self.moduli
        self.ends = np.cumsum((0, *self.sizes))
        self.ds = [oracle.spacings(c.nodes, oracle.triads(c.quaternions), c.closed) for c in shapes]
        self.rods = mrs.Rods(
            shapes,
            bending=a[:, :2],
            twisting=a[:, 2],
            shearing=b[:, :2],
            stretching=b[:, 2],
            **intrinsic,
        )
        self.X = self.rods.positions + 0.1 * self.rng.normal(size=(21, 3))
        turns = Rotation.from_rotvec(0.5 * self.rng.normal(size=(21, 3)))
        # Either of the two quaternions of a triad has to do.
        signs = self.rng.choice([-1.0, 1.0], (21, 1))
        self.q = signs * (turns * Rotation.from_quat(self.rods.quaternions)).as_quat()

    def middles(self):
        """Return the arclengths of the segments' middles, rod by rod."""
        return [np.cumsum(ds) - 0.5 * ds for ds in self.ds]

    def each(self, omegas):
        """Yield the oracle's arguments of each rod."""
        D, (a, b) = oracle.triads(self.q), self.moduli
        for j, (i, k) in enumerate(itertools.pairwise(self.ends)):
            yield self.X[i:k], D[i:k], self.ds[j], a[j], b[j], omegas[j], self.closed[j]

    def loads(self, omegas):
        pairs = [oracle.rod_loads(*rod) for rod in self.each(omegas)]
        return [np.concatenate(column) for column in zip(*pairs, strict=True)]


def assert_loads(case, omegas, time=0.0):
    loads = case.rods.loads(time, State(case.X, case.q))
    for mine, theirs in zip(loads, case.loads(omegas), strict=True):
        # scipy's matrix root is good to some 1e-14 of the rotation.
        np.testing.assert_allclose(mine, theirs, rtol=0, atol=1e-13 * abs(theirs).max())


@pytest.mark.parametrize("seed", range(6))
def test_loads(seed):
    """Forces, torques and energy of a random state with a random intrinsic strain everywhere."""
    omega = np.random.default_rng(100 + seed).normal(size=(6 + 9 + 4, 3))
    case = Case(seed, intrinsic_curvature=omega)
    omegas = np.split(omega, [6, 15])
    assert_loads(case, omegas)
    energy = sum(oracle.rod_energy(*rod) for rod in case.each(omegas))
    assert case.rods.energy(0.0, State(case.X, case.q)) == pytest.approx(energy, rel=1e-13)


def test_loads_with_a_beat():
    """Intrinsic strain and beat of (s, t), each rod with a delay of its own."""
    delay, t = np.array([0.0, 0.3, -0.4]), 1.7

    def intrinsic(s, t):
        return np.stack([np.sin(s), 0.3 * t, s * t], axis=1)

    wave = mrs.TravellingWave(amplitude=(0.5, -0.2, 0.1), wavelength=0.8, period=0.9)
    case = Case(7, intrinsic_curvature=intrinsic, beat=wave, delay=delay)
    omegas = []
    for s, lag in zip(case.middles(), delay, strict=True):
        sine = np.sin(2 * np.pi * (s / 0.8 - (t - lag) / 0.9))
        fixed = np.column_stack([np.sin(s), np.full_like(s, 0.3 * (t - lag)), s * (t - lag)])
        omegas.append(fixed + np.outer(sine, [0.5, -0.2, 0.1]))
    assert_loads(case, omegas, t)


def assert_balanced(X, f, n):
    """Assert that forces and torques of a free body cancel, but for rounding of the sums.

    A force is the difference of two internal ones that may be larger: 64 roundings of the largest
    times the number of nodes; torques likewise, with the distances from the origin.
    """
    scale = 64 * UNIT * len(X)
    assert np.abs(f.sum(axis=0)).max() <= scale * np.abs(f).max()
    reach = np.abs(X).max()
    torque = (np.cross(X, f) + n).sum(axis=0)
    assert np.abs(torque).max() <= scale * (reach * np.abs(f).max() + np.abs(n).max())


@pytest.mark.parametrize("seed", range(20))
def test_no_net_force_or_torque(seed):
    """Of each rod by itself, exactly: whatever its state and its intrinsic strain."""
    case = Case(seed, intrinsic_curvature=np.random.default_rng(seed).normal(size=(19, 3)))
    f, n = case.rods.loads(0.0, State(case.X, case.q))
    for i, k in itertools.pairwise(case.ends):
        assert_balanced(case.X[i:k], f[i:k], n[i:k])


@pytest.mark.parametrize("strain", [(1.3, 0, np.pi / 2), (0, 0, 2), (0.5, -1, 0), (0, 0, 0)])
def test_rest(strain):
    """A rod in the shape of `at_rest` exerts nothing, as a list of strains and as "initial"."""
    ds, shift = 0.1, (3.0, -2.0, 1.0)
    line = mrs.geometry.at_rest(strain, ds, 40, origin=shift)
    for intrinsic in (strain, "initial"):
        rod = mrs.Rods(
            line,
            bending=[[2, 3]],
            twisting=1.5,
            shearing=[[4, 5]],
            stretching=6,
            intrinsic_curvature=intrinsic,
        )
        f, n = rod.loads(0.0, State(rod.positions, rod.quaternions))
        # Coordinates up to 7 are rounded, and divided by ds; so are triads.
        assert np.abs(f).max() <= 16 * UNIT * 6 * 7 / ds
        assert np.abs(n).max() <= 16 * UNIT * (3 / ds + 6 * 7)


@pytest.mark.parametrize("handedness", ["right", "left"])
def test_helix_strain(handedness):
    """A helix has the strain (0, curvature, torsion) of its formula, to second order."""
    radius, pitch = 0.4, 1.5
    c = {"right": 1.0, "left": -1.0}[handedness] * pitch / (2 * np.pi)
    exact = np.array([0.0, radius, c]) / (radius**2 + c**2)
    errors = []
    for nodes in (41, 81, 161):
        line = mrs.geometry.helix(radius, pitch, 3.0, nodes, handedness=handedness, phase=0.3)
        D = oracle.triads(line.quaternions)
        ds = np.linalg.norm(np.diff(line.nodes, axis=0), axis=1)[0]
        one = np.ones(3)  # with unit moduli and no intrinsic strain a moment is the strain
        _, N = oracle.internal(line.nodes, D, 7, 8, ds, one, one, np.zeros(3))
        errors.append(np.abs(oracle.half_triad(D[7], D[8]) @ N - exact).max())
    np.testing.assert_allclose(oracle.orders(errors), 2.0, atol=0.02)


# --- second order in ds -------------------------------------------------------------------


FINE = 512  # points of the spectral reference


def curve(s):
    """Return a smooth closed curve and triads that do not follow it, for s in [0, 2 pi)."""
    X = np.column_stack(
        [np.cos(s) + 0.1 * np.sin(2 * s), np.sin(s) - 0.05 * np.cos(3 * s), 0.2 * np.sin(2 * s)]
    )
    o = np.zeros_like(s)
    ring = [[-np.cos(s), -np.sin(s), o], [o, o, o + 1.0], [-np.sin(s), np.cos(s), o]]
    tilt = np.column_stack([0.2 * np.sin(s), 0.1 * np.cos(2 * s), 0.3 * np.sin(s + 1.0)])
    D = np.einsum("nij,knj->nki", Rotation.from_rotvec(tilt).as_matrix(), np.moveaxis(ring, 1, 2))
    return X, D


def bent(s, t=0.0):
    """Return an intrinsic strain along the curve."""
    return np.column_stack([0.3 * np.cos(s), 0.2 * np.sin(2 * s), 0.1 + 0.0 * s])


def derivative(values):
    """Return d/ds of samples at FINE points of a period 2 pi, to rounding."""
    wave = 1j * np.fft.fftfreq(FINE, 1.0 / FINE).reshape(-1, *[1] * (values.ndim - 1))
    return np.fft.ifft(wave * np.fft.fft(values, axis=0), axis=0).real


def continuum(a, b):
    """Return force and torque on the fluid per length, and the energy per length."""
    s = 2 * np.pi * np.arange(FINE) / FINE
    X, D = curve(s)
    slope, change = derivative(X), derivative(D)
    pull = np.einsum("nij,nj->ni", D, slope) - Z
    pairs = ((1, 2), (2, 0), (0, 1))
    strain = np.stack([(change[:, i] * D[:, j]).sum(axis=1) for i, j in pairs], axis=1) - bent(s)
    F, N = (np.einsum("ni,nij->nj", m * e, D) for m, e in ((b, pull), (a, strain)))
    energy = 0.5 * (b * pull**2 + a * strain**2).sum(axis=1)
    return derivative(F), derivative(N) + np.cross(slope, F), energy


def ring_of(nodes, a, b, **options):
    """Return a rod whose segments have length 2 pi / nodes at rest, and its smooth state."""
    ds = 2 * np.pi / nodes
    rod = mrs.Rods(
        mrs.geometry.ring(0.5 * ds / np.sin(0.5 * ds), nodes),
        bending=[a[:2]],
        twisting=a[2],
        shearing=[b[:2]],
        stretching=b[2],
        intrinsic_curvature=bent,
        **options,
    )
    X, D = curve(ds * np.arange(nodes))
    return rod, State(X, Rotation.from_matrix(D.transpose(0, 2, 1)).as_quat())


NODES = np.array([32, 64, 128, 256])
A, B = np.array([1.0, 1.5, 0.7]), np.array([2.0, 3.0, 4.0])


def test_loads_converge():
    """Loads per length, and energy, tend to dF/ds, dN/ds + X_s x F and its integral as ds^2."""
    exact_f, exact_n, density = continuum(A, B)
    total = 2 * np.pi * density.mean()
    errors = []
    for nodes in NODES:
        (rod, state), ds = ring_of(nodes, A, B), 2 * np.pi / nodes
        f, n = rod.loads(0.0, state)
        pick = slice(None, None, FINE // nodes)
        error_f = np.abs(f / ds - exact_f[pick]).max()
        error_n = np.abs(n / ds - exact_n[pick]).max()
        errors.append([error_f, error_n, abs(rod.energy(0.0, state) - total)])
    # Higher terms are some per cent at 64 nodes.
    np.testing.assert_allclose(oracle.orders(errors)[1:], 2.0, atol=0.1)


def evolved(nodes, t):
    """Return where a smooth ring is after a time t, at 16 material points."""
    rod, state = ring_of(nodes, 0.05 * A, B, epsilon=0.5)
    sim = mrs.Simulation(
        mrs.Fluid(), [rod], backend="direct", integrator=mrs.Integrator("rk4", 0.025)
    )
    sim.state = state
    return sim.run(t).state.positions[:: nodes // 16]


def test_motion_converges():
    """Differences between successive halvings of ds fall by four: the motion is of second order."""
    shapes = [evolved(nodes, 0.25) for nodes in (16, 32, 64, 128)]
    steps = [np.abs(a - b).max() for a, b in itertools.pairwise(shapes)]
    assert steps[0] > 1e-3
    # The blob, 0.5, is 1.3 spacings at 16 nodes and five at 64, where the order is reached.
    assert oracle.orders(steps)[-1] == pytest.approx(2.0, abs=0.1)


# --- rod and fluid together ---------------------------------------------------------------


def decay_rate(kind, x, ratio):
    """Return the rate of one mode of a long straight rod, and the theory for an infinite one.

    The mode, cos(k s), puts no stress on the free ends; the Rayleigh quotient is over the middle
    half of 20 wavelengths. What lies beyond the ends changes it by some 1e-5.
    """
    mu, epsilon, modulus, waves = 0.7, 0.3, 3.0, 20
    nodes = round(waves * 2 * np.pi / (x * ratio)) + 1
    ds = ratio * epsilon
    k = 2 * np.pi * waves / ((nodes - 1) * ds)
    line = mrs.geometry.straight((nodes - 1) * ds, nodes)
    rod = mrs.Rods(line, bending=1, twisting=modulus, shearing=1, stretching=modulus)
    sim = mrs.Simulation(mrs.Fluid(mu, epsilon), [rod], backend="direct")
    mode, small, x = np.cos(k * line.nodes[:, 2]), 1e-5, k * epsilon
    if kind == "stretch":
        state = State(line.nodes + small * np.outer(mode, Z), line.quaternions)
        values = sim.scene.rates(0.0, state)[:nodes, 2]
        theory = modulus * k**2 * kv(0, x) / (2 * np.pi * mu)
    else:
        state = State(line.nodes, about(Z, small * mode))
        values = sim.scene.rates(0.0, state)[nodes:, 2]
        theory = 2 * x * kv(1, x) + x**2 * kv(2, x)
        theory *= modulus * k**2 / (8 * np.pi * mu * epsilon**2)
    middle = slice(nodes // 4, 3 * nodes // 4)
    rate = -(values[middle] @ mode[middle]) / (mode[middle] @ mode[middle])
    lattice = (np.sin(0.5 * k * ds) / (0.5 * k * ds)) ** 2
    return rate / small, theory, lattice


@pytest.mark.parametrize("kind", ["stretch", "twist"])
@pytest.mark.parametrize("x", [0.1, 0.25, 0.5, 1.0])
def test_decay_of_a_long_rod(kind, x):
    """Rates of stretch and twist with Bessel functions of x = k eps, within 2 %.

    On a lattice the second difference of cos(k s) is (sin(k ds / 2) / (k ds / 2))^2 times the
    second derivative. With that factor they agree to 3e-4: rounding of differences over 1e-5, the
    ends, and sums instead of integrals (1e-4 for the spin, whose kernel is the sharpest).
    """
    ratio = 0.5 if x < 0.3 else 0.25
    rate, theory, lattice = decay_rate(kind, x, ratio)
    assert rate == pytest.approx(theory, rel=0.02)
    assert rate == pytest.approx(theory * lattice, rel=3e-4)


OLC_DS = np.pi / 40
OLC_FLUID = mrs.Fluid(viscosity=1e-6, epsilon=6 * OLC_DS)
OLC_STRAIN = (1.3, 0.0, np.pi / 2)


def olc(name, dt="auto", tolerance=1e-2):
    """Return the open rod of physics.md 4 (g, um, s), straight with triads tilted by 1e-4."""
    line = mrs.geometry.straight(75 * OLC_DS, 76)
    rod = mrs.Rods(
        line._replace(quaternions=about([1, 0, 0], np.full(76, 1e-4))),
        bending=3.5e-3,
        twisting=3.5e-3,
        shearing=0.8,
        stretching=0.8,
        intrinsic_curvature=OLC_STRAIN,
    )
    integrator = mrs.Integrator(name, dt, tolerance)
    return mrs.Simulation(OLC_FLUID, [rod], backend="direct", integrator=integrator)


def test_straight_rod_coils():
    """To a helix of radius k / (k^2 + t^2) and pitch 2 pi t / (k^2 + t^2)."""
    k, _, t = OLC_STRAIN
    radius, pitch = oracle.fitted_helix(olc("rkc2").run(0.4).state.positions)
    # The last mode, bending, decays as exp(-12 t): 2e-5 of the coil is left after 0.4 s.
    assert radius == pytest.approx(k / (k**2 + t**2), rel=1e-4)
    # Turns of 2 asin(|O| ds / 2) a segment for |O| ds, and segments on chords: a pitch that is
    # shorter by (|O| ds)^2 / 24; the radius is exact.
    shorter = 1.0 - (k**2 + t**2) * OLC_DS**2 / 24
    assert pitch == pytest.approx(2 * np.pi * t / (k**2 + t**2) * shorter, rel=1e-4)


def test_relaxed_pitch_is_of_second_order():
    k, _, t = OLC_STRAIN
    errors = []
    for finer in (1, 2, 4):
        line = mrs.geometry.at_rest(OLC_STRAIN, OLC_DS / finer, 75 * finer + 1)
        radius, pitch = oracle.fitted_helix(line.nodes)
        assert radius == pytest.approx(k / (k**2 + t**2), rel=1e-12)
        errors.append(abs(pitch - 2 * np.pi * t / (k**2 + t**2)))
    np.testing.assert_allclose(oracle.orders(errors), 2.0, atol=0.01)


def test_balanced_at_every_step():
    """No net force or torque along the first and fastest part of a run."""
    sim = olc("rkc2")
    for _ in range(15):
        sim.step(0.1)
        now = sim.now
        assert_balanced(now.points, now.loads[:, :3], now.loads[:, 3:])
    assert np.ptp(sim.state.positions[:, 0]) > 1e-3  # it has begun to coil


# --- stiffness ------------------------------------------------------------------------------


def test_euler_limit():
    """Of the set of OLC it is 7.3e-6 s: 7.0e-6 holds and 8.5e-6 blows up, after a warning."""
    start = olc("euler").energy()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert olc("euler", 7.0e-6).run(300 * 7.0e-6).energy() < 0.5 * start
    with pytest.warns(UserWarning, match=r"dt: 8.5e-06 is beyond the stability limit 7\.\d+e-06"):
        unstable = olc("euler", 8.5e-6).run(300 * 8.5e-6)
    assert unstable.energy() > 2.0 * start


def test_stabilised_method_pays():
    """For the same time rkc2 takes at most a fifth of Euler's evaluations, and no warning."""
    t = 0.01
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        euler, stabilised = olc("euler", 7.0e-6).run(t), olc("rkc2", 1e-3).run(t)
    assert euler.mobility.evaluations >= t / 7.0e-6
    assert 5 * stabilised.mobility.evaluations <= euler.mobility.evaluations
    assert stabilised.energy() < 0.1 * olc("euler").energy()


# --- symmetry -------------------------------------------------------------------------------


def scene(turn, shift):
    """Return a soft rod and swimmers in a shear flow, all of it turned and shifted.

    The flow of the shifted scene is taken about the shifted origin.
    """
    moved = {"shift": shift, "rotation": turn}
    lines = [
        mrs.geometry.at_rest((1.0, 0.5, 0.3), 0.1, 12).moved(**moved),
        mrs.geometry.ring(0.3, 10, origin=(1.0, 0.5, 0.0)).moved(**moved),
    ]
    rod = mrs.Rods(
        lines,
        bending=0.02,
        twisting=0.02,
        shearing=0.5,
        stretching=0.5,
        intrinsic_curvature=(1, 0, 2),
    )
    x, p = np.array([[0.5, -0.5, 0.5], [-0.5, 0.2, 0.9]]), np.array([[0, 0.6, 0.8], [0, 0, -1.0]])
    swimmers = mrs.Swimmers(turn.apply(x) + shift, turn.apply(p), length=0.4, force=0.5)
    R = turn.as_matrix()
    G = R @ np.array([[0, 0, 1.0], [0, 0, 0], [0, 0, 0]]) @ R.T
    flow = mrs.flows.QuadraticFlow(gradient=G, constant=-G @ shift)
    integrator = mrs.Integrator("heun", 0.01)
    return mrs.Simulation(
        mrs.Fluid(1.0, 0.2, flow), [rod, swimmers], backend="direct", integrator=integrator
    )


def test_turned_scene_has_turned_trajectory():
    turn, shift = Rotation.from_rotvec([0.5, -1.0, 2.0]), np.array([3.0, -4.0, 2.0])
    plain = scene(Rotation.identity(), np.zeros(3))
    start = plain.state.positions
    plain.run(0.3)
    turned = scene(turn, shift).run(0.3)
    assert np.abs(plain.state.positions - start).max() > 0.1
    expected = turn.apply(plain.state.positions) + shift
    # Coordinates are rounded to 1e-15; forces amplify that by moduli / ds ~ 5 and 30 steps add up.
    np.testing.assert_allclose(turned.state.positions, expected, rtol=0, atol=1e-12)
    for k, body in enumerate(plain.bodies):
        directors = slice(None) if body.kind == "rods" else slice(2, 3)  # a swimmer has only p
        before, after = (
            oracle.triads(sim.body_state(sim.bodies[k])[1])[:, directors].reshape(-1, 3)
            for sim in (plain, turned)
        )
        np.testing.assert_allclose(after, turn.apply(before), rtol=0, atol=1e-12)
