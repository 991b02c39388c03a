"""A run of two bodies, with live files and readers open, is killed again and again."""

import random
import subprocess
import sys
import time

import numpy as np
import pytest

import mrs
from mrs.output.vtp import read_pvd
from mrs.run import scenario_files
from tests.test_runs import assert_equal_runs, state_of, trajectories

OPTIONS = {
    "nodes": 21,
    "tracers": 40,
    "interval": 0.02,
    "formats": ["vtkhdf", "pvd"],
    "checkpoint_seconds": 0.0,
}

# The run holds its own files open for reading by h5py, as a notebook would.
RUNNER = f"""
import sys
from pathlib import Path
import h5py
import mrs
from mrs.run import scenario_files

directory = Path(sys.argv[1])


class Reader(mrs.Tracker):
    def initialize(self, sim):
        self.open = []

    def handle(self, sim):
        self.open = [h5py.File(path, "r") for path in sorted(directory.glob("[!.]*.vtkhdf"))]
        assert len(self.open) == 2
        print(sim.time, flush=True)


if (directory / "checkpoint.h5").exists():
    mrs.resume(directory, trackers=[Reader()])
else:
    scene = scenario_files.make("fibre_in_shear", {OPTIONS!r})
    sim = scene.simulation(directory)
    sim.trackers.append(Reader())
    sim.run(float(sys.argv[2]))
"""

# Holds the files open by the reader of ParaView, and says how many frames it finds. It opens them
# while nothing is written: a reader that counts the frames before one is added, and reads their
# times after it, overflows its memory (docs/files.md).
VIEWER = """
import sys
from pathlib import Path
from vtkmodules.vtkIOHDF import vtkHDFReader

held = []
for _ in sys.stdin:
    held.clear()
    for path in sorted(Path(sys.argv[1]).glob("[!.]*.vtkhdf")):
        reader = vtkHDFReader()
        reader.SetFileName(str(path))
        reader.UpdateInformation()
        reader.SetStep(reader.GetNumberOfSteps() - 1)
        reader.Update()
        assert reader.GetOutput().GetPoints().GetNumberOfPoints() in (21, 40)
        held.append(reader)
    print(*(reader.GetNumberOfSteps() for reader in held), flush=True)
"""


def killed(directory, t_end, moments):
    """Run, or go on, and kill -9 at a random moment; return the times of all steps reported."""
    command = [sys.executable, "-c", RUNNER, str(directory), str(t_end)]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen(command, **pipes) as child:
        reports = [child.stdout.readline() for _ in range(moments.randint(0, 4))]
        time.sleep(moments.uniform(0.0, 0.05))
        child.kill()
        reports += child.stdout.readlines()
        assert "Error" not in (errors := child.stderr.read()), errors
    return [float(line) for line in reports if line.endswith("\n")]


@pytest.mark.parametrize("kills", [15, pytest.param(100, marks=pytest.mark.slow)])
def test_killed_with_readers_open(tmp_path, kills):
    """Every frame up to the last checkpoint is there after each kill; the end is the same bits."""
    whole, directory = tmp_path / "whole", tmp_path / "killed"
    t_end = 0.04 * kills  # so that there is something left to be done at the last kill
    scenario_files.make("fibre_in_shear", OPTIONS).simulation(whole).run(t_end)
    expected = trajectories(whole)
    moments, reached = random.Random(kills), []
    viewer = [sys.executable, "-c", VIEWER, str(directory)]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen(viewer, **pipes) as looking:
        for _ in range(kills):
            reached += killed(directory, t_end, moments)
            if not reached:  # not even begun
                continue
            written, found = state_of(directory)[1]["written"], trajectories(directory)
            looking.stdin.write("look\n")
            looking.stdin.flush()
            steps = list(map(int, looking.stdout.readline().split()))
            for name, (times, frames), seen in zip(found, found.values(), steps, strict=True):
                assert len(times) <= seen <= len(times) + 1
                assert times[-1] >= max(written.get(name, [0.0]))
                np.testing.assert_array_equal(times, expected[name][0][: len(times)])
                np.testing.assert_equal(frames, expected[name][1][: len(times)])
        mrs.resume(directory)
        looking.communicate()
        assert looking.returncode == 0
    assert_equal_runs(whole, directory)
    for body in ("fibre", "tracers"):
        lists = [read_pvd(path / f"{body}.pvd") for path in (whole, directory)]
        assert lists[0] == lists[1]
        for _, name in lists[0]:
            assert (whole / name).read_bytes() == (directory / name).read_bytes()
    assert len(reached) > kills, "the kills did not hit a run on its way"
