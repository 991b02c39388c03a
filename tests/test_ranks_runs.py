"""Runs over ranks of MPI: the files of one process, stops in good order, and going on."""

import os
import signal
import subprocess
import sys
import time

import psutil
import pytest

import mrs
from tests.test_ranks import MPIRUN, ROOT, by_mpi, mpirun
from tests.test_runs import assert_equal_runs, state_of
from treecode.ranks import joint, ranks_of, world

pytestmark = by_mpi

SCENE = ["fibre_in_shear", "--quick", "--set", "interval=0.02", "--set", "checkpoint_seconds=0"]
WAYS = {
    "direct": ["--set", "backend.name=direct"],
    "kitc": [
        *("--set", "backend.name=kitc", "--set", "backend.degree=3"),
        *("--set", "backend.leaf_size=10"),
    ],
    "auto": [],
}


def begin(ranks, *arguments):
    """Start the command on some ranks; on none, without mpirun."""
    command = [sys.executable, "-m", "mrs", *map(str, arguments)]
    if ranks:
        command = [MPIRUN, "-n", str(ranks), *command]
    environment = os.environ | {"PYTHONPATH": str(ROOT), "NUMBA_NUM_THREADS": "1"}
    return subprocess.Popen(
        command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def run(ranks, *arguments, status=0):
    """Run the command to its end; return what it says."""
    process = begin(ranks, *arguments)
    out, errors = process.communicate(timeout=240)
    assert process.returncode == status, errors
    return out if status == 0 else errors


def on_its_way(process, directory):
    """Wait until a run has taken some steps; return the processes that are its ranks."""
    file = directory / "checkpoint.h5"
    started = time.monotonic()
    while not file.exists() or state_of(directory)[1]["time"] < 0.1:
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < started + 120.0
        time.sleep(0.05)
    children = psutil.Process(process.pid).children(recursive=True)
    ranks = [child for child in children if "PMI_RANK" in child.environ()]
    return sorted(ranks, key=lambda child: child.environ()["PMI_RANK"])


@pytest.mark.parametrize("way", WAYS)
def test_a_run_has_the_bits_of_one_process(way, tmp_path):
    """Trajectories, checkpoint and log; and each file and message is written once."""
    one, two = tmp_path / "one", tmp_path / "two"
    common = [*SCENE, "--set", "t_end=0.3", *WAYS[way]]
    said = run(0, "run", *common, "--output", one)
    assert run(2, "run", *common, "--output", two).replace("two", "one") == said
    assert_equal_runs(one, two)
    assert sorted(path.name for path in one.iterdir()) == sorted(
        path.name for path in two.iterdir()
    )


@pytest.mark.parametrize("how", ["SIGINT to all", "SIGTERM to one", "kill -9 of one"])
def test_a_run_goes_on_with_other_ranks(how, tmp_path):
    """After a stop in good order, and after the loss of a rank, which ends the others."""
    whole, directory = tmp_path / "whole", tmp_path / "killed"
    common = [*SCENE, *WAYS["kitc"], "--set", "t_end=1"]
    run(0, "run", *common, "--output", whole)
    process = begin(3, "run", *common, "--output", directory)
    ranks = on_its_way(process, directory)
    assert len(ranks) == 3
    if how == "SIGINT to all":
        process.send_signal(signal.SIGINT)
    else:
        ranks[1].send_signal(signal.SIGTERM if "TERM" in how else signal.SIGKILL)
    started = time.monotonic()
    _, errors = process.communicate(timeout=60)
    assert time.monotonic() < started + 10.0
    assert process.returncode != 0
    assert psutil.wait_procs(ranks, timeout=5.0)[1] == []
    if "9" not in how:
        name = how.split()[0]
        assert errors.count(f"stopped by {name}; go on with `mrs resume {directory}`") == 1
    assert 0.0 < state_of(directory)[1]["time"] < 1.0
    run(2, "resume", directory, "--max-walltime", "0")
    run(0, "resume", directory)
    assert_equal_runs(whole, directory)


def test_a_refusal_is_said_once(tmp_path):
    """By rank 0, of its own; and the status is that of one process."""
    run(0, "run", *SCENE, "--set", "t_end=0.05", "--output", tmp_path / "run")
    said = run(2, "run", *SCENE, "--output", tmp_path / "run", status=1)
    assert said.count("holds a run; go on with it") == 1
    assert said.count("mrs:") == 1
    assert "usage:" in run(2, "run", status=2)
    assert run(2, "info", tmp_path / "run").count("fibre_in_shear") == 1


def test_where_no_launcher_is_mpi_is_not_imported(tmp_path):
    program = """
import sys
from mrs.run import cli
assert cli.main(["check", "rod_relaxation"]) == 0
assert "mpi4py" not in sys.modules
"""
    subprocess.run([sys.executable, "-c", program], check=True, cwd=ROOT, stdout=subprocess.DEVNULL)


@pytest.mark.parametrize(
    "environment",
    [{}, {"SLURM_NTASKS": "8"}, {"PMI_RANK": "0", "PMI_SIZE": "1"}],
    ids=["no launcher", "in a job", "one rank"],
)
def test_one_process_alone(environment, monkeypatch):
    """Within a job, too, the command may be started without a launcher, or on one rank."""
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    assert world() is None


def test_several_ranks_need_mpi4py(monkeypatch):
    """Otherwise each of them would do all of the work."""
    monkeypatch.setenv("PMI_RANK", "0")
    monkeypatch.setitem(sys.modules, "mpi4py", None)
    with pytest.raises(ImportError, match="pip install mpi4py"):
        world()


SCRIPT = """
import mrs
from pathlib import Path
directory = Path(sys.argv[0]).parent / "run"
noted = []


class Watch(mrs.Tracker):
    def handle(self, sim):
        far = sim.velocity(np.full((2, 3), 5.0))
        noted.append((sim.now.motion.shape, far.tobytes(), sim.energy()))
        if len(noted) == 3 and WRONG:
            raise RuntimeError("the third step")


rod = mrs.Rods(mrs.geometry.helix(0.2, 0.5, 2.0, nodes=31), bending=1.0, twisting=1.0,
    shearing=50.0, stretching=50.0, beat=mrs.TravellingWave((0.5, 0.0, 0.0), 1.0, 1.0))
sim = mrs.Simulation(mrs.Fluid(epsilon=0.1), [rod], trackers=[Watch()], comm=comm,
    output=mrs.Output(directory, interval=0.001))
sim.run(0.005)
assert len(noted) == (sim.stepper.steps if comm.rank == 0 else 0)
comm.Barrier()
mrs.restart(sim).run(0.006)
assert len(set(comm.allgather(sim.state.positions.tobytes()))) == 1
show("done")
"""


def test_trackers_are_called_by_rank_0_and_may_ask_for_sums(tmp_path):
    assert mpirun(3, f"WRONG = False\n{SCRIPT}", tmp_path) == "done\n"


def test_an_error_of_a_tracker_ends_all(tmp_path):
    """In good order: with a checkpoint of the last step."""
    said = mpirun(2, f"WRONG = True\n{SCRIPT}", tmp_path, passes=False)
    assert said.count("RuntimeError: the third step") == 1
    assert state_of(tmp_path / "run")[1]["integrator"]["steps"] == 3


class Helper:
    """Something that ranks share."""

    def __init__(self, comm):
        self.ranks, self.calls = ranks_of(comm), []

    @joint
    def add(self, number):
        self.calls.append(number)
        if number < 0:
            raise ValueError("number must be positive")
        return sum(self.ranks.exchange(number))


def test_rank_0_leads(on_ranks):
    """What it calls is called by all; its errors are those of all, unless it catches them."""

    def led(comm):
        helper = Helper(comm)

        def action():
            with pytest.raises(ValueError, match="positive"):
                helper.add(-1)
            return helper.add(1) + helper.add(2)

        def failing():
            raise OSError("the disk is full")

        result = helper.ranks.lead(helper, action)
        with pytest.raises(OSError, match="the disk is full"):
            helper.ranks.lead(helper, failing)
        return result, helper.calls, helper.add(5)

    assert on_ranks(3, led) == [(9, [-1, 1, 2, 5], 15)] * 3


def test_one_process_leads_itself():
    helper = Helper(None)
    assert helper.ranks.lead(helper, lambda: helper.add(4)) == 4


def test_a_simulation_checks_its_communicator():
    swimmers = mrs.Swimmers([[0.0, 0.0, 0.0]], [[0.0, 0.0, 1.0]], length=1.0, force=1.0)
    with pytest.raises(TypeError, match="comm must be a communicator of mpi4py"):
        mrs.Simulation(mrs.Fluid(epsilon=0.1), [swimmers], comm=1)
