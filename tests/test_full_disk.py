"""A disk that fills up while a run is written: a clear end, nothing lost, on when it is free."""

import ctypes
import os
import resource
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from mrs.output import log, vtkhdf
from mrs.output.atomic import WriteError
from mrs.output.topology import Topology
from mrs.output.trajectory import Trajectory
from mrs.run import cli
from tests.test_runs import assert_equal_runs

ARGUMENTS = ["run", "fibre_in_shear"]
for option in ("nodes=21", "tracers=40", "t_end=0.6", "interval=0.02", 'formats=["vtkhdf","pvd"]'):
    ARGUMENTS += ["--set", option]
ARGUMENTS += ["--set", "checkpoint_seconds=0"]
FREE = 60 * 1024, 740 * 1024  # bytes, least and most; the whole run takes more


def run(*arguments, limit=None):
    """Run the command line in a process of its own, where no file may be longer than `limit`."""

    def limited():
        if limit is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

    command = [sys.executable, "-m", "mrs", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, preexec_fn=limited)


def assert_ended_well(done, directory):
    """The end is an error that names a file of the run and the remedy; no crash, no traceback."""
    assert done.returncode == 1, done.stderr
    assert "Traceback" not in done.stderr
    errors = [line for line in done.stderr.splitlines() if line.startswith("mrs: ")]
    assert len(errors) == 1
    assert str(directory) in errors[0]
    assert "free some space, then `mrs resume`" in errors[0]
    assert not list(directory.rglob(".*.partial.*"))


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The run that no full disk has stopped."""
    directory = tmp_path_factory.mktemp("whole") / "run"
    assert cli.main([*ARGUMENTS, "--output", str(directory)]) == 0
    return directory


@pytest.mark.parametrize("limit", [20_000, 45_000])
def test_files_that_may_not_grow(tmp_path, whole, limit):
    """The limit of a process stands for the disk; other files are written on until then."""
    directory = tmp_path / "run"
    done = run(*ARGUMENTS, "--output", directory, limit=limit)
    assert_ended_well(done, directory)
    assert run("resume", directory).returncode == 0
    assert_equal_runs(whole, directory)


@pytest.fixture
def disk(tmp_path):
    """A small disk of its own."""
    libc = ctypes.CDLL(None, use_errno=True)
    place = tmp_path / "disk"
    place.mkdir()
    if libc.mount(b"none", bytes(place), b"tmpfs", 0, b"size=4m"):
        pytest.skip(f"no file system can be mounted here: {os.strerror(ctypes.get_errno())}")
    yield place
    libc.umount2(bytes(place), 2)


@pytest.mark.parametrize("times", [3, pytest.param(100, marks=pytest.mark.slow)])
def test_disk_that_fills_and_is_freed(disk, whole, times):
    """Whatever it is that finds no room: a trajectory, a live frame, the log or a checkpoint."""
    stopped = set()
    for i, free in enumerate(np.linspace(*FREE, times)):
        directory, filler = disk / f"run{i}", disk / "filler"
        left = os.statvfs(disk)
        filler.write_bytes(b"x" * (left.f_bavail * left.f_frsize - int(free)))
        done = run(*ARGUMENTS, "--output", directory)
        assert_ended_well(done, directory)
        stopped.add(done.stderr.split("mrs: ")[1].split(" could not")[0].rpartition("/")[2])
        filler.unlink()
        assert run("resume", directory).returncode == 0
        assert_equal_runs(whole, directory)
        shutil.rmtree(directory)
    if times == 100:
        assert len(stopped) > 2, f"only {stopped} found no room"


LIMITED = """
import resource, sys
import numpy as np
from mrs.output import checkpoint, vtkhdf
path, frames = sys.argv[1], 0
resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))
try:
    while True:
        vtkhdf.append(path, frames, np.full((100, 3), frames), {"v": np.zeros((100, 3))})
        frames += 1
except OSError as error:
    print(frames, error)
"""


def test_every_frame_before_the_full_disk_is_kept(tmp_path):
    path = tmp_path / "rods.vtkhdf"
    vtkhdf.create(path, Topology(np.arange(100), []))
    command = [sys.executable, "-c", LIMITED, str(path)]
    out = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    frames, message = out.split(" ", 1)
    assert int(frames) >= 16
    assert str(path) in message
    with Trajectory(path) as rods:
        assert len(rods) == int(frames)
        for i in range(len(rods)):
            np.testing.assert_array_equal(rods.points(i), np.full((100, 3), i))
    vtkhdf.append(path, int(frames), np.zeros((100, 3)), {"v": np.zeros((100, 3))})


def test_a_full_disk_is_named(tmp_path):
    """On the system's own device that is always full."""
    if not Path("/dev/full").exists():
        pytest.skip("the system has no /dev/full")
    path = tmp_path / "log.csv"
    path.symlink_to("/dev/full")
    with pytest.raises(WriteError, match=f"{path}.*free some space"):
        log.append(path, {"t": 0.0})
