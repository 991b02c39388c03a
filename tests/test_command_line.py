"""What the command line returns and says; signals; scenarios that a program makes itself."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
import time
from importlib.metadata import PackageNotFoundError
from pathlib import Path

import numpy as np
import pytest

import mrs
from mrs.output import checkpoint
from mrs.output.checkpoint import Checkpoints
from mrs.output.trajectory import Trajectory
from mrs.run import cli, scenario, scenario_files, signals
from mrs.run.resuming import scenario_of

ROOT = Path(__file__).parents[1]
SCENE = ROOT / "docs" / "scene.toml"

# Two scenarios in a file: tracers that are carried along x, one with a check that fails.
OWN = """
import numpy as np
from pydantic import Field
import mrs

class Dust(mrs.Scenario):
    t_end: float = Field(0.2, gt=0)
    def build(self, **common):
        flow = mrs.flows.QuadraticFlow(constant=[1.0, 0.0, 0.0])
        return mrs.Simulation(mrs.Fluid(background=flow), [mrs.Tracers(np.eye(3))], **common)
    def check(self, sim):
        return mrs.Check("way", float(sim.state.positions[0, 0] - 1.0), sim.time, 1e-9)

class Wrong(Dust):
    def check(self, sim):
        return mrs.Check("way", float(sim.state.positions[0, 0] - 1.0), 7.0, 1e-9)
"""


@pytest.fixture
def own(tmp_path):
    path = tmp_path / "own.py"
    path.write_text(OWN)
    return path


def program(*arguments, **options):
    """Start Python in a process of its own."""
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    command = [sys.executable, *map(str, arguments)]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen(command, env=environment, **(pipes | options))


# --- status and output ------------------------------------------------------------------------


def test_a_failed_check_is_a_failed_command(own, tmp_path, capsys):
    """Of a run and of a resumed one; not of one that was stopped on its way."""
    run = ["run", f"{own}:Wrong", "--output", str(tmp_path / "run")]
    assert cli.main([*run, "--max-walltime", "0"]) == 0
    assert "FAILED" not in capsys.readouterr().out
    assert cli.main(["resume", str(tmp_path / "run")]) == 1
    assert "way: 0.2, expected 7 to 1e-09 (relative): FAILED" in capsys.readouterr().out
    assert cli.main([*run, "--overwrite"]) == 1
    assert cli.main(["run", f"{own}:Dust", "--output", str(tmp_path / "dust")]) == 0


def test_one_of_several_scenarios_in_a_file(own, tmp_path, capsys):
    """The class is part of the name: the run finds it again, however it was begun."""
    assert cli.main(["run", str(own)]) == 1
    error = capsys.readouterr().err
    assert "several (Dust, Wrong); say which" in error
    assert f"{own}:Dust" in error
    assert cli.main(["run", f"{own}:Dsut"]) == 1
    assert "must define Dsut, it has Dust, Wrong" in capsys.readouterr().err
    scene = scenario_files.make(f"{own}:Wrong", {"t_end": 0.1})
    scene.simulation(tmp_path / "run").run(0.1)
    again = scenario_of(tmp_path / "run")
    assert type(again).__name__ == "Wrong"
    assert again.t_end == 0.1


def test_suffixes_in_capitals(own, tmp_path, capsys):
    """As some systems have them: the same file."""
    toml, python = tmp_path / "S.TOML", tmp_path / "S.PY"
    toml.write_text('scenario = "cilia_array"\n[options]\nrows = 1\n')
    python.write_text(OWN.split("class Wrong")[0])
    assert cli.main(["run", str(toml), "--options"]) == 0
    assert "rows = 1" in capsys.readouterr().out
    assert cli.main(["run", str(python), "--options"]) == 0
    assert "t_end = 0.2" in capsys.readouterr().out


@pytest.mark.parametrize("quick", [False, True])
def test_options_that_nobody_reads_to_the_end(quick):
    """Without a word, as `head` expects."""
    options = ["--options", *["--quick"] * quick]
    with program("-m", "mrs", "run", "cilia_array", *options) as process:
        process.stdout.close()
        assert process.stderr.read() == ""
        assert process.wait() == 141


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (MemoryError(), "mrs: not enough memory: MemoryError\n"),
        (MemoryError("Unable to allocate 8 TiB"), "mrs: not enough memory: Unable to allocate 8 T"),
        (EOFError("Ran out of input"), "mrs: Ran out of input\n"),
        (EOFError(), "mrs: EOFError\n"),
        (PackageNotFoundError("mrs-treecode"), "mrs: No package metadata was found for mrs-tree"),
        (BrokenPipeError(32, "Broken pipe"), "mrs: [Errno 32] Broken pipe\n"),  # of a film, say
    ],
)  # fmt: skip
def test_errors_take_one_line(error, said, capsys, monkeypatch):
    def failed(directory):
        raise error

    monkeypatch.setattr(cli, "info", failed)
    assert cli.main(["info", "run"]) == 1
    printed = capsys.readouterr().err
    assert printed.startswith(said)
    assert printed.count("\n") == 1


def test_an_array_that_no_memory_holds(capsys, tmp_path):
    run = ["run", "fibre_in_shear", "--set", "tracers=1000000000000000", "--output"]
    assert cli.main([*run, str(tmp_path / "run")]) == 1
    assert capsys.readouterr().err.startswith("mrs: not enough memory: Unable to allocate")
    assert not (tmp_path / "run").exists()


def test_numbers_of_the_log_are_numbers(own, tmp_path, capsys):
    assert cli.main(["run", f"{own}:Dust", "--output", str(tmp_path / "run")]) == 0
    capsys.readouterr()
    assert cli.main(["info", str(tmp_path / "run"), "--json"]) == 0
    row = json.loads(capsys.readouterr().out)["log"]
    assert row["t"] == 0.2
    assert isinstance(row["step"], int)
    assert row["max_speed"] == 1.0
    assert row["backends"] is None


# --- scenarios that only their program makes ------------------------------------------------------

NOTEBOOK = (
    OWN
    + """
scene = Dust()
sim = scene.simulation({directory!r})
if sim.output and {again}:
    sim = mrs.restart(sim)
sim.run({t_end})
print(sim.time)
"""
)


@pytest.mark.parametrize("in_file", [False, True], ids=["notebook", "script"])
def test_a_scenario_of_a_notebook_or_script(in_file, tmp_path, capsys):
    """It runs in a directory, is not named there, and goes on in the program that made it.

    A script has a file, but to look there for the scenario would be to run the script.
    """
    directory = str(tmp_path / "run")
    for again, t_end in ((False, 0.2), (True, 0.4)):
        text = NOTEBOOK.format(directory=directory, again=again, t_end=t_end)
        (tmp_path / "script.py").write_text(text)
        arguments = [tmp_path / "script.py"] if in_file else ["-c", text]
        out, error = program(*arguments).communicate()
        assert (out, error) == (f"{t_end}\n", "")
    config = mrs.output.run_directory.read(directory)
    assert "scenario" not in config
    assert config["options"]["t_end"] == 0.2
    assert cli.main(["resume", directory, "--t-end", "1"]) == 1
    assert "made by a script; build the same simulation there" in capsys.readouterr().err
    assert mrs.info(directory)["time"] == 0.4


def test_classes_that_cannot_be_found_again():
    """Of a function, or of a module that is not a file."""

    class Local(mrs.Scenario):
        pass

    assert scenario.name_of(Local) is None
    assert scenario.name_of(type("Made", (mrs.Scenario,), {"__module__": "nowhere"})) is None
    assert scenario.name_of(scenario_files.find("cilia_array")) == "cilia_array"


# --- signals ----------------------------------------------------------------------------------

STOPS = ["SIGINT", "SIGTERM", "SIGHUP", "SIGUSR1", "SIGUSR2", "SIGXCPU"]


def begun(run, *before, **options):
    """Start a long run in a process, and wait until it has stepped for a while."""
    scene = ["--set", "t_end=1000", "--set", "checkpoint_seconds=0"]
    process = program(*before, "-m", "mrs", "run", SCENE, "--output", run, *scene, **options)
    while process.poll() is None and not (run / "checkpoint.h5").exists():
        time.sleep(0.01)
    while process.poll() is None and checkpoint.load(run / "checkpoint.h5")[1]["time"] == 0.0:
        time.sleep(0.05)
    return process


@pytest.mark.parametrize("name", STOPS)
def test_signals_stop_a_run_in_good_order(name, tmp_path):
    """Exit status, the way to go on, no traceback, files that a resumed run takes up."""
    run = tmp_path / "run"
    process = begun(run)
    process.send_signal(getattr(signal, name))
    _, error = process.communicate(timeout=60)
    assert process.returncode == 128 + getattr(signal, name), error
    assert f"stopped by {name}; go on with `mrs resume {run}`" in error
    assert "Traceback" not in error
    found = mrs.info(run)
    assert 0.0 < found["time"] < 1000.0
    assert cli.main(["resume", str(run), "--max-walltime", "0"]) == 0
    assert mrs.info(run)["time"] > found["time"]


def test_ctrl_c_again_and_again(tmp_path):
    """A hundred times within a second or so, to the last moment of the process."""
    run = tmp_path / "run"
    process = begun(run)
    for _ in range(100):
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
        time.sleep(0.01)
    process.communicate(timeout=60)
    assert process.returncode in (130, -signal.SIGINT)  # the latter while the interpreter ends
    last = frames(run)
    assert checkpoint.load(run / "checkpoint.h5")[1]["time"] >= last[-1]
    assert cli.main(["resume", str(run), "--max-walltime", "0"]) == 0
    assert frames(run)[: len(last)] == last


def frames(run):
    """Return the times of the frames of a run."""
    with Trajectory(run / "cilia.vtkhdf") as file:
        return file.times.tolist()


def dust(*trackers, **options):
    """Return tracers that are carried along, in steps of 0.1."""
    fluid = mrs.Fluid(background=mrs.flows.shear(1.0))
    body = mrs.Tracers(np.eye(3))
    euler = mrs.Integrator("euler", 0.1)
    return mrs.Simulation(fluid, [body], integrator=euler, trackers=trackers, **options)


class Interrupt(mrs.Tracker):
    """Sends signals at the second step."""

    def __init__(self, *names):
        self.names = names

    def handle(self, sim):
        if sim.stepper.steps == 2:
            for name in self.names:
                signal.raise_signal(getattr(signal, name))


@pytest.mark.parametrize("names", [("SIGINT",), ("SIGTERM", "SIGINT"), ()])
def test_no_signal_interrupts_the_last_checkpoint(names, tmp_path, monkeypatch):
    """Three come while it is written, also at the end of a run that nobody stopped."""
    save = Checkpoints._save

    def interrupted(self, sim):
        for name in ("SIGINT", "SIGINT", "SIGHUP") if sim.stepper.steps else ():
            signal.raise_signal(getattr(signal, name))
        save(self, sim)

    monkeypatch.setattr(Checkpoints, "_save", interrupted)
    sim = dust(Interrupt(*names), output=mrs.Output(tmp_path / "run", 10.0))
    with pytest.raises(KeyboardInterrupt) as stopped:
        sim.run(0.5)
    assert stopped.value.number == getattr(signal, names[0] if names else "SIGINT")
    _, values = checkpoint.load(tmp_path / "run" / "checkpoint.h5")
    assert values["integrator"]["steps"] == (2 if names else 5)
    monkeypatch.undo()
    assert mrs.restart(sim).run(1.0).stepper.steps == 10


def test_handlers_are_those_of_before():
    before = {name: signal.getsignal(getattr(signal, name)) for name in STOPS}
    with pytest.raises(KeyboardInterrupt):
        dust(Interrupt("SIGUSR1")).run(1.0)
    dust().run(1.0)
    assert cli.main(["run", "cilia_array", "--options"]) == 0
    assert {name: signal.getsignal(getattr(signal, name)) for name in STOPS} == before


def test_what_the_user_handles_or_ignores_is_left_alone(monkeypatch):
    """A handler of a program's own, and nohup."""
    seen = []
    old = signal.signal(signal.SIGUSR1, lambda *_: seen.append("USR1"))
    hang_up = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        assert dust(Interrupt("SIGUSR1", "SIGHUP")).run(0.5).stepper.steps == 5
    finally:
        signal.signal(signal.SIGUSR1, old)
        signal.signal(signal.SIGHUP, hang_up)
    assert seen == ["USR1"]


def test_several_signals_at_once_are_one_wish():
    """A terminal and a parent send the same: the second does not cut into the first's unwinding."""
    unwound = []

    def interrupted():
        try:
            signal.raise_signal(signal.SIGINT)
        finally:
            signal.raise_signal(signal.SIGINT)
            unwound.append(True)

    with pytest.raises(signals.Stopped), signals.stopping():
        interrupted()
    assert unwound == [True]


def test_a_signal_whose_exception_is_lost():
    """Python only prints what is raised in a callback of the garbage collector."""

    def lost():
        with contextlib.suppress(KeyboardInterrupt):
            signal.raise_signal(signal.SIGTERM)

    with pytest.raises(signals.Stopped, match="SIGTERM"), signals.stopping():
        lost()


def test_a_signal_before_the_first_step():
    """While trackers begin: the run is not begun then."""

    class Early(mrs.Tracker):
        when = mrs.Interval(10.0)

        def initialize(self, sim):
            signal.raise_signal(signal.SIGTERM)

    sim = dust(Early())
    with pytest.raises(signals.Stopped, match="SIGTERM"):
        sim.run(1.0)
    assert sim.stepper.steps == 0


@pytest.mark.parametrize("waits", [False, True])
def test_a_signal_waits_for_the_evaluation(waits):
    """The first one stops the step before its next evaluation; a second one, later, at once."""
    done = []

    class Slow(mrs.forces.Force):
        kind = "slow"

        def forces(self, time_, points, layout, fluid):
            signal.raise_signal(signal.SIGINT)
            if waits:
                time.sleep(1.01)
                signal.raise_signal(signal.SIGINT)
            done.append(time_)
            return np.zeros_like(points)

    body = mrs.Swimmers(np.zeros((1, 3)), np.eye(3)[:1], length=1.0, force=1.0)
    options = {"fluid": mrs.Fluid(epsilon=0.1), "bodies": [body]}
    sim = mrs.Simulation(**options, forces=[Slow()], integrator=mrs.Integrator("rk4", 0.1))
    with pytest.raises(signals.Stopped):
        sim.run(1.0)
    assert done == ([] if waits else [0.0])
    assert (sim.time, sim.stepper.steps) == (0.0, 0)


def test_frames_are_written_to_their_end(tmp_path):
    """A signal in one body's file waits for the other's; a second one, later, does not wait."""
    done = []

    class Slow(mrs.Tracker):
        when = mrs.Interval(0.1)

        def __init__(self, wait):
            self.wait = wait

        def handle(self, sim):
            signal.raise_signal(signal.SIGINT)
            if self.wait:
                signal.raise_signal(signal.SIGINT)
                time.sleep(1.01)
                signal.raise_signal(signal.SIGINT)
            done.append(sim.time)

    for wait, frames_done in ((False, [0.1]), (True, [])):
        done.clear()
        with pytest.raises(KeyboardInterrupt):
            dust(Slow(wait)).run(1.0)
        assert done == frames_done


def test_the_command_line_in_a_thread(own, tmp_path):
    """Where Python sets no signal handlers."""
    status = []
    run = ["run", f"{own}:Dust", "--output", str(tmp_path / "run")]
    thread = threading.Thread(target=lambda: status.append(cli.main(run)))
    thread.start()
    thread.join()
    assert status == [0]
