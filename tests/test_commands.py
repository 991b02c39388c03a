"""Every command does what its help says; `mrs.restart` goes on with a script as `resume` does."""

import json
import shutil

import imageio.v3 as iio
import meshio
import numpy as np
import pytest
import pyvista as pv

import mrs
from mrs.output import checkpoint
from mrs.output.render import render
from mrs.output.trajectory import Trajectory
from mrs.run import cli


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """Return the directory of a small run at its end: frames at 0, 0.05 and 0.1."""
    directory = tmp_path_factory.mktemp("runs") / "finished"
    options = ["--quick", "--set", "t_end=0.1", "--set", "interval=0.05"]
    assert cli.main(["run", "helical_swimmer", *options, "--output", str(directory)]) == 0
    return directory


def test_new(tmp_path, monkeypatch, capsys):
    """A scene that runs at once, with a picture and a check; it is never overwritten."""
    monkeypatch.chdir(tmp_path)
    assert cli.main(["new", "falling.py"]) == 0
    assert "mrs run falling.py --quick --picture" in capsys.readouterr().out
    assert "mrs run falling.py --options" in (tmp_path / "falling.py").read_text()
    assert cli.main(["run", "falling.py", "--quick", "--picture"]) == 0
    assert capsys.readouterr().out.strip().endswith("picture.png")
    assert iio.imread(tmp_path / "outputs" / "falling" / "picture.png").ndim == 3
    (tmp_path / "falling.py").write_text("mine")
    assert cli.main(["new", "falling.py"]) == 1
    assert "falling.py is there already" in capsys.readouterr().err
    assert (tmp_path / "falling.py").read_text() == "mine"
    assert cli.main(["new", "scene.toml"]) == 1
    assert "FILE.py must end in .py, got 'scene.toml'" in capsys.readouterr().err


def test_render(finished, tmp_path):
    """A picture, and a film of the three frames."""
    for name, shape in {"a.png": (64, 96, 3), "b.gif": (3, 64, 96, 3)}.items():
        to = ["--output", str(tmp_path / name), "--size", "96,64", "--color-by", "velocity"]
        assert cli.main(["render", str(finished), *to]) == 0
        pixels = iio.imread(tmp_path / name)
        assert pixels.shape == shape
        assert np.ptp(pixels) > 100


def test_field(finished, tmp_path):
    """Velocity on a grid, and streamlines, beside the run."""
    run = tmp_path / "run"
    shutil.copytree(finished, run)
    assert cli.main(["field", str(run), "--resolution", "20"]) == 0
    grid = pv.read(run / "field.vti")
    assert max(grid.dimensions) == 20
    assert grid["velocity"].shape == (grid.n_points, 3)
    assert pv.read(run / "streamlines.vtp").n_lines > 0


def test_export(finished, tmp_path):
    """A file a frame, which the other program reads."""
    assert cli.main(["export", str(finished), "--format", "vtu", "--output", str(tmp_path)]) == 0
    files = sorted(tmp_path.rglob("*.vtu"))
    with Trajectory(finished / "flagellum.vtkhdf") as trajectory:
        assert len(files) == len(trajectory) == 3
        for number, file in enumerate(files):
            points = meshio.read(file).points
            np.testing.assert_allclose(points, trajectory.points(number), rtol=0, atol=1e-6)


def test_info(finished, capsys):
    """For people and for programs."""
    assert cli.main(["info", str(finished)]) == 0
    told = capsys.readouterr().out
    assert told.startswith("helical_swimmer: t = 0.1 of 0.1, ")
    assert "finished" in told
    assert "flagellum.vtkhdf: 3 frames of 41 points" in told
    assert cli.main(["info", str(finished), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["time"] == 0.1


def test_run(tmp_path, capsys):
    """With a picture of the last state, between two intervals; options are listed without a run."""
    directory = tmp_path / "run"
    options = ["--quick", "--set", "t_end=0.07", "--set", "interval=0.05"]
    options += ["--output", str(directory), "--picture"]
    assert cli.main(["run", "helical_swimmer", *options]) == 0
    assert f"{directory}: t = 0.07, " in capsys.readouterr().out
    np.testing.assert_array_equal(mrs.open_run(directory).times, [0.0, 0.05, 0.07])
    last = render(directory, tmp_path / "last.png", frame=2)
    np.testing.assert_array_equal(iio.imread(directory / "picture.png"), iio.imread(last))
    assert cli.main(["run", "helical_swimmer", "--options"]) == 0
    assert "t_end = 5.0\n    simulated time\n" in capsys.readouterr().out


def test_resume(finished, tmp_path, capsys):
    """From the end of a run to a later one."""
    directory = tmp_path / "run"
    shutil.copytree(finished, directory)
    assert cli.main(["resume", str(directory), "--t-end", "0.15"]) == 0
    assert f"{directory}: t = 0.15, " in capsys.readouterr().out
    with Trajectory(directory / "flagellum.vtkhdf") as trajectory:
        np.testing.assert_allclose(trajectory.times, [0.0, 0.05, 0.1, 0.15], rtol=1e-15)


def test_check(capsys):
    """The checked number of a scenario."""
    assert cli.main(["check", "fibre_in_shear"]) == 0
    told = capsys.readouterr().out
    assert told.startswith("fibre_in_shear: ")
    assert told.endswith(": ok\n")


def test_plot(finished, tmp_path):
    """Curves of the log."""
    path = tmp_path / "log.png"
    assert cli.main(["plot", str(finished), "--output", str(path)]) == 0
    assert iio.imread(path).ndim == 3


@pytest.mark.parametrize(
    ("typed", "near"), [("--siez=9,9", "--size"), ("--outptu", "--output"), ("--quux", None)]
)
def test_a_misspelt_option(finished, capsys, typed, near):
    """The error is that of the command, and names its nearest option."""
    with pytest.raises(SystemExit, match="2"):
        cli.main(["render", str(finished), typed])
    told = capsys.readouterr().err
    assert told.startswith("usage: mrs render ")
    advice = f"; did you mean '{near}'?" if near else ""
    assert told.endswith(f"mrs render: error: unrecognized arguments: {typed}{advice}\n")


def test_every_command_is_tested():
    assert [name for name in cli._COMMANDS if f"test_{name}" not in globals()] == []


def script(directory):
    """Return the simulation of a script."""
    positions, orientations = mrs.random_suspension(5, size=3.0, spacing=0.4)
    swimmers = mrs.Swimmers(positions, orientations, length=1.0, force=1.0)
    tracers = mrs.Tracers([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    fluid = mrs.Fluid(epsilon=0.1, background=mrs.flows.shear(0.5))
    return mrs.Simulation(fluid, [swimmers, tracers], output=mrs.Output(directory, 0.05))


def test_restart_goes_on_as_if_there_had_been_no_stop(tmp_path):
    """Bitwise: the state, the history of the steps, and all frames."""
    whole, halves = tmp_path / "whole", tmp_path / "halves"
    script(whole).run(0.2)
    script(halves).run(0.1)
    sim = mrs.restart(script(halves))
    assert sim.time == 0.1
    sim.run(0.2)
    (arrays, values), (arrays2, values2) = (
        checkpoint.load(run / "checkpoint.h5") for run in (whole, halves)
    )
    assert values["time"] == values2["time"] == 0.2
    assert values["integrator"] == values2["integrator"]
    np.testing.assert_equal(arrays, arrays2)
    for name in ("swimmers.vtkhdf", "tracers.vtkhdf"):
        with Trajectory(whole / name) as one, Trajectory(halves / name) as other:
            np.testing.assert_array_equal(one.times, other.times)
            for frame in range(len(one)):
                np.testing.assert_array_equal(one.points(frame), other.points(frame))
