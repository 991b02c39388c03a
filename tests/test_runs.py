"""Runs in directories: killed and resumed, stopped, refused; what the command line says."""

import csv
import inspect
import json
import random
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import mrs
from mrs.fluid.mobility import Mobility
from mrs.output import checkpoint, vtkhdf
from mrs.output.trajectory import Trajectory
from mrs.run import cli, scenario_files

SCENE = Path(__file__).parents[1] / "docs" / "scene.toml"


def swim(directory, t_end):
    """Return the arguments of a small run."""
    options = ["--quick", "--set", f"t_end={t_end}", "--output", str(directory)]
    return ["run", "helical_swimmer", *options]


def state_of(directory):
    """Return the last checkpoint of a run."""
    return checkpoint.load(directory / "checkpoint.h5")


def trajectories(directory):
    """Return times, points and arrays of all frames of all files of a run."""
    found = {}
    # A kill while a file is written leaves a hidden part of it; the file itself is whole.
    for path in sorted(directory.glob("[!.]*.vtkhdf")):
        with Trajectory(path) as file:
            numbers = range(len(file))
            arrays = [(file.points(i), file.point_data(i), file.cell_data(i)) for i in numbers]
            found[path.name] = (file.times, arrays)
    return found


def logged(directory):
    """Return the log, without what is counted anew in each process."""
    with (directory / "log.csv").open() as file:
        rows = list(csv.DictReader(file))
    return [{k: v for k, v in row.items() if k not in ("wall", "evaluations")} for row in rows]


def assert_equal_runs(one, other):
    """Compare checkpoints, trajectories and logs bit by bit."""
    (arrays, values), (arrays2, values2) = map(state_of, (one, other))
    assert values["time"] == values2["time"]
    assert values["integrator"] == values2["integrator"]
    assert arrays.keys() == arrays2.keys()
    for name, array in arrays.items():
        np.testing.assert_array_equal(array, arrays2[name], err_msg=name)
    np.testing.assert_equal(trajectories(one), trajectories(other))
    assert logged(one) == logged(other)


def begin(*arguments):
    """Start the command line in a process of its own."""
    command = [sys.executable, "-m", "mrs", *map(str, arguments)]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def kill_on_its_way(process, checkpoint_file, delay):
    """Kill -9 some time after the process has written its first checkpoint."""
    before = checkpoint_file.stat().st_mtime_ns if checkpoint_file.exists() else None
    while process.poll() is None:
        if checkpoint_file.exists() and checkpoint_file.stat().st_mtime_ns != before:
            time.sleep(delay)
            break
        time.sleep(0.001)
    process.kill()
    process.wait()


def test_killed_and_resumed_run_is_bitwise_the_same(tmp_path):
    """20 kills -9 at random moments, with a checkpoint after every step."""
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    options = ["--set", "checkpoint_seconds=0", "--set", "t_end=0.4"]
    assert cli.main(["run", str(SCENE), "--output", str(whole), *options]) == 0
    moments = random.Random(0)
    steps = []
    for kill in range(20):
        arguments = ["resume", killed] if kill else ["run", SCENE, "--output", killed, *options]
        kill_on_its_way(begin(*arguments), killed / "checkpoint.h5", moments.uniform(0.0, 0.1))
        steps.append(state_of(killed)[1]["integrator"]["steps"])
    assert len(set(steps)) > 10, "the kills did not hit a run on its way"
    assert cli.main(["resume", str(killed)]) == 0
    assert_equal_runs(whole, killed)


def test_walltime_stops_in_good_order_and_resume_ends_the_same(tmp_path):
    whole, halves = tmp_path / "whole", tmp_path / "halves"
    assert cli.main(swim(whole, 0.4)) == 0
    assert cli.main([*swim(halves, 0.4), "--max-walltime", "0"]) == 0
    assert 0.0 < mrs.info(halves)["time"] < 0.4
    assert cli.main(["resume", str(halves)]) == 0
    assert_equal_runs(whole, halves)


def test_a_profile_changes_nothing(tmp_path, capsys):
    plain, profiled = tmp_path / "plain", tmp_path / "profiled"
    assert cli.main(swim(plain, 0.2)) == 0
    assert "| near |" not in capsys.readouterr().out
    assert cli.main([*swim(profiled, 0.2), "--profile"]) == 0
    assert "| near |" in capsys.readouterr().out
    assert_equal_runs(plain, profiled)
    with (profiled / "profile.csv").open() as file:
        pairs = {row["stage"]: row["pairs"] for row in csv.DictReader(file)}
    evaluations = mrs.info(profiled)["log"]["evaluations"]
    assert int(pairs["near"]) == (int(evaluations) - 1) * 41**2
    assert cli.main([*swim(profiled, 0.2), "--overwrite"]) == 0
    assert not (profiled / "profile.csv").exists()


def test_interrupt_leaves_a_checkpoint(tmp_path):
    """Ctrl-C while the third step is computed: the state after the second is kept."""

    class Interrupt(mrs.Tracker):
        def handle(self, sim):
            if sim.stepper.steps == 2:
                sim.mobility.__class__ = type("Interrupted", (Mobility,), {"__call__": interrupted})

    def interrupted(*_):
        raise KeyboardInterrupt

    scene = scenario_files.make("helical_swimmer", {}, quick=True)
    sim = scene.simulation(tmp_path / "run")
    sim.trackers.append(Interrupt())
    with pytest.raises(KeyboardInterrupt):
        sim.run(scene.t_end)
    arrays, values = state_of(tmp_path / "run")
    assert values["integrator"]["steps"] == 2
    np.testing.assert_array_equal(arrays["positions"], sim.state.positions)


def test_frames_are_at_multiples_of_the_interval_and_at_the_end(tmp_path):
    assert cli.main(swim(tmp_path / "r", 0.52)) == 0
    with Trajectory(tmp_path / "r" / "flagellum.vtkhdf") as file:
        np.testing.assert_array_equal(file.times, [*(0.05 * np.arange(11)), 0.52])


def test_a_run_is_not_overwritten(tmp_path, capsys):
    arguments = swim(tmp_path / "r", 0.05)
    assert cli.main(arguments) == 0
    assert cli.main(arguments) == 1
    assert "holds a run" in capsys.readouterr().err
    assert cli.main([*arguments, "--overwrite"]) == 0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["run", "cilia_aray"], "did you mean 'cilia_array'"),
        (["run", "cilia_array", "--set", "row=3"], "did you mean 'rows'"),
        (["run", "cilia_array", "--set", "rows=0"], "rows: input should be greater than or equal"),
        (["run", "cilia_array", "--set", "rows"], "KEY=VALUE"),
        (["run", "cilia_array", "--set", "backend.degre=3"], "did you mean 'backend.degree'"),
        (["run", "cilia_array", "--set", "backend.name=fast"], "'kitc'"),
        (["run", "cilia_array", "--set", "integrator.dt=never"], "integrator.dt"),
        (["run", "no_such_file.toml"], "no_such_file.toml"),
        (["resume", "no_such_run"], "holds no run"),
        (["info", "no_such_run"], "no_such_run"),
        (["render", "no_such_run"], "no_such_run"),
    ],
)  # fmt: skip
def test_mistakes_are_named(arguments, message, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert cli.main(arguments) == 1
    assert message in capsys.readouterr().err
    assert not list(tmp_path.iterdir()), "something was written"


def test_config_gives_the_same_scene_again(tmp_path):
    a, b = tmp_path / "a", tmp_path / "b"
    assert cli.main(["run", str(SCENE), "--output", str(a), "--set", "t_end=0.05"]) == 0
    assert cli.main(["run", str(a / "config.toml"), "--output", str(b)]) == 0
    assert_equal_runs(a, b)


def test_info_for_programs(tmp_path, capsys):
    assert cli.main(swim(tmp_path / "r", 0.1)) == 0
    capsys.readouterr()
    assert cli.main(["info", str(tmp_path / "r"), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["finished"]
    assert found["time"] == 0.1
    assert found["files"]["flagellum.vtkhdf"] == {"frames": 3, "points": 41, "time": 0.1}
    assert found["checkpoint"] == {"time": 0.1, "steps": found["steps"]}
    assert found["log"]["t"] == 0.1
    assert found["options"]["nodes"] == 41


def test_a_frame_that_is_not_there(tmp_path, capsys):
    run = tmp_path / "run"
    assert cli.main(swim(run, 0.05)) == 0
    assert cli.main(["field", str(run), "--frame", "2"]) == 1
    assert f"frame: {run} has 2 frames, none number 2" in capsys.readouterr().err
    assert cli.main(["field", str(run), "--frame", "-2", "--resolution", "3"]) == 0


@pytest.mark.parametrize("error", [RuntimeError, FloatingPointError, OverflowError])
def test_errors_are_said_without_a_traceback(error, capsys, monkeypatch):
    def failed(directory):
        raise error("no OpenGL")

    monkeypatch.setattr(cli, "info", failed)
    assert cli.main(["info", "run"]) == 1
    assert capsys.readouterr().err == "mrs: no OpenGL\n"


def test_a_scenario_of_ones_own(tmp_path):
    """A copy of a scenario in a file is run, and resumed, by its path."""
    source = Path(inspect.getfile(scenario_files.find("helical_swimmer")))
    mine = tmp_path / "mine.py"
    mine.write_text(source.read_text())
    run = tmp_path / "run"
    assert cli.main(["run", str(mine), "--quick", "--set", "t_end=0.05", "--output", str(run)]) == 0
    assert cli.main(["resume", str(run), "--t-end", "0.1"]) == 0
    assert mrs.info(run)["time"] == 0.1


def test_nothing_needs_pictures_to_compute():
    """pyvista, vtk, meshio, imageio and scipy's parts are imported by what uses them only."""
    heavy = {"pyvista", "vtk", "vtkmodules", "meshio", "imageio", "matplotlib", "scipy.spatial"}
    code = f"import sys, mrs, mrs.run.cli; print(sorted({heavy} & set(sys.modules)))"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "[]"


def test_stopped_between_the_files_of_two_bodies(tmp_path, monkeypatch):
    """Ctrl-C after one file has the frame and before the other: resume ends as if it had not."""
    whole, halves = tmp_path / "whole", tmp_path / "halves"
    arguments = ["run", str(SCENE), "--set", "t_end=0.3", "--output"]
    assert cli.main([*arguments, str(whole)]) == 0
    append = vtkhdf.append

    def interrupted(path, when, *frame):
        if path.stem == "motor" and when > 0.15:
            raise KeyboardInterrupt
        append(path, when, *frame)

    monkeypatch.setattr(vtkhdf, "append", interrupted)
    assert cli.main([*arguments, str(halves)]) == 130
    monkeypatch.undo()
    assert cli.main(["resume", str(halves)]) == 0
    assert_equal_runs(whole, halves)


def test_interrupted_step_leaves_no_trace(monkeypatch):
    """The step size and the spectrum belong to the state: both are those before the step."""
    sim = scenario_files.make("helical_swimmer", {}, quick=True).simulation()
    sim.step(0.05)
    before = sim.snapshot()

    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(type(sim.state), "moved", interrupted)
    with pytest.raises(KeyboardInterrupt):
        sim.step(0.05)
    np.testing.assert_equal(sim.snapshot(), before)


def test_stopped_before_the_first_frame(tmp_path, monkeypatch):
    """There is a checkpoint before anything is computed, and the run can go on from it."""
    whole, early = tmp_path / "whole", tmp_path / "early"
    assert cli.main(swim(whole, 0.1)) == 0

    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(Mobility, "__call__", interrupted)
    assert cli.main(swim(early, 0.1)) == 130
    monkeypatch.undo()
    assert cli.main(["resume", str(early)]) == 0
    assert_equal_runs(whole, early)


def test_one_run_at_a_time_in_a_directory(tmp_path, capsys):
    run = tmp_path / "run"
    assert cli.main(swim(run, 0.05)) == 0
    with mrs.output.run_directory.held(run):
        assert cli.main(["resume", str(run), "--t-end", "1"]) == 1
        assert cli.main([*swim(run, 0.05), "--overwrite"]) == 1
    assert capsys.readouterr().err.count("a run is going on in it") == 2
    assert cli.main(["resume", str(run), "--t-end", "0.1"]) == 0


def test_a_new_end_is_remembered(tmp_path, capsys):
    run = tmp_path / "run"
    assert cli.main(swim(run, 0.05)) == 0
    assert cli.main(["resume", str(run), "--t-end", "0.2", "--max-walltime", "0"]) == 0
    assert not mrs.info(run)["finished"]
    assert cli.main(["resume", str(run)]) == 0
    assert mrs.info(run)["time"] == 0.2
    assert cli.main(["resume", str(run), "--t-end", "0.1"]) == 1
    assert "t_end must be at least the present time 0.2" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["../evil", "a/b", "", ".", "x" * 300, 3, None])
def test_names_are_those_of_files(name):
    with pytest.raises(ValueError, match="name must be a text of 1 to 64 letters"):
        mrs.Tracers([[0.0, 0.0, 0.0]], name=name)


@pytest.mark.parametrize("values", [(1.0, 2.0), 5.0, [[1.0, 2.0, 3.0]] * 7, np.ones((4, 1))])
def test_what_users_functions_give_is_checked(values):
    """Shapes that would broadcast along the wrong axis among them."""
    line = mrs.geometry.straight(1.0, 4)
    moduli = {"bending": 1.0, "twisting": 1.0, "shearing": 1.0, "stretching": 1.0}
    with pytest.raises(ValueError, match="beat must give"):
        mrs.Rods(line, beat=lambda s, t: values, **moduli)
    with pytest.raises(ValueError, match="base: velocity must give"):
        mrs.Rods(line, base=mrs.Drive(velocity=lambda t: values), **moduli)
    flow = mrs.flows.UserFlow(lambda points, time: values)
    sim = mrs.Simulation(mrs.Fluid(background=flow), [mrs.Tracers(np.ones((4, 3)))])
    with pytest.raises(mrs.SimulationError, match="at time 0: background velocity must give"):
        sim.run(1.0)


@pytest.mark.parametrize(
    ("rods", "meant"),
    [({"bendin": 1.0}, "rods.bending"), ({"shape": {"kind": "ring", "radios": 1}}, "radius")],
)
def test_nearest_option_within_a_body(rods, meant):
    with pytest.raises(mrs.ScenarioError, match=f"did you mean '.*{meant}'"):
        scenario_files.make("scene", {"rods": [rods]})


def test_positions_of_swimmers_in_toml():
    swimmers = {"positions": [[0, 0, 0]], "orientations": [[0, 0, 1]], "length": 1, "force": 1}
    scene = scenario_files.make("scene", {"fluid": {"epsilon": 0.1}, "swimmers": [swimmers]})
    (body,) = scene.simulation().bodies
    np.testing.assert_array_equal(body.positions, [[0.0, 0.0, 0.0]])
    del swimmers["positions"]
    scene = scenario_files.make("scene", {"fluid": {"epsilon": 0.1}, "swimmers": [swimmers]})
    with pytest.raises(mrs.ScenarioError, match="a suspension, or positions and orientations"):
        scene.simulation()
