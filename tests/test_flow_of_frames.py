"""Vorticity and pressure of stored frames, by formulas, by differences and for a sphere."""

import numpy as np
import pytest
import pyvista as pv

import mrs
import treecode as tc
from mrs.output.stored import StoredFrame
from mrs.run import cli
from tests.cases import oracle
from tests.test_identities import curl

MU, SPEED, RADIUS = 2.5, 0.3, 2.0
EPSILONS = np.repeat([0.2, 0.1, 0.15], [6, 1, 1])  # of the rod's nodes, of head and flagellum
TARGETS = np.random.default_rng(1).uniform(-1.5, 1.5, (30, 3))


def run_of(directory, bodies, **fluid):
    """Return a short run of a script, opened."""
    output = mrs.Output(directory, interval=0.01, precision="float64")
    backend = mrs.Backend("direct", tolerance=1e-9)
    sim = mrs.Simulation(mrs.Fluid(MU, **fluid), bodies, backend=backend, output=output)
    return sim.run(0.01), mrs.open_run(directory)


def swimmer(place=(1.0, 0.0, 0.5)):
    sizes = {"epsilon": 0.1, "flagellum_epsilon": 0.15}
    return mrs.Swimmers([place], [[0.6, 0.0, 0.8]], length=0.5, force=1.0, **sizes)


@pytest.fixture(scope="module")
def rod_and_swimmer(tmp_path_factory):
    """A bent rod with torques, a swimmer of two blobs, tracers, in a flow with a pressure."""
    rods = mrs.Rods(
        mrs.geometry.helix(radius=0.2, pitch=1.0, length=1.0, nodes=6),
        bending=1.0, twisting=1.0, shearing=100.0, stretching=100.0,
        intrinsic_curvature=(0.0, 0.0, 0.0), epsilon=0.2,
    )  # fmt: skip
    bodies = [rods, swimmer(), mrs.Tracers(TARGETS[:3])]
    background = mrs.flows.poiseuille(SPEED, RADIUS)
    return run_of(tmp_path_factory.mktemp("runs") / "run", bodies, background=background)


def vorticity_of(now):
    """Return twice the angular velocity by K 7.3, and the curl of the background."""
    total = np.zeros((len(TARGETS), 3))
    for epsilon in np.unique(EPSILONS):
        rows = np.flatnonzero(epsilon == EPSILONS)
        kernel = tc.RegularizedStokesletRotlet(epsilon, MU)
        motion = oracle.exact(kernel, now.points[rows], now.loads[rows], TARGETS)
        total += 2.0 * motion[:, 3:].astype(float)
    _, y, z = TARGETS.T
    return total + 2.0 * SPEED / RADIUS**2 * np.stack([0 * y, -z, y], axis=1)


def pressure_of(now):
    """Return the sum of (f.r) (2 r^2 + 5 eps^2) / (8 pi R^5), and that of the background."""
    r = TARGETS[:, None, :] - now.points[: len(EPSILONS)]
    r2, along = (r**2).sum(axis=2), (r * now.loads[: len(EPSILONS), :3]).sum(axis=2)
    R = np.sqrt(r2 + EPSILONS**2)
    bodies = (along * (2.0 * r2 + 5.0 * EPSILONS**2) / (8.0 * np.pi * R**5)).sum(axis=1)
    return bodies - 4.0 * MU * SPEED / RADIUS**2 * TARGETS[:, 0]


def test_they_are_those_of_the_formulas(rod_and_swimmer):
    """Of doubles in the files, with the tolerance of the run."""
    sim, run = rod_and_swimmer
    assert np.abs(sim.now.loads[:6, 3:]).max() > 0.01, "there are torques"
    for values, exact in (
        (run.vorticity(TARGETS), vorticity_of(sim.now)),
        (run.pressure(TARGETS), pressure_of(sim.now)),
    ):
        assert values.shape == exact.shape
        np.testing.assert_allclose(values, exact, rtol=0, atol=1e-9 * np.abs(exact).max())
    assert np.abs(run.pressure(TARGETS, 0) - run.pressure(TARGETS)).max() > 1e-3


@pytest.mark.parametrize("backend", ["kitc", "fmm"])
def test_fast_sums_of_the_pressure(backend):
    """Methods take the kernel as any other: within a tolerance, from near by to far away."""
    kernel = tc.RegularizedPressure(0.05)
    points, forces, targets = oracle.random_case(kernel, 3000, 0, targets=3000)
    exact = tc.evaluate(kernel, points, forces, targets, backend="direct")
    values = tc.evaluate(kernel, points, forces, targets, backend=backend, tol=1e-5)
    assert 0.0 < tc.relative_error(values, exact) < 1e-5


def test_columns_of_field_files(rod_and_swimmer, tmp_path, capsys):
    """Beside the velocity, with errors of their own."""
    sim, run = rod_and_swimmer
    options = ["--resolution", "5", "--output", str(tmp_path), "--also", "vorticity", "pressure"]
    assert cli.main(["field", str(run.directory), *options]) == 0
    assert "relative error of the pressure: " in capsys.readouterr().out
    image = pv.read(tmp_path / "field.vti")
    points = np.asarray(image.points, np.float64)
    np.testing.assert_allclose(image["velocity"], sim.velocity(points), rtol=0, atol=1e-8)
    np.testing.assert_allclose(image["vorticity"], run.vorticity(points), rtol=0, atol=1e-8)
    np.testing.assert_allclose(image["pressure"], run.pressure(points), rtol=0, atol=1e-8)
    for name in ("vorticity", "pressure"):
        assert image.field_data[f"{name}_error_sums"][0] < 1e-9
        assert image.field_data[f"{name}_error_rounding"][0] == 0.0  # doubles in the files
    with pytest.raises(ValueError, match="also must be one of 'vorticity', 'pressure', got 'p'"):
        mrs.write_field(run, also=["p"])


def test_a_box_and_a_line(rod_and_swimmer, tmp_path, capsys):
    """The corners are grid points, streamlines go through seeds, columns are those of the run."""
    _, run = rod_and_swimmer
    there = [str(run.directory), "--output", str(tmp_path)]
    options = [
        "--box=-1,0,0.5,1,1,1",
        "--resolution",
        "9",
        "--seed=-0.5,0.5,0.75",
        "--seed=0.5,0.5,1",
    ]
    assert cli.main(["field", *there, *options]) == 0
    assert pv.read(tmp_path / "field.vti").bounds == pytest.approx((-1, 1, 0, 1, 0.5, 1), rel=1e-12)
    lines = pv.read(tmp_path / "streamlines.vtp")
    for seed in ([-0.5, 0.5, 0.75], [0.5, 0.5, 1.0]):
        assert np.linalg.norm(lines.points - seed, axis=1).min() < 1e-6
    assert cli.main(["field", *there, "--line=0,0,-1,0,3,3", "--resolution", "6"]) == 0
    assert "beside the velocities stored" in capsys.readouterr().out
    table = np.genfromtxt(tmp_path / "line.csv", delimiter=",", names=True)
    points = np.stack([table[axis] for axis in "xyz"], axis=1)
    np.testing.assert_allclose(points, np.linspace([0, 0, -1], [0, 3, 3], 6), atol=1e-15)
    np.testing.assert_allclose(table["distance"], np.linspace(0.0, 5.0, 6), rtol=1e-14)
    velocity = np.stack([table[f"velocity_{axis}"] for axis in "xyz"], axis=1)
    np.testing.assert_array_equal(velocity, run.velocity(points))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--line=0,0,0,0,0,1", "--plane", "z=0"], "--line is in place of a grid"),
        (["--line=0,0,1,0,0,1"], "line must be two points that are apart"),
        (["--box=0,0,1,0,0,1"], "box must be two points that are apart"),
        (["--box=0,0,0,1,1,0", "--seed=0,0,0"], "seeds must be None for a plane"),
    ],
)
def test_places_that_are_refused(rod_and_swimmer, tmp_path, capsys, options, message):
    there = [str(rod_and_swimmer[1].directory), "--output", str(tmp_path), "--resolution", "3"]
    assert cli.main(["field", *there, *options]) == 1
    assert capsys.readouterr().err.startswith(f"mrs: {message}")
    assert list(tmp_path.iterdir()) == []


def test_a_dragged_sphere_is_that_of_stokes(tmp_path):
    """Forces where motion is given count: p = F.x / (4 pi r^3), curl u = F x x / (4 pi mu r^3).

    That holds for any uniform force on a sphere. Outside, blobs change it by (eps/r)^4, and the
    uneven forces of points that are 0.35 apart by less than 1e-3 from r = 2 on.
    """
    sphere = mrs.surfaces.sphere(1.0, 100)
    drive = mrs.Drive(velocity=(0.0, 0.0, -1.0))
    _, run = run_of(tmp_path / "run", [mrs.Rigid(sphere, positions=[(0, 0, 0)], motion=drive)])
    force = run["rigid"]["force"][0].sum(axis=0)
    x = np.array([[0.0, 0.0, 2.0], [2.0, 0.0, 1.0], [-1.0, 2.0, -2.0]])
    r3 = np.linalg.norm(x, axis=1)[:, None] ** 3
    scale = np.linalg.norm(force) / (16.0 * np.pi)
    pressure = (x @ force)[:, None] / (4.0 * np.pi * r3)
    np.testing.assert_allclose(run.pressure(x, 0), pressure[:, 0], rtol=0, atol=1e-3 * scale)
    spin = np.cross(force, x) / (4.0 * np.pi * MU * r3)
    np.testing.assert_allclose(run.vorticity(x, 0), spin, rtol=0, atol=1e-3 * scale / MU)


BOUNDARIES = {"wall": mrs.Wall(), "box": mrs.Periodic((3.0, 3.0, 3.0))}


@pytest.mark.parametrize("name", BOUNDARIES)
def test_within_boundaries(tmp_path, name):
    """Vorticity is the curl of the velocity there too; of images no pressure is known."""
    bodies = [swimmer((0.0, 0.0, 0.7))]
    _, run = run_of(tmp_path / "run", bodies, boundary=BOUNDARIES[name])
    points = np.array([[0.3, 0.2, 0.9], [0.5, -0.4, 0.2]])
    exact = curl(run.velocity, points, 0.005)
    # Differences over a twentieth of a blob err by less than 1e-9, the tolerance by 1e-9 / 0.005.
    size = np.abs(exact).max()
    np.testing.assert_allclose(run.vorticity(points), exact, rtol=0, atol=1e-6 * size)
    if name == "wall":
        np.testing.assert_array_equal(run.vorticity(points * [1, 1, -1]), 0.0)
    kind = type(BOUNDARIES[name]).__name__
    with pytest.raises(ValueError, match=rf"pressure is known in free space only, .* {kind}\("):
        run.pressure(points)


def test_backgrounds(tmp_path):
    """A flow of one's own may have a vorticity and no pressure; both are asked for by name."""
    swirl = mrs.flows.UserFlow(lambda x, t: np.cross([0.0, 0.0, 2.0], x))
    run_of(tmp_path / "run", [swimmer()], background=swirl)
    frame = StoredFrame(tmp_path / "run", background=swirl)
    for quantity in ("vorticity", "pressure"):
        with pytest.raises(ValueError, match=f"background must have a {quantity}, got UserFlow"):
            frame.values(quantity, TARGETS)
    with pytest.warns(UserWarning, match="UserFlow, which files cannot hold"):
        disturbance = mrs.open_run(tmp_path / "run").pressure(TARGETS)
    assert np.abs(disturbance).max() > 0.0
