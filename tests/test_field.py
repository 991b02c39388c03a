"""Velocity on a grid from the files of a run alone, its error, and streamlines through it."""

import re
import shutil
import subprocess
import sys

import h5py
import numpy as np
import pytest
import pyvista as pv

import mrs
import treecode as tc
from mrs.output import vtkhdf
from mrs.output.export import FORMATS, export
from mrs.output.render import render
from mrs.output.stored import StoredFrame
from mrs.output.topology import Topology
from mrs.output.trajectory import Trajectory
from mrs.run import cli
from tests.cases import oracle

MODULI = {"bending": 1.0, "twisting": 1.0, "shearing": 100.0, "stretching": 100.0}
FLOW = mrs.flows.poiseuille(0.3, 2.0)


def script(directory, background=FLOW, **options):
    """Run a scene without a scenario: bent rods with torques, swimmers of two blobs, tracers."""
    helix = mrs.geometry.helix(radius=0.2, pitch=1.0, length=2.0, nodes=16)
    rods = mrs.Rods(helix, intrinsic_curvature=(0.0, 0.0, 0.0), epsilon=0.2, **MODULI)
    positions = [[1.0, 0.0, 0.5], [-1.0, 0.5, 0.0]]
    swimmers = mrs.Swimmers(
        positions, np.eye(3)[:2], length=0.5, force=1.0, epsilon=0.1, flagellum_epsilon=0.15
    )
    tracers = mrs.Tracers(np.random.default_rng(0).random((20, 3)))
    sim = mrs.Simulation(
        mrs.Fluid(viscosity=2.5, background=background),
        [rods, swimmers, tracers],
        output=mrs.Output(directory, interval=0.01, **options),
    )
    return sim.run(0.03)


def expected(sim, targets):
    """Return the velocity by formulas in extended precision that share no code with the sums."""
    now, values = sim.now, np.zeros((len(targets), 3))
    epsilons = np.concatenate([np.full(16, 0.2), np.full(2, 0.1), np.full(2, 0.15)])
    for epsilon in np.unique(epsilons):
        chosen = np.flatnonzero(epsilons == epsilon)
        kernel = tc.RegularizedStokesletRotlet(epsilon, 2.5)
        terms = oracle.exact(kernel, now.points[chosen], now.loads[chosen], targets)
        values += terms[:, :3].astype(float)
    _, y, z = targets.T
    values[:, 0] += 0.3 * (1.0 - (y**2 + z**2) / 4.0)
    return values


def error_of(values, exact):
    return np.linalg.norm(values - exact) / np.linalg.norm(exact)


def test_field_of_a_run_that_a_script_made(tmp_path, capsys):
    """The scenario is not needed, and what is written agrees with formulas."""
    sim = script(tmp_path)
    assert cli.main(["field", str(tmp_path), "--resolution", "9"]) == 0
    image = pv.read(tmp_path / "field.vti")
    exact = expected(sim, image.points)
    rounding = image.field_data["error_rounding"][0]
    assert error_of(image["velocity"], exact) < max(1e-4, 5 * rounding)
    assert image.field_data["time"][0] == sim.time
    assert image.field_data["error_sums"][0] < 1e-4
    assert image.field_data["error_at_bodies"][0] < 1e-4
    assert pv.read(tmp_path / "streamlines.vtp").n_lines > 0
    said = capsys.readouterr().out
    assert "t = 0.03; relative error of the velocity:" in said
    assert f"{rounding:.1e} by stored single precision" in said


def test_an_earlier_frame(tmp_path):
    sim = script(tmp_path)
    stored = StoredFrame(tmp_path, 0)
    assert stored.time == 0.0
    targets = np.random.default_rng(1).uniform(-2, 2, (50, 3))
    fresh = mrs.Simulation(sim.fluid, sim.bodies)
    assert error_of(stored.velocity(targets), fresh.velocity(targets)) < 1e-4
    assert error_of(stored.velocity(targets), sim.velocity(targets)) > 1e-3


def test_frame_velocity_from_python(tmp_path):
    sim = script(tmp_path)
    points, velocity = mrs.frame_velocity(tmp_path)
    np.testing.assert_allclose(points, sim.now.points, rtol=1e-6)
    targets = np.random.default_rng(1).uniform(-2, 2, (50, 3))
    assert error_of(velocity(targets), expected(sim, targets)) < 1e-4


def rounding_of_a_bent_rod(directory, seed):
    """Return the error a thousand lengths away, and what is told of it."""
    rods = mrs.Rods(mrs.geometry.straight(1.0, 5), **MODULI, epsilon=0.1)
    rods.positions += 0.02 * np.random.default_rng(seed).standard_normal((5, 3))
    sim = mrs.Simulation(mrs.Fluid(), [rods], output=mrs.Output(directory, interval=1e-4))
    sim.run(1e-4)
    targets = 1e3 * np.random.default_rng(0).standard_normal((500, 3))
    stored = StoredFrame(directory)
    values = stored.velocity(targets)
    now = sim.now
    kernel = tc.RegularizedStokesletRotlet(0.1, 1.0)
    exact = oracle.exact(kernel, now.points, now.loads, targets)[:, :3].astype(float)
    return error_of(values, exact), stored.error(targets, values).rounding


def test_what_was_rounded_when_stored_is_in_the_error(tmp_path):
    """Forces of a free rod cancel: far away what is left of them is their rounding."""
    pairs = [rounding_of_a_bent_rod(tmp_path / str(seed), seed) for seed in range(9)]
    actual, told = np.transpose(pairs)
    assert actual.min() > 1e-5  # a thousand times the rounding of one number
    assert 0.5 < np.median(told / actual) < 2.0


@pytest.mark.parametrize("away", [1e3, 1e6])
def test_far_from_the_origin(tmp_path, away):
    """In boxes of one: nothing visible is lost, or it is in the error."""
    positions, along = mrs.random_suspension(20, 1.0, 0.05)
    swimmers = mrs.Swimmers(positions + away, along, length=0.2, force=1.0, epsilon=0.02)
    sim = mrs.Simulation(mrs.Fluid(), [swimmers], output=mrs.Output(tmp_path, interval=1e-3))
    sim.run(1e-3)
    stored = StoredFrame(tmp_path)
    targets = away + np.random.default_rng(0).uniform(-1, 1, (500, 3))
    values = stored.velocity(targets)
    now = sim.now
    kernel = tc.RegularizedStokeslet(0.02, 1.0)
    exact = oracle.exact(kernel, now.points, now.loads, targets).astype(float)
    actual, told = error_of(values, exact), stored.error(targets, values)
    assert actual < 1e-6
    assert 0.2 < actual / told.rounding < 2.0  # forces of a swimmer are rounded alike


def test_sums_that_are_off_are_in_the_error(tmp_path):
    script(tmp_path)
    stored = StoredFrame(tmp_path)
    targets = np.random.default_rng(0).uniform(-2, 2, (1000, 3))
    values = stored.velocity(targets)
    wrong = values * 1.001
    assert stored.error(targets, wrong).sums == pytest.approx(1e-3, rel=0.2)
    assert stored.error(targets, values).sums < 1e-4


def test_a_background_that_files_cannot_hold(tmp_path):
    """What is written is named, and said to be, the disturbance by the bodies."""
    background = mrs.flows.UserFlow(lambda x, t: x[:, [1, 0, 2]] * [1, 1, 0], lambda x, t: 0 * x)
    sim = script(tmp_path, background)
    with pytest.warns(UserWarning, match="UserFlow, which files cannot hold"):
        mrs.write_field(tmp_path, resolution=5)
    image = pv.read(tmp_path / "field.vti")
    assert image.point_data.keys() == ["disturbance"]
    total = image["disturbance"] + background.velocity(image.points, 0.03)
    assert error_of(total, sim.velocity(image.points)) < 1e-4
    assert np.isnan(image.field_data["error_at_bodies"][0])
    _, velocity = mrs.frame_velocity(tmp_path, background=background)
    np.testing.assert_array_equal(velocity(image.points), total)


SCENARIO = """
import numpy as np
import mrs


class Mine(mrs.Scenario):
    def build(self, **common):
        swirl = mrs.flows.UserFlow(lambda x, t: np.cross([0, 0, 2.0], x))
        return mrs.Simulation(
            mrs.Fluid(epsilon=0.1, background=swirl),
            [mrs.Swimmers([[0, 0, 0]], [[0, 0, 1]], length=1.0, force=1.0)],
            **common,
        )

    def check(self, sim):
        return mrs.Check("time", sim.time, 0.1, 1.0)
"""


def test_a_background_of_a_scenario_is_taken_from_there(tmp_path):
    (tmp_path / "mine.py").write_text(SCENARIO)
    options = ["--set", "t_end=0.1", "--output", str(tmp_path / "run")]
    assert cli.main(["run", str(tmp_path / "mine.py"), *options]) == 0
    mrs.write_field(tmp_path / "run", resolution=5)
    image = pv.read(tmp_path / "run" / "field.vti")
    far = image.points[[0]]
    assert np.linalg.norm(image["velocity"][0] - np.cross([0.0, 0.0, 2.0], far[0])) < 0.2
    assert image.field_data["error_at_bodies"][0] < 1e-4


def test_another_fluid_than_that_of_the_frame_is_said(tmp_path):
    script(tmp_path)
    for path in tmp_path.glob("*.vtkhdf"):
        with h5py.File(path, "r+") as file:
            file["meta"].attrs["viscosity"] = 5.0
    with pytest.warns(UserWarning, match="another viscosity or background"):
        found = mrs.write_field(tmp_path, resolution=5)
    assert found.error.at_bodies > 0.01


def test_the_field_goes_where_it_is_told(tmp_path):
    run, there = tmp_path / "run", tmp_path / "new" / "folder"
    script(run)
    before = sorted(run.iterdir())
    assert cli.main(["field", str(run), "--resolution", "5", "--output", str(there)]) == 0
    assert sorted(path.name for path in there.iterdir()) == ["field.vti", "streamlines.vtp"]
    assert sorted(run.iterdir()) == before


def test_a_frame_that_one_body_lacks(tmp_path):
    script(tmp_path)
    vtkhdf.cut(tmp_path / "tracers.vtkhdf", 0.015)
    with pytest.raises(IndexError, match=r"number 2, at t = 0.02, is not in .*tracers.vtkhdf$"):
        StoredFrame(tmp_path, 2)
    assert StoredFrame(tmp_path).time == 0.01  # the last that all have, as of a run that goes on
    with pytest.raises(IndexError, match="has 2 frames, none number 9"):
        StoredFrame(tmp_path, 9)
    with pytest.raises(IndexError, match="has 2 frames, none number -3"):
        StoredFrame(tmp_path, -3)


def test_frames_are_of_one_time(tmp_path):
    """A file that was begun anew later has other numbers for the same times."""
    script(tmp_path)
    path = tmp_path / "swimmers.vtkhdf"
    with Trajectory(path) as old:
        last, data, meta = old.points(3), old.point_data(3), old.meta
        topology = old.topology
    path.unlink()
    vtkhdf.create(path, topology, meta=meta)
    vtkhdf.append(path, 0.03, last, data)
    assert StoredFrame(tmp_path, 3).time == StoredFrame(tmp_path).time == 0.03
    with pytest.raises(IndexError, match=r"number 0, at t = 0, is not in .*swimmers.vtkhdf"):
        StoredFrame(tmp_path, 0)


def test_files_of_earlier_versions(tmp_path):
    script(tmp_path)
    with h5py.File(tmp_path / "rods.vtkhdf", "r+") as file:
        del file["VTKHDF/PointData/epsilon"]
    with pytest.raises(ValueError, match=r"rods.vtkhdf lacks epsilon, .* run it again, or"):
        StoredFrame(tmp_path)


def test_tracers_alone(tmp_path):
    tracers = mrs.Tracers(np.random.default_rng(0).random((10, 3)))
    fluid = mrs.Fluid(background=mrs.flows.shear(2.0))
    mrs.Simulation(fluid, [tracers], output=mrs.Output(tmp_path, interval=0.1)).run(0.1)
    points = np.array([[1.0, 2.0, 3.0]])
    np.testing.assert_allclose(StoredFrame(tmp_path).velocity(points), [[6.0, 0.0, 0.0]])


def test_readme_example(tmp_path):
    """As in README, smaller."""
    helix = mrs.geometry.helix(radius=0.3, pitch=3.14, length=6.0, nodes=31)
    cilia = mrs.Rods(
        mrs.geometry.array(helix, mrs.geometry.grid((2, 1), spacing=2.0)),
        bending=100.0,
        twisting=100.0,
        shearing=2000.0,
        stretching=2000.0,
        beat=mrs.TravellingWave(amplitude=(0.6, 0.0, 0.0), wavelength=6.0, period=1.0),
        base="clamped",
    )
    swimmers = mrs.Swimmers(
        *mrs.random_suspension(5, size=10.0, spacing=0.5), length=1.0, force=1.0, epsilon=0.1
    )
    sim = mrs.Simulation(
        mrs.Fluid(viscosity=1.0, epsilon=0.25, background=mrs.flows.shear(0.1)),
        [cilia, swimmers],
        output=mrs.Output(tmp_path / "mine", interval=0.01),
    )
    sim.run(0.01)
    mrs.write_field(tmp_path / "mine", resolution=8)
    image = pv.read(tmp_path / "mine" / "field.vti")
    assert error_of(image["velocity"], sim.velocity(image.points)) < 1e-4


@pytest.mark.parametrize("resolution", [2, 3, 4, 7, 10, 14, 20])
def test_streamlines_at_any_resolution(tmp_path, resolution, recwarn):
    options = ["--quick", "--set", "t_end=0.1", "--output", str(tmp_path / "run")]
    assert cli.main(["run", "fibre_in_shear", *options]) == 0
    mrs.write_field(tmp_path / "run", resolution=resolution)
    lines = pv.read(tmp_path / "run" / "streamlines.vtp")
    assert lines.n_lines >= 2
    assert not [warning for warning in recwarn if "streamlines" in str(warning.message)]


def test_a_run_elsewhere(tmp_path):
    """The files are enough: config.toml need not be there."""
    script(tmp_path / "run")
    (tmp_path / "files").mkdir()
    for path in (tmp_path / "run").glob("*.vtkhdf"):
        shutil.copy(path, tmp_path / "files")
    assert mrs.write_field(tmp_path / "files", resolution=5).time == 0.03


@pytest.mark.skipif(sys.platform == "win32", reason="no limit of the size of files there")
@pytest.mark.parametrize("command", ["field", *(f"export {name}" for name in FORMATS)])
def test_no_room_on_the_disk(tmp_path, command):
    """Said by an error that names the file, and nothing is left of it; VTK and HDF5 would crash."""
    script(tmp_path / "run")
    code = (
        "import resource, sys; import numpy as np; "
        "from mrs.output import stored; from mrs.run import cli; "
        "stored.StoredFrame(sys.argv[2]).velocity(np.eye(3)); "  # compiled while there is room
        "resource.setrlimit(resource.RLIMIT_FSIZE, (2000, 2000)); sys.exit(cli.main(sys.argv[1:]))"
    )
    name, *suffix = command.split()
    options = ["--output", str(tmp_path / "new"), *(["--format", *suffix] if suffix else [])]
    arguments = [sys.executable, "-c", code, name, str(tmp_path / "run"), *options]
    done = subprocess.run(arguments, capture_output=True, text=True)
    assert done.returncode == 1
    assert re.search(r"^mrs: .*/new/.* could not be written", done.stderr, re.M)
    assert list((tmp_path / "new").iterdir()) == []


def test_what_is_made_of_a_run_goes_with_it(tmp_path):
    """Pictures, fields and frames of the run before; files of one's own stay."""
    script(tmp_path)
    foreign = [tmp_path / "mine.vtkhdf", tmp_path / "vtu" / "mine.vtu", tmp_path / "mine.png"]
    foreign[1].parent.mkdir()
    for path in foreign:
        path.write_text("mine")
    made = [render(tmp_path, tmp_path / f"a.{suffix}", size=(64, 64)) for suffix in ("png", "gif")]
    made += [*export(tmp_path, "vtu"), *mrs.write_field(tmp_path, resolution=5).paths]
    assert all(path.exists() for path in made)
    script(tmp_path, overwrite=True)
    assert not [path for path in made if path.exists()]
    assert [path.read_text() for path in foreign] == ["mine"] * 3


def test_points_without_forces_and_without_meta(tmp_path):
    """Files that something else wrote."""
    vtkhdf.create(tmp_path / "dust.vtkhdf", Topology(np.arange(3), []))
    vtkhdf.append(tmp_path / "dust.vtkhdf", 0.0, np.eye(3), {"velocity": np.eye(3)})
    with pytest.raises(ValueError, match=r"dust.vtkhdf lacks tolerance, viscosity, on which"):
        StoredFrame(tmp_path)
