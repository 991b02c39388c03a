"""Rods whose moduli, blobs and spacing differ along s: what arguments mean, rest, orders in ds."""

import itertools
import warnings

import numpy as np
import pytest

import mrs
from mrs.run import scenario_files
from mrs.time.state import State
from tests.cases import rod_oracle as oracle

SEGMENTS = (3, 4, 2)  # of three rods
ROD = np.repeat(range(3), SEGMENTS)
MIDDLE = np.concatenate([0.1 * (np.arange(n) + 0.5) for n in SEGMENTS])  # s of the segments
STRAINS = np.array([[0.7, 0.3, 0.6], [0.2, -0.9, -0.4], [0.5, 0.4, 0.8]])
MODULI = {"bending": 1.0, "twisting": 1.0, "shearing": 1.0, "stretching": 1.0}

# What is given, and the numbers for D1 and D2 of each segment that it means.
EACH, ROWS = np.arange(1.0, 10.0), np.arange(1.0, 19.0).reshape(9, 2)
NUMBERS = [
    (5.0, np.full(9, 5.0)),
    ([2.0, 10.0, 4.0], np.array([2.0, 10.0, 4.0])[ROD]),
    (EACH, EACH),
    (lambda s: 7.0, np.full(9, 7.0)),
    (lambda s: 1.0 + s**2, 1.0 + MIDDLE**2),
    (mrs.Taper(4.0, 1.0, 0.3), 4.0 - 3.0 * np.minimum(MIDDLE / 0.3, 1.0)),
]
PAIRS = [
    *[(given, np.column_stack([meant, meant])) for given, meant in NUMBERS],
    ([[5.0]], np.full((9, 2), 5.0)),
    ([[2.0, 10.0]], np.tile([2.0, 10.0], (9, 1))),
    ([[2.0], [10.0], [4.0]], np.array([[2.0, 2.0], [10.0, 10.0], [4.0, 4.0]])[ROD]),
    ([[2.0, 10.0], [3.0, 7.0], [4.0, 6.0]], np.array([[2.0, 10.0], [3.0, 7.0], [4.0, 6.0]])[ROD]),
    (EACH[:, None], np.column_stack([EACH, EACH])),
    (ROWS, ROWS),
    (lambda s: [[2.0, 10.0]], np.tile([2.0, 10.0], (9, 1))),
    (
        lambda s: np.column_stack([1.0 + s, 2.0 - s]),
        np.column_stack([1.0 + MIDDLE, 2.0 - MIDDLE]),
    ),
    (
        mrs.Taper([4.0, 6.0], [1.0, 2.0], 0.4),
        [4.0, 6.0] - np.outer(MIDDLE / 0.4, [3.0, 4.0]),
    ),
]


def bent(**options):
    """Return three rods in the shapes of constant strains, which are straight at rest."""
    lines = [mrs.geometry.at_rest(k, 0.1, n + 1) for k, n in zip(STRAINS, SEGMENTS, strict=True)]
    return mrs.Rods(lines, intrinsic_curvature=(0, 0, 0), **(MODULI | options))


def energy(body, positions=None):
    state = State(body.positions if positions is None else positions, body.quaternions)
    return body.energy(0.0, state)


@pytest.mark.parametrize(("given", "meant"), PAIRS)
def test_bending(given, meant):
    """The energy is sum 1/2 (a1 k1^2 + a2 k2^2 + a3 k3^2) ds: constant strains are exact."""
    moduli = np.column_stack([meant, np.ones(9)])
    expected = 0.5 * 0.1 * (moduli * STRAINS[ROD] ** 2).sum()
    assert energy(bent(bending=given)) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(("given", "meant"), NUMBERS)
def test_twisting(given, meant):
    moduli = np.column_stack([np.ones(9), np.ones(9), meant])
    expected = 0.5 * 0.1 * (moduli * STRAINS[ROD] ** 2).sum()
    assert energy(bent(twisting=given)) == pytest.approx(expected, rel=1e-12)


SHIFTS = np.array([[0.3, 0.1, 0.2], [-0.2, 0.4, 0.1], [0.05, 0.5, -0.3]])


def shifted(**options):
    """Return the energy of straight rods with a constant shear and stretch each."""
    body = mrs.Rods([mrs.geometry.straight(0.1 * n, n + 1) for n in SEGMENTS], **(MODULI | options))
    s = np.concatenate([0.1 * np.arange(n + 1) for n in SEGMENTS])
    return energy(body, body.positions + s[:, None] * SHIFTS[body.rod_of_node])


@pytest.mark.parametrize(("given", "meant"), PAIRS)
def test_shearing(given, meant):
    moduli = np.column_stack([meant, np.ones(9)])
    expected = 0.5 * 0.1 * (moduli * SHIFTS[ROD] ** 2).sum()
    assert shifted(shearing=given) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(("given", "meant"), NUMBERS)
def test_stretching(given, meant):
    moduli = np.column_stack([np.ones(9), np.ones(9), meant])
    expected = 0.5 * 0.1 * (moduli * SHIFTS[ROD] ** 2).sum()
    assert shifted(stretching=given) == pytest.approx(expected, rel=1e-12)


S = np.concatenate([0.1 * np.arange(n + 1) for n in SEGMENTS])  # of the nodes
BLOBS = [
    (0.2, np.full(12, 0.2)),
    ([0.2, 0.3, 0.1], np.array([0.2, 0.3, 0.1])[np.repeat(range(3), [4, 5, 3])]),
    (np.arange(1.0, 13.0), np.arange(1.0, 13.0)),
    (lambda s: 0.2 - 0.1 * s, 0.2 - 0.1 * S),
    # Quarters of 0.4: [0, 0.1), [0.1, 0.2), ...; nodes are moved off their bounds.
    (lambda s: mrs.Taper(0.5, 0.1, 0.4, steps=4)(s + 0.01), 0.45 - np.minimum(S, 0.3)),
]


@pytest.mark.parametrize(("given", "meant"), BLOBS)
def test_blobs_and_radii(given, meant):
    body = bent(epsilon=given, radius=given)
    np.testing.assert_allclose(body.epsilons(9.0), meant, rtol=1e-12)
    np.testing.assert_allclose(body.constant_fields(np.ones(12))[0]["radius"], meant, rtol=1e-12)


REFUSED = [
    ({"bending": [1, 10]}, r"bending: \[1, 10\] could be meant for two rods, two segments or two"),
    ({"bending": np.ones(12)}, r"bending must be .*shape \(3,\).*\(9,\).*got shape \(12,\)"),
    ({"bending": lambda s: np.ones(3)}, r"bending must be .*function of s .*got shape \(3,\)"),
    ({"twisting": np.ones((9, 2))}, r"twisting must be .*for each segment, \(9,\); or"),
    ({"twisting": [1.0]}, r"twisting must be .*got shape \(1,\)"),
    ({"stretching": lambda s: s - 0.1}, r"greater than 0, got -0\.05 at stretching\[0\]"),
    ({"shearing": lambda s: np.nan * s}, "shearing must be finite"),
    ({"epsilon": np.ones(9)}, r"epsilon must be .*for each node, \(12,\).*got shape \(9,\)"),
    ({"radius": lambda s: "thin"}, "radius must hold real numbers, got 'thin'"),
]  # fmt: skip


@pytest.mark.parametrize(("options", "message"), REFUSED)
def test_what_is_refused(options, message):
    with pytest.raises((TypeError, ValueError), match=message):
        bent(**options)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((1.0, [1.0, 2.0], 1.0), r"tip must have shape \(\), got shape \(2,\)"),
        (([[1.0]], [[1.0]], 1.0), r"root must be a number or a vector, got shape \(1, 1\)"),
        ((1.0, 2.0, 0.0), "length must be .*got 0"),
        ((1.0, 2.0, 1.0, 0), "steps must be an integer from 1 .*got 0"),
    ],
)
def test_tapers_that_are_refused(arguments, message):
    with pytest.raises((TypeError, ValueError), match=message):
        mrs.Taper(*arguments)


def test_tapers_in_toml():
    taper = {"root": 2.0, "tip": 1.0, "length": 0.4}
    rod = MODULI | {
        "shape": {"kind": "straight", "length": 0.4, "nodes": 5, "grading": "cosine"},
        "bending": taper,
        "epsilon": taper | {"steps": 2},
        "beat": {
            "amplitude": {"root": [0, 0, 0], "tip": [1, 0, 0], "length": 0.4},
            "wavelength": 1.0,
            "period": 1.0,
        },
    }
    sim = scenario_files.make("scene", {"rods": [rod]}).simulation()
    (body,) = sim.bodies
    s = 0.2 - 0.2 * np.cos(np.pi * np.arange(5) / 4)
    middle = 0.5 * (s[1:] + s[:-1])
    np.testing.assert_allclose(body._moduli[:, 0], 2.0 - middle / 0.4, rtol=1e-12)
    assert set(sim.scene.epsilons) == {1.75, 1.25}
    strain = body.intrinsic_curvature(0.25)
    np.testing.assert_allclose(
        strain[:, 0], middle / 0.4 * np.sin(2 * np.pi * (middle - 0.25)), atol=1e-12
    )
    scene = scenario_files.make("scene", {"rods": [rod | {"bending": {"rot": 1.0}}]})
    with pytest.raises(mrs.ScenarioError, match=r"rods\.0: bending: .* 'rot'; did you mean 'root'"):
        scene.simulation()


def test_many_blob_sizes_are_told():
    """Each is a sum: a taper without steps has one for each node."""
    line = mrs.geometry.straight(1.0, 20)
    fluid = mrs.Fluid()
    with pytest.warns(UserWarning, match=r"epsilon has 20 different values .*steps=8"):
        mrs.Simulation(fluid, [mrs.Rods(line, epsilon=mrs.Taper(0.2, 0.1, 1.0), **MODULI)])
    few = mrs.Rods(line, epsilon=mrs.Taper(0.2, 0.1, 1.0, steps=8), **MODULI)
    assert len(np.unique(mrs.Simulation(fluid, [few]).scene.epsilons)) == 8


# --- a beat that grows along s --------------------------------------------------------------------


def test_a_wave_that_grows():
    """Amplitudes as functions of s, and a taper from the root to the tip."""
    s, t = np.linspace(0.0, 2.0, 7), np.full(7, 0.3)
    sine = np.sin(2 * np.pi * (s / 1.5 - 0.3 / 0.8))
    for amplitude in (mrs.Taper([0, 0, 0], [2, 0, -1], 2.0), lambda s: np.outer(s / 2, [2, 0, -1])):
        wave = mrs.TravellingWave(amplitude, wavelength=1.5, period=0.8)
        expected = (sine * s / 2)[:, None] * [2, 0, -1]
        np.testing.assert_allclose(wave(s, t), expected, atol=1e-14)
    with pytest.raises(ValueError, match=r"amplitude must give shape \(3,\) or \(7, 3\)"):
        mrs.TravellingWave(lambda s: s, 1.5, 0.8)(s, t)


# --- segments of different lengths ----------------------------------------------------------------


def test_gradings():
    cosine = mrs.geometry.straight(2.0, 9, grading="cosine").nodes[:, 2]
    np.testing.assert_allclose(cosine, 1.0 - np.cos(np.pi * np.arange(9) / 8), atol=1e-14)
    helix = mrs.geometry.helix(0.3, 1.0, 2.0, 9, grading=lambda x: x**2)
    np.testing.assert_allclose(helix.nodes[:, 2], 2.0 * np.linspace(0, 1, 9) ** 2, atol=1e-14)
    for grading in (lambda x: 1 - x, lambda x: 0.5 * x, lambda x: np.minimum(2 * x, 1.0)):
        with pytest.raises(ValueError, match="grading must give numbers that rise from 0 to 1"):
            mrs.geometry.straight(1.0, 9, grading=grading)
    with pytest.raises(ValueError, match="grading must be one of 'uniform', 'cosine', got 'sine'"):
        mrs.geometry.straight(1.0, 9, grading="sine")


SPACING = 0.1 * np.array([1.0, 0.3, 2.0, 0.7, 1.5, 1.0, 0.2])
UNEVEN = {
    "bending": lambda s: np.column_stack([1.0 + s, 2.0 - s]),
    "twisting": lambda s: 1.0 + s**2,
    "shearing": mrs.Taper([4.0, 5.0], [1.0, 3.0], 0.67),
    "stretching": 6.0 + np.arange(7.0),
}


def test_rest_with_uneven_segments_and_moduli():
    """The shape of `at_rest` is free of loads, to rounding."""
    strain = np.array([1.3, 0.2, 1.6])
    line = mrs.geometry.at_rest(strain, SPACING, 8)
    body = mrs.Rods(line, intrinsic_curvature=strain, **UNEVEN)
    np.testing.assert_allclose(body.spacing, SPACING, rtol=1e-14)
    for load in body.loads(0.0, State(body.positions, body.quaternions)):
        # Rounding of coordinates up to 1 over the least spacing, 0.02, times moduli up to 12.
        assert np.abs(load).max() <= 16 * 2.0**-53 * 12 / 0.02


def test_loads_with_uneven_segments_and_moduli():
    """As the oracle's, and without net force and torque, in a random state."""
    rng = np.random.default_rng(3)
    body = mrs.Rods(mrs.geometry.at_rest((1.3, 0.2, 1.6), SPACING, 8), **UNEVEN)
    X = body.positions + 0.05 * rng.normal(size=(8, 3))
    turned = mrs.rotations.exponential(0.3 * rng.normal(size=(8, 3)))
    q = mrs.rotations.multiply(turned, body.quaternions)
    s = np.cumsum(SPACING) - 0.5 * SPACING
    a = np.column_stack([1.0 + s, 2.0 - s, 1.0 + s**2])
    b = np.column_stack([4.0 - 3.0 * s / 0.67, 5.0 - 2.0 * s / 0.67, 6.0 + np.arange(7)])
    D, f, n = oracle.triads(q), np.zeros((8, 3)), np.zeros((8, 3))
    for k in range(7):
        two = slice(k, k + 2)
        pair = oracle.rod_loads(X[two], D[two], SPACING[[k]], a[k], b[k], [(1.3, 0.2, 1.6)])
        f[two] += pair[0]
        n[two] += pair[1]
    loads = body.loads(0.0, State(X, q))
    for mine, theirs in zip(loads, (f, n), strict=True):
        np.testing.assert_allclose(mine, theirs, rtol=0, atol=1e-12 * np.abs(theirs).max())
    torque = np.cross(X, loads[0]) + loads[1]
    for mine, size in ((loads[0], loads[0]), (torque, torque)):
        assert np.abs(mine.sum(axis=0)).max() <= 64 * 2.0**-53 * 8 * np.abs(size).max()


# --- second order in ds ---------------------------------------------------------------------------


def relaxed(segments, grading):
    """Return where a tapered rod with curvature that grows along it is after a while.

    At nine material points: gradings are functions of one variable, so that nodes coincide.
    """
    line = mrs.geometry.straight(1.0, segments + 1, grading=grading)
    rod = mrs.Rods(
        line,
        bending=mrs.Taper([0.02, 0.03], [0.004, 0.006], 1.0),
        twisting=mrs.Taper(0.02, 0.005, 1.0),
        shearing=lambda s: 2.0 - s,
        stretching=lambda s: 2.0 - s,
        intrinsic_curvature=lambda s, t: np.outer(1.0 + s, [1.0, 0.5, 0.8]),
        epsilon=lambda s: 0.3 - 0.1 * s,
    )
    sim = mrs.Simulation(
        mrs.Fluid(), [rod], backend="direct", integrator=mrs.Integrator("rk4", 0.05)
    )
    return sim.run(0.5).state.positions[:: segments // 8]


@pytest.mark.parametrize("grading", ["uniform", "cosine"])
def test_relaxation_of_a_tapered_rod_is_of_second_order(grading):
    """Differences between successive halvings of ds fall by four, with even and uneven segments."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "epsilon has .* different values")
        shapes = [relaxed(segments, grading) for segments in (8, 16, 32, 64)]
    steps = [np.abs(a - b).max() for a, b in itertools.pairwise(shapes)]
    assert steps[-1] > 1e-7  # far above rounding
    assert oracle.orders(steps)[-1] == pytest.approx(2.0, abs=0.1)
