"""Users add bodies, forces, integrators, interrupts and formats in files of their own."""

import csv
import shutil

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import mrs
from mrs.run import cli, scenario_files
from tests.cases import rod_oracle as oracle
from tests.plugins import crossing, symmetry_plane
from tests.plugins.registered import NAMES, PARTS, adams_bashforth, pull, weights, xyz

EPSILON, VISCOSITY, FORCE = 0.1, 2.0, 3.0
SPEED = FORCE / (4.0 * np.pi * VISCOSITY * EPSILON)  # of one blob: H1(0) = 1 / (4 pi epsilon)

TOML = """
scenario = "scene"
[options]
plugins = ["weights.py", "pull.py", "xyz.py", "adams_bashforth.py"]
t_end = 0.3
interval = 0.1
formats = ["vtkhdf", "xyz"]
integrator = { name = "ab2", dt = 0.02 }
fluid = { viscosity = 2.0 }
pull = { force = [0, 0, -3.0] }
[[options.weights]]
positions = [[0, 0, 0]]
force = [3.0, 0, 0]
epsilon = 0.1
"""


@pytest.fixture(autouse=True)
def _registered():
    """Have the parts in the registries for one test."""
    for (registry, _), part in zip(NAMES, PARTS, strict=True):
        registry.register(part)
    yield
    for registry, name in NAMES:
        del registry[name]


def scene(forces=(), **options):
    body = weights.Weights([(0.0, 0.0, 0.0)], (FORCE, 0.0, 0.0), EPSILON)
    return mrs.Simulation(mrs.Fluid(VISCOSITY), [body], forces=forces, **options)


def test_a_body():
    sim = scene().run(0.5)
    np.testing.assert_allclose(sim.state.positions, [[0.5 * SPEED, 0.0, 0.0]], atol=1e-12)


def test_a_force():
    sim = scene([pull.Pull((0.0, 0.0, -FORCE))]).run(0.5)
    wanted = 0.5 * SPEED * np.array([[1, 0, -1]])
    np.testing.assert_allclose(sim.state.positions, wanted, atol=1e-12)


def bent_rod(integrator):
    """Return the state of a rod that unbends, in which triads turn and nodes move."""
    rod = mrs.Rods(
        mrs.geometry.helix(radius=0.3, pitch=1.0, length=1.2, nodes=9),
        bending=1.0, twisting=1.0, shearing=20.0, stretching=20.0,
        intrinsic_curvature=[0.0, 0.0, 1.0], epsilon=0.25,
    )  # fmt: skip
    return mrs.Simulation(mrs.Fluid(), [rod], backend="direct", integrator=integrator).run(0.02)


def test_an_integrator_with_a_memory_is_of_second_order():
    assert mrs.INTEGRATORS["ab2"].name == adams_bashforth.AdamsBashforth.name
    exact = bent_rod(mrs.Integrator("rk4", dt=1e-4)).state
    errors = []
    for steps in (20, 40, 80):
        found = bent_rod(mrs.Integrator("ab2", dt=0.02 / steps)).state
        errors.append([np.abs(a - b).max() for a, b in zip(found, exact, strict=True)])
    assert min(errors[-1]) > 1e-9, "rounding"
    for column in np.array(errors).T:  # positions, triads
        np.testing.assert_allclose(oracle.orders(column), 2.0, atol=0.25)


def test_the_memory_is_part_of_a_checkpoint(tmp_path):
    """A multistep method goes on as if nothing had happened, bit for bit."""

    def build(directory):
        output = mrs.Output(directory, interval=0.1)
        forces = [mrs.Steric(0.5, 0.2)]
        bodies = [
            weights.Weights([(0, 0, 0), (0.3, 0.1, 0)], (FORCE, 0, 0), EPSILON),
            mrs.Rods(mrs.geometry.straight(1.0, 5), bending=1.0, twisting=1.0, shearing=9.0,
                     stretching=9.0, epsilon=0.2, intrinsic_curvature=[1.0, 0.0, 0.0]),
        ]  # fmt: skip
        integrator = mrs.Integrator("ab2", dt=2e-3)
        fluid = mrs.Fluid(VISCOSITY)
        return mrs.Simulation(fluid, bodies, forces=forces, integrator=integrator, output=output)

    whole = build(tmp_path / "whole").run(0.1)
    build(tmp_path / "halves").run(0.1, max_walltime=0.0)
    halves = mrs.restart(build(tmp_path / "halves"))
    assert 0.0 < halves.time < 0.1
    assert halves.stepper.memory
    halves.run(0.1)
    for a, b in zip(whole.state, halves.state, strict=True):
        np.testing.assert_array_equal(a, b)


def test_an_interrupt():
    class Note(mrs.Tracker):
        when = crossing.Crossing(0.2 * SPEED)

        def __init__(self):
            self.times = []

        def handle(self, sim):
            self.times.append(sim.time)

    note = Note()
    scene(trackers=[note], integrator=mrs.Integrator("rk4", dt=0.03)).run(0.6)
    np.testing.assert_allclose(note.times, [0.21, 0.6])


def bodies_above(mirrored=False):
    """Return a rod that bends and twists, a swimmer and a tracer; or their mirror images."""
    sign = symmetry_plane.MIRROR if mirrored else np.ones(3)
    rod = mrs.geometry.straight(1.0, 7, origin=[0.0, 0.0, 0.4], direction=[1.0, 0.0, 0.5])
    quaternions = rod.quaternions
    if mirrored:  # a mirror image of right-handed axes is left-handed: D2 changes its sign
        axes = mrs.rotations.axes(quaternions) * sign * np.array([[1.0], [-1.0], [1.0]])
        quaternions = Rotation.from_matrix(axes.transpose(0, 2, 1)).as_quat()
    turned = np.array([-1.0, 1.0, -1.0]) if mirrored else 1.0  # of strains, about these axes
    name = "mirrored_" if mirrored else ""
    return [
        mrs.Rods(
            rod._replace(nodes=rod.nodes * sign, quaternions=quaternions),
            bending=1.0, twisting=0.7, shearing=20.0, stretching=20.0, epsilon=0.15,
            intrinsic_curvature=np.array([1.0, 0.4, 0.8]) * turned, name=name + "rod",
        ),
        mrs.Swimmers(
            [[0.4, 0.8, 0.5] * sign], [[0.3, 0.2, 1.0] * sign], length=0.4, force=1.0,
            epsilon=0.1, name=name + "swimmer",
        ),
        mrs.Tracers([[0.2, 0.3, 0.3] * sign], name=name + "tracer"),
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("backend", "error"), [("direct", 1e-12), (mrs.Backend("auto", tolerance=1e-6), 1e-5)]
)
def test_a_boundary(backend, error):
    """Bodies over the plane move as they do beside their mirror images, and nothing crosses it."""
    fluid = mrs.Fluid(VISCOSITY, boundary=symmetry_plane.SymmetryPlane())
    over = mrs.Simulation(fluid, bodies_above(), backend=backend)
    both = [*bodies_above(), *bodies_above(mirrored=True)]
    beside = mrs.Simulation(mrs.Fluid(VISCOSITY), both, backend="direct")
    size = np.linalg.norm(over.now.motion[:, :3], axis=1).max()
    count = len(over.now.points)
    np.testing.assert_allclose(over.now.motion, beside.now.motion[:count], atol=error * size)
    on_plane = np.random.default_rng(0).random((50, 3)) * [2.0, 2.0, 0.0]
    assert np.abs(over.velocity(on_plane)[:, 2]).max() < 1e-12 * size
    assert np.abs(beside.velocity(on_plane)[:, 2]).max() < 1e-12 * size
    assert np.abs(over.velocity(on_plane)[:, :2]).max() > 1e-3 * size
    assert over.mobility.sampled_error(over.now.points, over.now.loads) < 1e-5


def test_files_do_not_hold_a_boundary(tmp_path):
    plane = symmetry_plane.SymmetryPlane()
    fluid = mrs.Fluid(VISCOSITY, boundary=plane)
    sim = mrs.Simulation(fluid, bodies_above(), output=mrs.Output(tmp_path, 0.1)).run(1e-3)
    points = np.random.default_rng(0).random((20, 3))
    with pytest.raises(ValueError, match="boundary must be given: the run had a SymmetryPlane"):
        mrs.frame_velocity(tmp_path)[1](points)
    _, velocity = mrs.frame_velocity(tmp_path, boundary=plane)
    exact = sim.velocity(points)
    np.testing.assert_allclose(velocity(points), exact, atol=1e-4 * np.abs(exact).max())
    with pytest.raises(TypeError, match=r"boundary must be a treecode\.Boundary, got 'wall'"):
        mrs.Fluid(boundary="wall")


def test_all_of_them_from_toml(tmp_path, capsys):
    """By name, in a run that is stopped and goes on from its own files."""
    plugins = tmp_path / "mine"
    plugins.mkdir()
    for module in (weights, pull, xyz, adams_bashforth):
        shutil.copy(module.__file__, plugins)
    (plugins / "scene.toml").write_text(TOML)
    run = ["run", str(plugins / "scene.toml"), "--output"]
    whole, halves = tmp_path / "whole", tmp_path / "halves"
    for registry, name in NAMES:  # the files bring their own
        del registry[name]
    assert cli.main([*run, str(whole)]) == 0
    assert cli.main([*run, str(halves), "--max-walltime", "0"]) == 0
    assert cli.main(["resume", str(halves)]) == 0
    told = "weights.xyz: 4 frames of 1 points, the last at t = 0.3"
    del mrs.FORMATS["xyz"]  # as in a process that has not run it
    assert cli.main(["info", str(halves)]) == 0
    assert told in capsys.readouterr().out
    (plugins / "xyz.py").unlink()
    with pytest.warns(UserWarning, match=r"not told of: plugins: there is no file .*xyz\.py"):
        assert cli.main(["info", str(halves)]) == 0
    assert "weights.vtkhdf: 4 frames" in capsys.readouterr().out
    text = (whole / "weights.xyz").read_text()
    assert text == (halves / "weights.xyz").read_text()
    frames = xyz.frames_of(whole / "weights.xyz")
    np.testing.assert_allclose([time for time, _ in frames], [0.0, 0.1, 0.2, 0.3])
    last = [float(word) for word in frames[-1][1].split()[-3:]]
    np.testing.assert_allclose(last, [0.3 * SPEED, 0.0, -0.3 * SPEED], atol=1e-12)


def test_columns_of_the_log(tmp_path):
    """A function of the simulation by name; a run that goes on with others says so first."""

    def build(columns):
        return scene(output=mrs.Output(tmp_path, interval=0.1, columns=columns))

    build({"x": lambda sim: sim.state.positions[0, 0]}).run(0.2)
    with (tmp_path / "log.csv").open() as file:
        rows = list(csv.DictReader(file))
    np.testing.assert_allclose([float(row["x"]) for row in rows], SPEED * np.arange(3) / 10)
    with pytest.warns(UserWarning, match=r"output\.columns"):
        other = mrs.restart(build({}))
    with pytest.raises(mrs.SimulationError, match=r"log\.csv has the columns .*, x, not"):
        other.run(0.3)
    with pytest.raises(ValueError, match=r"columns must have names other than step, t, .*got 't'"):
        build({"t": lambda sim: 0.0})
    with pytest.raises(TypeError, match=r"columns\['x'\] must give a number or a text, got \["):
        scene(output=mrs.Output(tmp_path / "b", 0.1, columns={"x": lambda sim: [1]})).run(0.1)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("weights", "body 'weights' is registered already"),
        ("two words", r"body\.kind must be a text that can be a name in Python, got 'two words'"),
    ],
)
def test_names_that_cannot_be_registered(name, message):
    with pytest.raises(ValueError, match=message):
        mrs.BODIES.register(type("Other", (mrs.Body,), {"kind": name}))


@pytest.mark.parametrize(
    ("method", "value", "message"),
    [
        ("loads", (np.zeros(3), None), r"forces of loads of 'weights' must have shape \(1, 3\)"),
        ("loads", (np.zeros((1, 3)), np.zeros(3)), "torques of loads of 'weights' must have"),
        ("rates", (np.zeros(3), np.empty((0, 3))), "velocities of rates of 'weights' must have"),
        ("rates", (np.zeros((1, 3)), np.empty(0)), r"angular velocities .* got shape \(0,\)"),
    ],
)
def test_arrays_of_a_body_have_their_shapes(method, value, message):
    """One that numpy would stretch is refused."""
    body = weights.Weights([(0.0, 0.0, 0.0)], (FORCE, 0.0, 0.0), EPSILON)
    setattr(body, method, lambda *_: value)
    with pytest.raises(ValueError, match=message):
        assert mrs.Simulation(mrs.Fluid(), [body]).now


def test_what_a_force_gives_is_checked():
    class Wrong(mrs.Force):
        kind = "wrong"

        def __init__(self, value):
            self.value = value

        def forces(self, time, points, layout, fluid):
            return self.value

    with pytest.raises(
        mrs.SimulationError, match=r"force 'wrong' must give shape \(3,\) or \(1, 3\)"
    ):
        scene([Wrong(np.zeros((2, 3)))]).run(0.1)
    with pytest.raises(
        mrs.SimulationError, match=r"force 'wrong' .* finite .* at node 0 of 'weights'"
    ):
        scene([Wrong(np.full(3, np.nan))]).run(0.1)
    with pytest.raises(TypeError, match=r"forces\[0\] must be mrs\.Force"):
        scene([np.zeros(3)])
    body = weights.Weights([(0.0, 0.0, 0.0)], (FORCE, 0.0, 0.0), EPSILON)
    body.positions = np.zeros(3)
    with pytest.raises(ValueError, match=r"positions of 'weights' must have shape \(3, 3\), got"):
        mrs.Simulation(mrs.Fluid(), [body])


def test_formats_and_columns_that_are_refused():
    with pytest.raises(ValueError, match="formats must be different ones"):
        mrs.Output("run", 0.1, formats=["pvd", "pvd"])
    with pytest.raises(TypeError, match="columns must be a dict of functions by name"):
        mrs.Output("run", 0.1, columns=["x"])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"plugins": ["none.py"]}, "plugins: there is no file .*none.py"),
        ({"plugins": "none.py"}, "plugins: .*list"),
        ({"weighs": []}, "weighs: no such option; did you mean 'weights'"),
        ({"weights": [{"position": []}]}, "did you mean 'weights.positions'"),
        ({"weights": [{"positions": [[0, 0, 0]], "force": 1, "epsilon": 1}]}, r"weights\.0\.force"),
        ({"formats": ["xy"]}, r"formats: formats\[0\] must be one of 'vtkhdf', 'pvd', 'xyz'"),
        ({"pull": {"mass": 1.0}}, r"pull\.0\.mass: no such option"),
    ],
)
def test_mistakes_in_toml_are_named(options, message):
    with pytest.raises(mrs.ScenarioError, match=message):
        scenario_files.make("scene", options)
