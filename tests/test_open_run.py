"""Runs on disk read in Python: finished, going on, killed, resumed, begun anew, exported."""

import subprocess
import sys
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

import mrs
import treecode as tc
from mrs.output import vtkhdf
from mrs.output.export import export
from mrs.output.series import ChangedError
from mrs.output.stored import StoredFrame, fluid_meta, stored_lattices
from mrs.output.topology import Topology
from mrs.output.trajectory import Trajectory
from mrs.run import cli

ROOT = Path(__file__).parents[1]
TARGETS = np.array([[0.0, 0.0, 2.0], [1.0, -3.0, 0.5]])


class Watcher(mrs.Tracker):
    """Reads the run from inside: opened at its first frame, and looked at again at each later."""

    when = mrs.Interval(0.01)

    def initialize(self, sim):
        self.run = mrs.open_run(sim.output.directory)
        self.seen = [len(self.run.times)]

    def handle(self, sim):
        before = self.run["rods"].positions
        self.run.refresh()
        self.seen.append(len(self.run.times))
        assert self.run.times[-1] == sim.time
        assert not self.run.info["finished"] or sim.time == sim.t_end
        assert len(before) == self.seen[-2], "what was taken before stays as it was"
        assert np.asarray(before).shape == before.shape
        last = self.run["rods"].positions[-1]
        rods = sim.bodies[0]
        np.testing.assert_array_equal(last.reshape(-1, 3), sim.body_state(rods).positions)
        self.velocity = sim.velocity(TARGETS)


def scene(directory):
    """Two clamped rods of equal lengths that beat, and tracers."""
    straight = mrs.geometry.straight(1.0, 5, direction=(0.0, 0.6, 0.8))
    rods = mrs.Rods(
        mrs.geometry.array(straight, [[0.0, 0.0, 0.0], [2.0, 0.0, 0.0]]),
        bending=1.0, twisting=1.0, shearing=10.0, stretching=10.0, epsilon=0.2, base="clamped",
        beat=mrs.TravellingWave(amplitude=(0.6, 0.0, 0.0), wavelength=1.0, period=1.0),
    )  # fmt: skip
    dust = mrs.Tracers(np.random.default_rng(0).uniform(-2.0, 2.0, (7, 3)), name="dust")
    return mrs.Simulation(
        mrs.Fluid(background=mrs.flows.shear(0.1)), [rods, dust], backend="direct",
        output=mrs.Output(directory, 0.01), trackers=[Watcher()],
    )  # fmt: skip


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A run of a script that was watched, and stopped and resumed on its way."""
    directory = tmp_path_factory.mktemp("run") / "rods"
    scene(directory).run(0.02)
    sim = mrs.restart(scene(directory)).run(0.05)
    return sim, directory


def test_run_is_read_while_it_goes_on_and_after_a_resume(finished):
    sim, directory = finished
    assert sim.trackers[-1].seen == [3, 4, 5, 6]
    run = mrs.open_run(directory)
    np.testing.assert_allclose(run.times, 0.01 * np.arange(6), rtol=1e-15)
    assert run.bodies == ("dust", "rods")
    assert run.info["finished"]
    assert run.config["run"]["t_end"] == 0.05
    assert run["rods"].kind == "rods"
    with Trajectory(directory / "rods.vtkhdf") as file:
        for i, (positions, force) in enumerate(
            zip(run["rods"].positions, run["rods"]["force"], strict=True)
        ):
            np.testing.assert_array_equal(positions.reshape(-1, 3), file.points(i))
            np.testing.assert_array_equal(force.reshape(-1, 3), file.point_data(i)["force"])
    assert run["rods"].positions.shape == (6, 2, 5, 3)
    assert run["rods"]["bending_energy"].shape == (6, 2)
    assert run["rods"]["arclength"].shape == (2, 5)
    assert run["dust"].positions.shape == (6, 7, 3)
    assert run["dust"].positions.dtype == np.float64


def test_log_is_columns(finished):
    run = mrs.open_run(finished[1])
    np.testing.assert_array_equal(run.log["t"], run.times)
    assert run.log["step"].dtype == np.int64
    assert np.isfinite(run.log["elastic_energy"]).all()
    assert np.isnan(run.log["sampled_error"][1])  # a value in each tenth row only
    assert run.log["backends"][-1] == "direct direct"  # of rods, of tracers
    with pytest.raises(KeyError, match=r"column must be one of 'step', .*, got 'energy'"):
        run.log["energy"]
    assert run.log.get("energy") is None


def test_velocity_and_mesh_of_a_frame(finished):
    """Forces are stored in singles, and the background is known without the script."""
    sim, directory = finished
    run = mrs.open_run(directory)
    expected = sim.trackers[-1].velocity
    np.testing.assert_allclose(run.velocity(TARGETS), expected, rtol=0, atol=1e-6)
    assert np.abs(run.velocity(TARGETS, 0) - expected).max() > 1e-5
    mesh = run.mesh(-1)
    assert list(mesh.keys()) == ["dust", "rods"]
    np.testing.assert_array_equal(mesh["rods"].points, run["rods"].positions[-1].reshape(-1, 3))
    assert set(mesh["rods"].array_names) == set(run["rods"].fields)
    for frame in (6, -7):
        with pytest.raises(IndexError, match=f"has 6 frames, none number {frame}"):
            run.velocity(TARGETS, frame)


def test_a_run_stands_for_its_directory(finished):
    run = mrs.open_run(finished[1])
    tracks = mrs.observables.tracks(run, "dust")
    np.testing.assert_array_equal(tracks.times, run.times)
    np.testing.assert_array_equal(tracks.positions, run["dust"].positions)
    points, loads = mrs.observables.frame_loads(run, 2)
    np.testing.assert_array_equal(points.reshape(2, 5, 3), run["rods"].positions[2])
    np.testing.assert_array_equal(loads[:, :3].reshape(2, 5, 3), run["rods"]["force"][2])
    assert mrs.info(run) == run.info


def test_export_leaves_a_run_as_it_is(finished):
    """What is exported is no run: other programs read it, and pyvista."""
    import pyvista as pv

    _, directory = finished
    files = export(directory, "vtp", frames=[1])
    run = mrs.open_run(directory)
    mesh = next(pv.read(file) for file in files if file.name == "rods_000001.vtp")
    np.testing.assert_array_equal(mesh.points, run["rods"].positions[1].reshape(-1, 3))
    with pytest.raises(FileNotFoundError, match="holds no run"):
        mrs.open_run(directory / "vtp")


def test_shown_in_text_and_in_notebooks(finished):
    sim, directory = finished
    run = mrs.open_run(directory)
    assert "frames=6, t = 0 to 0.05" in repr(run)
    assert "shape=time:6 line:2 node:5 xyz:3" in repr(run["rods"].positions)
    assert repr(sim.bodies[0]) == "<Rods: name=rods, kind=rods, pieces=2, points=10>"
    plan = tc.Plan(tc.Stokeslet(), "direct").set_points(TARGETS)
    assert repr(plan) == "<Plan: kernel=Stokeslet(), backend=direct, sources=2, targets=2>"
    assert repr(sim).startswith("<Simulation: t=0.05, steps=")
    stored = (run, run["rods"], run["rods"].positions, run.log)
    for thing in (*stored, sim, *sim.bodies, sim.profile, plan):
        assert thing._repr_html_().startswith("<table>")
        assert f"<caption>{type(thing).__name__}</caption>" in thing._repr_html_()


POINTS, FRAMES = 4000, 40


@pytest.fixture(scope="module")
def wide(tmp_path_factory):
    """Many points in four lines, the second half of which is read backwards, and all positions."""
    directory = tmp_path_factory.mktemp("wide")
    path, rng = directory / "fibres.vtkhdf", np.random.default_rng(1)
    lines = [line[:: 1 - 2 * (i > 1)] for i, line in enumerate(np.arange(POINTS).reshape(4, -1))]
    vtkhdf.create(path, Topology(np.arange(0), lines), {"mass": np.arange(POINTS)})
    frames = rng.standard_normal((FRAMES, POINTS, 3))
    for time, points in enumerate(frames):
        vtkhdf.append(path, float(time), points, {"speed": points[:, 0]})
    return directory, frames[:, np.array(lines)]


@pytest.mark.parametrize(
    "index",
    [
        np.s_[3], np.s_[-1], np.s_[2:9:3], np.s_[::-4], np.s_[[4, 1]], np.s_[:0], np.s_[...],
        np.s_[5, 2], np.s_[:3, 1, 10], np.s_[:3, :, ::100, 2], np.s_[..., 0], np.s_[1, ..., :2],
        np.s_[7, 3, 999, 1], np.s_[:2, [0, 3], [5, 6]], np.s_[2, np.array([1, 0, 1, 0]) > 0],
        np.s_[..., 1, 2, 3, 0], np.s_[()], np.s_[np.arange(FRAMES) > 37, 1],
    ],
    ids=str,
)  # fmt: skip
def test_indices_are_those_of_numpy(wide, index):
    directory, expected = wide
    found = mrs.open_run(directory)["fibres"].positions[index]
    np.testing.assert_array_equal(found, expected[index])
    assert np.shape(found) == np.shape(expected[index])


def test_fields_are_read_alike(wide):
    """Those that vary are singles in the file; constant ones are without the axis of frames."""
    directory, positions = wide
    fibres = mrs.open_run(directory)["fibres"]
    expected = positions[..., 0].astype(np.float32)
    np.testing.assert_array_equal(fibres["speed"], expected)
    np.testing.assert_array_equal(fibres["speed"][3:, 2, ::7], expected[3:, 2, ::7])
    assert fibres["mass"].shape == (4, POINTS // 4)
    assert fibres["mass"][3, 0] == POINTS - 1


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_precision_of_fields(tmp_path, precision):
    """Doubles are the bits of the simulation; the velocity that they give is that to rounding."""
    rods = mrs.Rods(
        mrs.geometry.straight(1.0, 5), intrinsic_curvature=(1.0, 0.0, 0.0), epsilon=0.2,
        bending=1.0, twisting=1.0, shearing=10.0, stretching=10.0,
    )  # fmt: skip
    output = mrs.Output(tmp_path, 0.01, precision=precision)
    sim = mrs.Simulation(mrs.Fluid(), [rods], backend="direct", output=output).run(0.01)
    run = mrs.open_run(tmp_path)
    assert run["rods"]["force"].dtype == run["rods"]["radius"].dtype == precision
    forces = sim.now.loads[:, :3].astype(precision).reshape(1, 5, 3)
    np.testing.assert_array_equal(run["rods"]["force"][-1], forces)
    exact = precision == "float64"
    error = np.abs(run.velocity(TARGETS) - sim.velocity(TARGETS)).max()
    assert (error < 1e-15) == exact
    assert (StoredFrame(run).error(TARGETS, run.velocity(TARGETS)).rounding == 0.0) == exact


def test_wrong_indices_are_refused(wide):
    positions = mrs.open_run(wide[0])["fibres"].positions
    for index in (FRAMES, (0, 4), (0, 0, 0, 0, 0)):
        with pytest.raises(IndexError):
            positions[index]
    with pytest.raises(KeyError, match="field must be one of 'mass', 'speed', got 'force'"):
        mrs.open_run(wide[0])["fibres"]["force"]
    with pytest.raises(KeyError, match="body must be one of 'fibres', got 'rods'"):
        mrs.open_run(wide[0])["rods"]


def test_only_what_is_asked_for_is_in_memory(wide):
    """A frame of 96 kB, of 3.8 MB: numbers, their places in the frame, and a few copies of them."""
    positions = mrs.open_run(wide[0])["fibres"].positions
    positions[0]
    frame = positions.nbytes // FRAMES

    def peak(read):
        tracemalloc.start()
        try:
            read()
            return tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()

    assert peak(lambda: [points.mean() for points in positions]) < 8 * frame
    assert peak(lambda: positions[:, 1, 5]) < frame
    assert peak(lambda: positions[::10]) < (4 + 8) * frame
    assert peak(lambda: np.asarray(positions)) < (FRAMES + 8) * frame


@pytest.mark.parametrize("rate", [0.0, 0.5], ids=["at rest", "sheared"])
def test_positions_of_periodic_runs_are_unwrapped(tmp_path, rate):
    """x = wrapped + image . lattice, of the lattice at that time; within a few cells to 1e-13."""
    path = tmp_path / "dust.vtkhdf"
    box = mrs.Periodic([[2.0, 0.0, 0.0], [0.5, 2.0, 0.0], [0.0, 0.0, 3.0]])
    meta = fluid_meta(mrs.Fluid(boundary=box, background=mrs.flows.shear(rate)), 1e-4)
    vtkhdf.create(path, Topology(np.arange(5), []), meta=meta)
    expected = np.random.default_rng(4).uniform(-9.0, 9.0, (3, 5, 3))
    cells = stored_lattices(meta, range(3))
    assert (np.ptp(cells, axis=0).max() > 0.4) == (rate > 0.0)
    for time, (points, cell) in enumerate(zip(expected, cells, strict=True)):
        image = np.floor(points @ np.linalg.inv(cell)).astype(int)
        vtkhdf.append(path, float(time), points - image @ cell, {"image": image})
    dust = mrs.open_run(tmp_path)["dust"]
    np.testing.assert_allclose(dust.positions, expected, rtol=1e-13, atol=1e-13)
    np.testing.assert_array_equal(dust.positions[1:, 3:, 1], dust.positions[...][1:, 3:, 1])
    wrapped = dust.wrapped_positions[...] @ np.linalg.inv(cells)
    assert ((wrapped > -1e-12) & (wrapped < 1.0 + 1e-12)).all()
    np.testing.assert_array_equal(
        mrs.observables.tracks(tmp_path, "dust").positions, np.asarray(dust.positions)
    )


def write(path, times, points=4, lines=()):
    if not path.exists():
        vtkhdf.create(path, Topology(np.arange(points), list(lines)))
    for time in times:
        vtkhdf.append(path, time, np.full((points, 3), time))


@pytest.mark.parametrize(
    ("lines", "shape"),
    [
        ([[0, 1, 2], [3, 4, 5]], (2, 3)),
        ([[0, 1, 2, 0], [3, 4, 5, 3]], (2, 3)),  # closed
        ([[0, 3], [1, 4], [2, 5]], (3, 2)),  # as those of swimmers
        ([[0, 1], [2, 3, 4, 5]], (6,)),
        ([[0, 1], [2, 3]], (6,)),  # two points are on no line
        ([[0, 1, 2], [2, 3, 4]], (6,)),
        ([], (6,)),
    ],
)
def test_equal_lines_are_an_axis(tmp_path, lines, shape):
    write(tmp_path / "body.vtkhdf", [0.0, 1.0], 6, map(np.array, lines))
    body = mrs.open_run(tmp_path)["body"]
    assert body.positions.shape == (2, *shape, 3)
    assert len(body.topology.lines) == len(lines)


KILLED = """
import os, sys
import numpy as np
from mrs.output import vtkhdf
vtkhdf.set_steps = lambda *_: os._exit(9)  # the frame is written, its time is not
vtkhdf.append(sys.argv[1], 3.0, np.full((4, 3), 3.0))
"""


def test_a_frame_that_a_kill_left_half_is_none(tmp_path):
    """A file has room for sixteen frames; a run that goes on writes the frame again."""
    path = tmp_path / "body.vtkhdf"
    write(path, [0.0, 1.0, 2.0])
    run = mrs.open_run(tmp_path)
    command = [sys.executable, "-c", KILLED, str(path)]
    assert subprocess.run(command, cwd=ROOT, check=False).returncode == 9
    np.testing.assert_array_equal(run.refresh().times, [0.0, 1.0, 2.0])
    np.testing.assert_array_equal(run["body"].positions[:, 0, 0], [0.0, 1.0, 2.0])
    write(path, [3.0])
    np.testing.assert_array_equal(run.refresh()["body"].positions[-1], 3.0)


def test_frames_are_those_that_all_bodies_have(tmp_path):
    write(tmp_path / "early.vtkhdf", [0.0, 1.0, 2.0])
    write(tmp_path / "late.vtkhdf", [1.0, 2.0, 3.0], points=2)
    run = mrs.open_run(tmp_path)
    np.testing.assert_array_equal(run.times, [1.0, 2.0])
    for body in ("early", "late"):
        np.testing.assert_array_equal(run[body].positions[:, 0, 0], run.times)


def test_what_was_begun_anew_is_told(tmp_path):
    """Frames that are cut off, as by a resume, are missed only when they are asked for."""
    path = tmp_path / "body.vtkhdf"
    write(path, [0.0, 1.0, 2.0])
    run = mrs.open_run(tmp_path)
    positions = run["body"].positions
    vtkhdf.cut(path, 1.0)
    with pytest.raises(ChangedError, match=r"call refresh\(\)"):
        positions[0]
    write(path, [2.0, 3.0])  # the run is past it
    np.testing.assert_array_equal(positions[:, 0, 0], [0.0, 1.0, 2.0])
    path.unlink()
    write(path, [0.0, 1.0, 2.0], points=3)
    with pytest.raises(ChangedError):
        positions[0]
    assert run.refresh()["body"].positions.shape == (3, 3, 3)


def test_a_run_without_frames_and_no_run(tmp_path):
    with pytest.raises(FileNotFoundError, match="holds no run"):
        mrs.open_run(tmp_path)
    write(tmp_path / "body.vtkhdf", [])
    run = mrs.open_run(tmp_path)
    assert len(run.times) == 0
    assert run["body"].fields == ()
    with pytest.raises(ValueError, match="has no frame yet"):
        _ = run["body"].positions
    assert len(run.log) == 0


def test_pandas_and_xarray(finished):
    pytest.importorskip("pandas")
    pytest.importorskip("xarray")
    run = mrs.open_run(finished[1])
    assert run.log.to_pandas().set_index("t").loc[0.05, "step"] == run.log["step"][-1]
    tree = run.to_xarray()
    positions = tree["rods"]["positions"]
    assert positions.dims == ("time", "line", "node", "xyz")
    np.testing.assert_array_equal(
        positions.isel(time=3).sel(xyz="y"), run["rods"].positions[3, ..., 1]
    )
    assert tree["rods"]["arclength"].dims == ("line", "node")


def test_what_to_install(finished, monkeypatch):
    for name in ("pandas", "xarray"):
        monkeypatch.setitem(sys.modules, name, None)
    run = mrs.open_run(finished[1])
    for read in (run.to_xarray, run.log.to_pandas):
        with pytest.raises(ImportError, match=r"pip install 'mrs-treecode\[analysis\]'"):
            read()


def test_plane_of_the_field(finished, capsys):
    """A plane of a grid that has the spacing of the box, with the velocities of the simulation."""
    import pyvista as pv

    sim, directory = finished
    folder = directory / "plane"
    command = ["field", str(directory), "--plane", "z=0.75", "--resolution", "6"]
    assert cli.main([*command, "--output", str(folder)]) == 0
    assert [path.name for path in folder.iterdir()] == ["field.vti"]
    image = pv.read(folder / "field.vti")
    assert image.dimensions[2] == 1
    assert max(image.dimensions) == 6
    np.testing.assert_array_equal(image.points[:, 2], 0.75)
    np.testing.assert_allclose(image["velocity"], sim.velocity(image.points), rtol=0, atol=1e-5)
    for wrong in ("z", "w=1", "z=one", "z=1,2"):
        with pytest.raises(SystemExit):
            cli.main([*command[:2], "--plane", wrong])
        assert "must be an axis and a number as in z=0.5" in capsys.readouterr().err


def test_columns_of_the_log_as_curves(finished, capsys):
    _, directory = finished
    assert cli.main(["plot", str(directory)]) == 0
    assert (directory / "log.png").read_bytes().startswith(b"\x89PNG")
    assert "log.png" in (directory / "files.txt").read_text().split()
    destination = directory / "steps.svg"
    assert (
        cli.main(["plot", str(directory), "--columns", "step", "--output", f"{destination}"]) == 0
    )
    assert "<svg" in destination.read_text()
    capsys.readouterr()
    assert cli.main(["plot", str(directory), "--columns", "backends"]) == 1
    assert "columns must be one of 'step', 't', 'dt'" in capsys.readouterr().err
    assert cli.main(["plot", str(directory), "--output", "log.txt"]) == 1
    assert "destination must end in .png, .svg, .pdf, got log.txt" in capsys.readouterr().err
    assert cli.main(["plot", str(directory / "nothing")]) == 1
    assert "has no log.csv with rows" in capsys.readouterr().err
