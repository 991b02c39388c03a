"""What users give the simulator: shapes with one meaning, refusals by name, functions' values."""

import inspect
import re

import numpy as np
import pytest

import mrs
from mrs.output import checkpoint
from mrs.run import scenario_files
from mrs.time.state import State

MODULI = {"bending": 1.0, "twisting": 1.0, "shearing": 1.0, "stretching": 1.0}
LINE = mrs.geometry.straight(1.0, 5)
FLUID = mrs.Fluid(epsilon=0.1)


def rods(count=1, **options):
    return mrs.Rods([LINE] * count, **(MODULI | options))


# --- moduli ---------------------------------------------------------------------------------

# Number of rods, what is given, and what it means: a row (D1, D2) for each rod.
SHAPES = [
    (1, 5.0, [[5, 5]]),
    (1, [5.0], [[5, 5]]),
    (1, [[2, 10]], [[2, 10]]),
    (2, 5, [[5, 5], [5, 5]]),
    (2, [[2, 10]], [[2, 10], [2, 10]]),
    (2, [[2], [10]], [[2, 2], [10, 10]]),
    (2, [[2, 10], [3, 7]], [[2, 10], [3, 7]]),
    (3, [2, 10, 4], [[2, 2], [10, 10], [4, 4]]),
    (3, [[2, 10]], [[2, 10]] * 3),
    (3, np.array([[2.0], [10.0], [4.0]]), [[2, 2], [10, 10], [4, 4]]),
    (3, [[2, 10], [3, 7], [4, 6]], [[2, 10], [3, 7], [4, 6]]),
]
REFUSED = [
    *[(count, [1, 10], r"\[1, 10\] could be meant .*\[\[1, 10\]\].*\[\[1\], \[10\]\]")
      for count in (1, 2, 3)],
    (3, [1, 2, 3, 4], r"shape \(3,\).*\(12,\).*\(1, 2\), \(3, 2\) or \(12, 2\).*got shape \(4,\)"),
    (3, [[1, 2], [3, 4]], r"got shape \(2, 2\)"),
    (2, [[1], [2], [3]], r"got shape \(3, 1\)"),
    (2, [[1, 2, 3]], r"got shape \(1, 3\)"),
    (2, np.ones((1, 2, 2)), r"got shape \(1, 2, 2\)"),
    (2, [[1, 2], [3]], "rows of one length"),
    (3, [1, -2, 3], r"greater than 0, got -2.0 at bending\[1\]"),
    (2, [[1, np.nan]], r"got nan at bending\[0, 1\]"),
    (2, np.ma.masked_equal([[1, 2]], 2), "masked"),
    (2, "stiff", "real numbers, got 'stiff'"),
]  # fmt: skip


@pytest.mark.parametrize(("count", "given", "meant"), SHAPES, ids=repr)
def test_bending_moduli(count, given, meant):
    """1/2 (a1 k1^2 + a2 k2^2) L of each rod: constant strains are exact on the staggered grid."""
    strains = np.array([[0.7, 0.3, 0.0], [0.2, -0.9, 0.0], [0.5, 0.4, 0.0]])[:count]
    bent = [mrs.geometry.at_rest(strain, 0.1, 6) for strain in strains]
    body = mrs.Rods(bent, intrinsic_curvature=(0, 0, 0), **(MODULI | {"bending": given}))
    expected = 0.5 * 0.5 * (np.array(meant) * strains[:, :2] ** 2).sum(axis=1)
    state = State(body.positions, body.quaternions)
    names = ("velocity", "force", "torque", "angular_velocity")
    _, at_cells = body.fields(0.0, state, **dict.fromkeys(names))
    np.testing.assert_allclose(at_cells["bending_energy"], expected, rtol=1e-13)


@pytest.mark.parametrize(("count", "given", "meant"), SHAPES, ids=repr)
def test_shearing_moduli(count, given, meant):
    """1/2 (b1 g1^2 + b2 g2^2) L of rods whose nodes are shifted against triads along the axes."""
    shear = np.array([[0.3, 0.1], [-0.2, 0.4], [0.05, 0.5]])[:count]
    body = rods(count, shearing=given)
    positions = body.positions.copy()
    positions[:, :2] += positions[:, 2:] * np.repeat(shear, 5, axis=0)
    expected = 0.5 * (np.array(meant) * shear**2).sum()
    assert body.energy(0.0, State(positions, body.quaternions)) == pytest.approx(expected, 1e-13)


@pytest.mark.parametrize(("count", "given", "message"), REFUSED, ids=repr)
def test_moduli_that_are_refused(count, given, message):
    with pytest.raises((TypeError, ValueError), match=f"bending.*{message}"):
        rods(count, bending=given)
    with pytest.raises((TypeError, ValueError), match=message.replace("bending", "shearing")):
        rods(count, shearing=given)


def test_moduli_in_toml_mean_the_same():
    options = {"shape": {"kind": "straight", "length": 1, "nodes": 5}, **MODULI}
    scene = {"fluid": {"epsilon": 0.1}, "rods": [options | {"origins": [[0, 0, 0], [1, 0, 0]]}]}
    scene["rods"][0]["bending"] = [1, 10]
    with pytest.raises(mrs.ScenarioError, match=r"rods\.0: bending: \[1, 10\] could be meant"):
        scenario_files.make("scene", scene).simulation()
    scene["rods"][0]["bending"] = [[1], [10]]
    (body,) = scenario_files.make("scene", scene).simulation().bodies
    np.testing.assert_array_equal(body._moduli[:, :2], np.repeat([[1, 1], [10, 10]], 4, axis=0))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: rods(intrinsic_curvature=1.3), r"intrinsic_curvature .*\(3,\) or \(4, 3\)"),
        (lambda: rods(intrinsic_curvature=np.ones((4, 1))), r"intrinsic_curvature .*\(4, 1\)"),
        (lambda: mrs.flows.QuadraticFlow(constant=1.0), r"constant .*\(3,\)"),
        (lambda: mrs.flows.QuadraticFlow(gradient=[1, 0, -1]), r"gradient .*\(3, 3\)"),
        (lambda: mrs.flows.QuadraticFlow(quadratic=np.zeros((3, 3))), r"quadratic .*\(3, 3, 3\)"),
        (lambda: mrs.geometry.straight(1.0, 5, origin=1.0), r"origin .*\(3,\), got shape \(\)"),
        (lambda: mrs.geometry.straight(1.0, 5, direction=1.0), r"direction .*\(3,\)"),
        (lambda: LINE.moved(1.0), r"shift .*\(3,\)"),
    ],
)  # fmt: skip
def test_a_number_is_no_vector(make, message):
    """One number for all components would be a direction that nobody asked for."""
    with pytest.raises(ValueError, match=message):
        make()


# --- refused when made ------------------------------------------------------------------------

BAD = [
    (lambda: mrs.Fluid(background=3.0), "background must be a flow .*got 3.0"),
    (lambda: mrs.Fluid(epsilon=-1), "epsilon must be a number between .*got -1"),
    (lambda: mrs.Fluid(viscosity="thick"), "viscosity must be a number between .*got 'thick'"),
    (lambda: mrs.TravellingWave((1, 0, 0), 0, 1), "wavelength must be .*got 0"),
    (lambda: mrs.TravellingWave((1, 0, 0), 1, 0), "period must not be zero"),
    (lambda: mrs.TravellingWave((1, 0, 0), 1, np.nan), "period must be .*got nan"),
    (lambda: mrs.TravellingWave((1, 0), 1, 1), r"amplitude must have shape \(3,\)"),
    (lambda: mrs.Drive(velocity=5.0), r"velocity must be a function of time, or have shape \(3,\)"),
    (lambda: mrs.Drive(angular_velocity=(0, 0, np.inf)), r"angular_velocity .*angular_velocity\[2"),
    (lambda: mrs.Steric(-1.0, 1.0), "strength must be .*got -1.0"),
    (lambda: mrs.Steric(1.0, 0.0), "radius must be .*got 0.0"),
    (lambda: mrs.Steric(1.0, 1.0, chi=1.0), "chi must be a number between 1 and .*got 1.0"),
    (lambda: mrs.Integrator("rk5"), "name must be one of .*'bdf', got 'rk5'"),
    (lambda: mrs.Integrator(dt="never"), "dt must be 'auto' or a positive number, got 'never'"),
    (lambda: mrs.Integrator(dt=0.0), "dt must be .*got 0.0"),
    (lambda: mrs.Integrator(tolerance=1.0), "tolerance must be .*got 1.0"),
    (lambda: mrs.Backend("fnm"), "name must be one of .*'fmm'.*, got 'fnm'"),
    (lambda: mrs.Backend("kitc", theta=1.5), "theta must be .*got 1.5"),
    (lambda: mrs.Backend("kitc", degree=2.5), "degree must be .*got 2.5"),
    (lambda: mrs.Backend("auto", degree=3), "degree must be None with backend 'auto'"),
    (lambda: mrs.Backend("direct", precision="half"), "precision must be one of .*got 'half'"),
    (lambda: mrs.Backend("kitc", precision="float32"), "precision must be None with tol"),
    (lambda: mrs.Backend(tolerance=0.0), "tolerance must be .*got 0.0"),
    (lambda: mrs.Output("run", interval="abc"), "interval must be .*got 'abc'"),
    (lambda: mrs.Output("run", interval=0.0), "interval must be .*got 0.0"),
    (lambda: mrs.Output(3, interval=0.1), "directory must be a path, got 3"),
    (lambda: mrs.Output("run", 0.1, -1.0), r"checkpoint_seconds .*0 \(inclusive\) and .*got -1.0"),
    (lambda: mrs.Output("run", 0.1, overwrite="no"), "overwrite must be True or False, got 'no'"),
    (lambda: mrs.Output("run", 0.1, formats=["vtk"]), r"formats\[0\] must be one of .*got 'vtk'"),
    (lambda: mrs.Output("run", 0.1, formats="pvd"), "formats must be a list of texts, got 'pvd'"),
    (lambda: mrs.flows.shear("fast"), "rate must be a number .*got 'fast'"),
    (lambda: mrs.flows.poiseuille(np.nan, 1.0), "speed must be a number .*got nan"),
    (lambda: mrs.flows.UserFlow(1.0), "velocity must be a function of points and time, got 1.0"),
    (lambda: mrs.geometry.ring(1.0, 9, twist="a"), "twist must be a number .*got 'a'"),
    (lambda: mrs.geometry.helix(1, 1, 1, 9, phase=np.nan), "phase must be a number .*got nan"),
    (lambda: LINE.moved(rotation=1.0), "rotation must be one scipy.*got 1.0"),
    (lambda: mrs.random_suspension(5, 1.0, -0.1), r"spacing .*between 0 \(inclusive\) .*got -0.1"),
    (lambda: rods(beat=1.0), r"beat must be a function of \(s, t\), got 1.0"),
    (lambda: mrs.Rods(LINE._replace(quaternions=0.0 * LINE.quaternions), **MODULI), "not be zero"),
    (lambda: mrs.Rods([LINE._replace(nodes=LINE.nodes[1:]), LINE], **MODULI),
     r"centerlines\[0\].quaternions must have shape \(4, 4\), got \(5, 4\)"),
    (lambda: mrs.Simulation(3.0, [rods()]), "fluid must be mrs.Fluid, got 3.0"),
    (lambda: mrs.Simulation(FLUID, rods()), r"bodies must be a list of mrs.Body, in brackets also"),
    (lambda: mrs.Simulation(FLUID, 3), "bodies must be a list of mrs.Body"),
    (lambda: mrs.Simulation(FLUID, [rods(), 3]), r"bodies\[1\] must be mrs.Body, got 3"),
    (lambda: mrs.Simulation(FLUID, [rods()], backend="fnm"), "backend must be .*'fmm'.*got 'fnm'"),
    (lambda: mrs.Simulation(FLUID, [rods()], integrator="rk5"), "integrator must be .*got 'rk5'"),
    (lambda: mrs.Simulation(FLUID, [rods()], output="run"), "output must be mrs.Output or None"),
    (lambda: mrs.Simulation(FLUID, [rods()]).run(1.0, max_walltime=np.nan), "max_walltime .*nan"),
]  # fmt: skip


@pytest.mark.parametrize(("make", "message"), BAD, ids=[message[:40] for _, message in BAD])
def test_refused_when_made(make, message):
    with pytest.raises((TypeError, ValueError), match=message):
        make()


def test_bodies_of_ones_own_have_a_public_base():
    """What the refusal of bodies names exists."""
    assert issubclass(mrs.Rods, mrs.Body)


@pytest.mark.parametrize(
    "what",
    [
        mrs.Backend, mrs.Drive, mrs.Fluid, mrs.Integrator, mrs.Output, mrs.Rods, mrs.Simulation,
        mrs.Steric, mrs.Swimmers, mrs.Tracers, mrs.TravellingWave, mrs.flows.QuadraticFlow,
        mrs.flows.UserFlow, mrs.flows.extension, mrs.flows.poiseuille, mrs.flows.shear,
        mrs.geometry.at_rest, mrs.geometry.helix, mrs.geometry.ring, mrs.geometry.straight,
        mrs.lattice_suspension, mrs.random_suspension,
    ],
)  # fmt: skip
def test_misspelt_arguments(what):
    """Of every argument the name with two letters exchanged leads to the name."""
    for name in inspect.signature(what).parameters:
        wrong = name[:-3] + name[-2] + name[-3] + name[-1] if len(name) > 3 else name + name[-1]
        if wrong == name:
            continue
        with pytest.raises(TypeError, match=f"{what.__name__}.*{wrong!r}; did you mean {name!r}"):
            what(**{wrong: 1.0})


# --- users' functions ---------------------------------------------------------------------------


def late_nan(s, t):
    """Return a curvature that is not a number from time 0.05 on."""
    return np.column_stack([np.where(t > 0.05, np.nan, 1.0), 0.0 * s, 0.0 * s])


def late_drive(t):
    return np.column_stack([np.where(t > 0.05, np.inf, 1.0), 0.0 * t, 0.0 * t])


def late_flow(points, time):
    return np.where((time > 0.05) & (points[:, 2:] > 0.9), np.nan, points)


FUNCTIONS = [
    ({"beat": late_nan}, None, r"beat must give finite numbers, got \[nan +0. +0.\] for rod 0 of "
     r"'rods' at s = 0.125 and its own time 0\.0\d+"),
    ({"intrinsic_curvature": late_nan}, None, "intrinsic_curvature must give finite .* rod 0 "),
    ({"base": mrs.Drive(velocity=late_drive)}, None, "base: velocity must .*inf.* for rod 0 "),
    ({}, mrs.flows.UserFlow(late_flow, late_flow), r"background velocity must .*nan.* at node 4 "
     r"of 'rods', \[0.*\], and time 0\.0\d+"),
]  # fmt: skip


@pytest.mark.parametrize(("options", "flow", "message"), FUNCTIONS, ids=lambda v: str(v)[:12])
def test_a_function_that_gives_nan_is_named(options, flow, message, tmp_path):
    """Not the step, of which no size would help; the last sound state stays in the checkpoint."""
    sim = mrs.Simulation(
        mrs.Fluid(epsilon=0.3, background=flow),
        [rods(**options)],
        integrator=mrs.Integrator("heun", 0.002),
        output=mrs.Output(tmp_path / "run", 0.01),
    )
    with pytest.raises(mrs.SimulationError, match=rf"at time 0\.0\d+: {message}") as refused:
        sim.run(1.0)
    assert "dt" not in str(refused.value)
    arrays, values = checkpoint.load(tmp_path / "run" / "checkpoint.h5")
    assert 0.04 < values["time"] <= 0.05
    assert np.isfinite(arrays["positions"]).all()


def test_nan_at_the_start_is_refused_when_made():
    with pytest.raises(
        ValueError, match=r"beat must give finite numbers, got .*for rod 1 of 'rods'"
    ):
        rods(2, beat=lambda s, t: np.where(np.arange(8)[:, None] < 4, 0.0, [np.nan, 0, 0]))


# --- what would have no effect ------------------------------------------------------------------


def test_delay_without_anything_that_is_late():
    moving = mrs.Drive(angular_velocity=lambda t: np.outer(t, [0, 0, 1]))
    still = mrs.Drive(angular_velocity=(0, 0, 1))
    for options in ({}, {"base": "clamped"}, {"base": still}, {"intrinsic_curvature": (1, 0, 0)}):
        with pytest.raises(ValueError, match=r"delay must be 0 where nothing depends .*got 0\.3"):
            rods(delay=0.3, **options)
        rods(2, delay=[0.0, 0.0], **options)
    wave = mrs.TravellingWave((1, 0, 0), 1.0, 1.0)
    for options in ({"beat": wave}, {"base": moving}, {"intrinsic_curvature": wave}):
        rods(delay=0.3, **options)


def test_steric_repulsion_with_tracers_only():
    """Nothing to repel: the scene runs, and as it does without."""
    dust = mrs.Tracers(np.random.default_rng(0).normal(size=(9, 3)))
    ends = [
        mrs.Simulation(mrs.Fluid(background=mrs.flows.shear(1.0)), [dust], forces=forces).run(1.0)
        for forces in ([], [mrs.Steric(1.0, 0.5)])
    ]
    np.testing.assert_array_equal(ends[0].state.positions, ends[1].state.positions)


def test_a_suspension_and_positions_exclude_each_other():
    suspension = {"kind": "lattice_suspension", "shape": [1, 1, 2], "spacing": 1.0}
    swimmers = {"suspension": suspension, "positions": [[0, 0, 0]], "length": 1, "force": 1}
    scene = scenario_files.make("scene", {"fluid": {"epsilon": 0.1}, "swimmers": [swimmers]})
    with pytest.raises(mrs.ScenarioError, match=r"swimmers\.0: must have either a suspension, or"):
        scene.simulation()


# --- options ------------------------------------------------------------------------------------

ROD = {"shape": {"kind": "straight", "length": 1, "nodes": 5}, **MODULI}
OPTIONS = [
    ("scene", {"rods": [ROD | {"shape": {"kind": "helix", "lenght": 1}}]},
     r"rods\.0\.shape\.helix\.lenght: no such option; did you mean 'rods\.shape\.length'"),
    ("scene", {"rods": [ROD | {"shape": {"kind": "ring", "radius": 1, "nodes": 9, "lenght": 1}}]},
     r"rods\.0\.shape\.ring\.lenght: no such option; did you mean 'rods\.shape\.length'"),
    ("scene", {"rods": [ROD | {"lenght": 1}]}, r"did you mean 'rods\.shape\.length'"),
    ("scene", {"rods": [ROD | {"base": {"velocty": [0, 0, 1]}}]}, r"'rods\.base\.velocity'"),
    ("scene", {"rods": [ROD | {"base": {"velocity": 1}}]}, r"rods\.0\.base\.Drive: velocity must"),
    ("scene", {"rods": [ROD | {"beat": {"amplitude": [1, 0, 0], "wavelength": 0, "period": 1}}]},
     r"rods\.0\.beat: wavelength must be .*got 0"),
    ("scene", {"steric": {"strength": -1, "radius": 1}}, r"steric\.0: strength must be .*got -1"),
    ("scene", {"rods": [{"shape": {"kind": "helix"}}]}, r"rods\.0\.shape\.helix\.radius: must be"),
    ("cilia_array", {"backend": "fnm"}, "backend: name must be one of .*'fmm'.*, got 'fnm'"),
    ("cilia_array", {"integrator": "rk5"}, "integrator: name must be one of .*got 'rk5'"),
    ("cilia_array", {"integrator": {"tolerance": 2}}, "integrator: tolerance must be .*got 2"),
    ("cilia_array", {"degre": 2}, r"degre: no such option; did you mean 'backend\.degree'"),
    ("cilia_array", {"nodse": 2}, r"nodse: no such option; did you mean 'nodes'"),
]  # fmt: skip


@pytest.mark.parametrize(("name", "options", "message"), OPTIONS, ids=[m[:30] for *_, m in OPTIONS])
def test_options_that_are_refused(name, options, message):
    """By their place, in the words of the class that refuses; the same from Python."""
    with pytest.raises(mrs.ScenarioError, match=message):
        scenario_files.make(name, options)
    with pytest.raises(mrs.ScenarioError, match=message):
        scenario_files.find(name)(**options)


BUILT = [
    ({"fluid": {"epsilon": -1}}, r"fluid: epsilon must be .*got -1"),
    ({"fluid": {"epsilon": 1, "background": {"kind": "poiseuille", "speed": 1, "radius": 0}}},
     "fluid: background: radius must be .*got 0"),
    ({"rods": [ROD, ROD | {"shape": ROD["shape"] | {"length": -1}}]},
     r"rods\.1: shape: length must be .*got -1"),
    ({"rods": [ROD | {"delay": 1}]}, r"rods\.0: delay must be 0 where nothing depends"),
    ({"tracers": [{"positions": [[1e99, 0, 0]]}]}, r"tracers\.0: positions must lie within"),
]  # fmt: skip


@pytest.mark.parametrize(("options", "message"), BUILT, ids=[message[:30] for _, message in BUILT])
def test_options_that_are_refused_when_built(options, message, tmp_path):
    """Before the directory is touched."""
    scene = scenario_files.make("scene", {"fluid": {"epsilon": 0.1}} | options)
    with pytest.raises(mrs.ScenarioError, match=message):
        scene.simulation(tmp_path / "run")
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_precision_of_the_sums_is_an_option(precision):
    """In scenes as in Python; singles leave an error of 1e-7."""
    given = {"backend": {"name": "direct", "precision": precision}}
    sim = scenario_files.make("helical_swimmer", given, quick=True).simulation()
    assert sim.backend == mrs.Backend("direct", precision=precision)
    now = sim.now
    assert {info["precision"] for info in sim.mobility.infos()} == {precision}
    error = sim.mobility.sampled_error(now.points, now.loads)
    assert 1e-9 < error < 1e-5 if precision == "float32" else error == 0.0


def test_a_text_stands_for_the_name_of_a_backend():
    """As in Python: `backend="kitc"`."""
    given = {"backend": "kitc", "integrator": "heun"}
    scene = scenario_files.make("helical_swimmer", given, quick=True)
    assert scene.backend == mrs.Backend("kitc")
    assert scene.integrator == mrs.Integrator("heun")


@pytest.mark.parametrize(
    ("name", "radius"),
    [
        ("cilia_array", lambda scene: scene.radius),
        # A curvature that turns once in a wavelength: a helix of radius curvature / k^2.
        ("helical_swimmer", lambda s: s.curvature * (s.wavelength / (2.0 * np.pi)) ** 2),
        ("rod_relaxation", lambda s: s.curvature / (s.curvature**2 + s.twist**2)),
    ],
)
def test_small_versions_have_rods_thinner_than_their_helices(name, radius):
    scene = scenario_files.make(name, {}, quick=True)
    (body,) = (sim := scene.simulation()).bodies
    assert sim.scene.constant_fields(body)[0]["epsilon"].max() < 0.9 * radius(scene)


def test_a_checked_number_says_what_its_tolerance_is_of():
    assert str(mrs.Check("length", 2.02682, 2.0, 0.02)) == (
        "length: 2.02682, expected 2 to 0.02 (relative): ok"
    )
    assert re.search(
        r"expected 0 to 1e-12 \(absolute\): FAILED", str(mrs.Check("f", 1.0, 0, 1e-12))
    )


def circling(limit):
    """Return a flow that turns about z, a thousand radians per time, and is lost beyond a limit."""

    def velocity(points, time):
        turning = 1e3 * np.column_stack([-points[:, 1], points[:, 0], 0.0 * points[:, 2]])
        lost = (np.linalg.norm(points[:, :2], axis=1) > limit[0]) | (time > limit[1])
        return np.where(lost[:, None], np.nan, turning)

    tracers = mrs.Tracers([[1.0, 0.0, 0.0], [0.0, 0.0, 1e3]])
    fluid = mrs.Fluid(background=mrs.flows.UserFlow(velocity))
    return mrs.Simulation(fluid, [tracers], integrator=mrs.Integrator("bs32", tolerance=0.5))


def test_a_function_that_a_long_step_leads_too_far_is_met_by_shorter_steps():
    sim = circling((5.0, np.inf)).run(0.1)
    assert sim.stepper.rejections > 0
    assert np.linalg.norm(sim.state.positions[0, :2]) <= 5.0


def test_a_function_is_named_where_no_step_is_short_enough():
    sim = circling((np.inf, 0.05))
    with pytest.raises(mrs.SimulationError, match=r"at time 0\.0\d+: .*velocity must give finite"):
        sim.run(0.1)
    assert sim.time == pytest.approx(0.05, rel=1e-6)
