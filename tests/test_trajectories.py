"""Trajectories: VTK reads what was written, and no moment to be killed at loses a frame."""

import os
import subprocess
import sys

import h5py
import numpy as np
import pytest
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkIOHDF import vtkHDFReader

from mrs.output import vtkhdf
from mrs.output.topology import Topology
from mrs.output.trajectory import Trajectory
from tests.cases.killed import PRELUDE, kill_at_random
from tests.cases.trajectories import RODS, TRACERS, rods_frame, same, write_rods, write_run


class Vtk:
    """VTK's own reader."""

    def __init__(self, path):
        self.reader = vtkHDFReader()
        self.reader.SetFileName(str(path))
        self.reader.UpdateInformation()
        self.steps = self.reader.GetNumberOfSteps()

    def frame(self, i):
        self.reader.SetStep(i)
        self.reader.Update()
        return self.reader.GetOutput()


def arrays_of(data):
    arrays = [data.GetArray(k) for k in range(data.GetNumberOfArrays())]
    return {array.GetName(): vtk_to_numpy(array) for array in arrays}


@pytest.mark.parametrize("frames", [1, 2, 16, 17, 40])
def test_vtk_reads_what_was_written(tmp_path, frames):
    path = tmp_path / "rods.vtkhdf"
    write_rods(path, frames)
    for _ in range(2):  # with room for more frames, and without
        vtk = Vtk(path)
        assert vtk.steps == frames
        for i in range(frames):
            points, at_points, at_cells = rods_frame(i)
            at_points["radius"] = np.linspace(0.1, 0.2, 12)
            mesh = vtk.frame(i)
            seen = vtk_to_numpy(mesh.GetPoints().GetData())
            np.testing.assert_array_equal(seen, points)
            expected = {name: a.astype(np.float32) for name, a in at_points.items()}
            same(arrays_of(mesh.GetPointData()), expected)
            energy = at_cells["bending_energy"].astype(np.float32)
            expected = {"bending_energy": energy, "rod_id": np.arange(3)}
            same(arrays_of(mesh.GetCellData()), expected)
            assert frames == 1 or arrays_of(mesh.GetFieldData())["Time"] == 0.1 * i
            lines = mesh.GetLines()
            seen = vtk_to_numpy(lines.GetConnectivityArray())
            np.testing.assert_array_equal(seen, np.concatenate(RODS.lines))
            np.testing.assert_array_equal(vtk_to_numpy(lines.GetOffsetsArray()), [0, 5, 10, 13])
        vtkhdf.trim(path)


@pytest.mark.parametrize("name", ["rods", "swimmers", "tracers"])
def test_our_reader_agrees_with_vtk(tmp_path, name):
    write_run(tmp_path)
    vtk = Vtk(tmp_path / f"{name}.vtkhdf")
    with Trajectory(tmp_path / f"{name}.vtkhdf") as ours:
        assert len(ours) == vtk.steps == 3
        assert ours.meta["kind"] == name
        np.testing.assert_array_equal(ours.times, [0.0, 0.1, 0.2])
        for i in range(3):
            mesh = vtk.frame(i)
            seen = vtk_to_numpy(mesh.GetPoints().GetData())
            np.testing.assert_array_equal(seen, ours.points(i))
            same(arrays_of(mesh.GetPointData()), ours.point_data(i))
            same(arrays_of(mesh.GetCellData()), ours.cell_data(i))
            assert mesh.GetNumberOfVerts() == len(ours.topology.vertices)
            assert mesh.GetNumberOfLines() == len(ours.topology.lines)
        np.testing.assert_array_equal(ours.points(-1), ours.points(2))
        with pytest.raises(IndexError, match="3 frames"):
            ours.points(3)


def test_meta_and_topology_come_back(tmp_path):
    write_rods(tmp_path / "rods.vtkhdf", 1)
    with Trajectory(tmp_path / "rods.vtkhdf") as rods:
        assert rods.meta == {"kind": "rods", "epsilon": 0.1, "tags": ["a", "b"]}
        assert rods.topology.cells == 3
        for ours, line in zip(rods.topology.lines, RODS.lines, strict=True):
            np.testing.assert_array_equal(ours, line)


def test_a_long_configuration_fits(tmp_path):
    vtkhdf.create(tmp_path / "a.vtkhdf", TRACERS, meta={"config": "x" * 1_000_000})
    vtkhdf.append(tmp_path / "a.vtkhdf", 0.0, np.zeros((5, 3)))
    with Trajectory(tmp_path / "a.vtkhdf") as a:
        assert len(a.meta["config"]) == 1_000_000


def test_no_frames_yet(tmp_path):
    path = tmp_path / "rods.vtkhdf"
    write_rods(path, 0)
    assert vtkhdf.cut(path, 1.0) is None
    vtkhdf.trim(path)
    with Trajectory(path) as rods:
        assert len(rods) == 0
    with pytest.raises(FileExistsError, match="rods"):
        vtkhdf.create(path, RODS)


def test_not_a_trajectory(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w"):
        pass
    with pytest.raises(ValueError, match="not a trajectory"):
        Trajectory(tmp_path / "a.h5")
    with pytest.raises(FileNotFoundError):
        Trajectory(tmp_path / "b.h5")


POINTS, AT_POINTS, AT_CELLS = rods_frame(2)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((0.1, POINTS, AT_POINTS, AT_CELLS), "later"),
        ((np.nan, POINTS, AT_POINTS, AT_CELLS), "later"),
        ((0.2, POINTS[:, :2], AT_POINTS, AT_CELLS), "points"),
        ((0.2, POINTS[:5], {}, AT_CELLS), "missing: .*tension.*velocity"),
        ((0.2, POINTS, AT_POINTS, {}), "missing: .*bending_energy"),
        ((0.2, POINTS, AT_POINTS | {"new": POINTS}, AT_CELLS), "unknown: .*new"),
        ((0.2, POINTS, AT_POINTS | {"tension": POINTS}, AT_CELLS), "tension"),
        ((0.2, POINTS, AT_POINTS | {"tension": np.arange(12)}, AT_CELLS), "tension"),
        ((0.2, POINTS, AT_POINTS | {"tension": np.ones(11)}, AT_CELLS), "tension"),
        ((0.2, POINTS, AT_POINTS | {"a.b": np.ones(12)}, AT_CELLS), "a.b"),
        ((0.2, POINTS, AT_POINTS | {"a/b": np.ones(12)}, AT_CELLS), "a/b"),
        ((0.2, POINTS, AT_POINTS | {"tension": ["x"] * 12}, AT_CELLS), "tension"),
        ((0.2, POINTS, AT_POINTS | {"radius": np.ones(12)}, AT_CELLS), "radius"),
    ],
)
def test_a_frame_unlike_the_first_is_refused(tmp_path, arguments, message):
    path = tmp_path / "rods.vtkhdf"
    write_rods(path, 2)
    before = path.read_bytes()
    with pytest.raises((ValueError, TypeError), match=message):
        vtkhdf.append(path, *arguments)
    assert path.read_bytes() == before


@pytest.mark.parametrize(
    ("points", "at_points", "message"),
    [(11, {}, "radius"), (12, {"radius": np.ones(12)}, "constant.*radius"), (3, {}, "radius")],
)
def test_a_first_frame_that_does_not_fit_is_refused(tmp_path, points, at_points, message):
    write_rods(tmp_path / "rods.vtkhdf", 0)
    with pytest.raises(ValueError, match=message):
        vtkhdf.append(tmp_path / "rods.vtkhdf", 0.0, np.zeros((points, 3)), at_points)


def test_topology_beyond_the_points_is_refused(tmp_path):
    vtkhdf.create(tmp_path / "rods.vtkhdf", RODS)
    with pytest.raises(ValueError, match="11"):
        vtkhdf.append(tmp_path / "rods.vtkhdf", 0.0, np.zeros((11, 3)))


@pytest.mark.parametrize("frames", [5, 16])  # the next is written in place; into a longer copy
@pytest.mark.parametrize("fails", ["write", "sync", "mark"])
def test_a_frame_that_fails_is_not_seen(tmp_path, monkeypatch, frames, fails):
    path = tmp_path / "rods.vtkhdf"
    write_rods(path, frames)

    def disk_full(*_, **__):
        raise OSError("disk full")

    target = {
        "write": (h5py.Dataset, "__setitem__"),
        "sync": (os, "fsync"),
        "mark": (h5py.AttributeManager, "modify"),
    }
    with monkeypatch.context() as patch:
        patch.setattr(*target[fails], disk_full)
        with pytest.raises(OSError, match="disk full"):
            vtkhdf.append(path, 0.1 * frames, *rods_frame(frames))
    assert [p.name for p in tmp_path.iterdir()] == ["rods.vtkhdf"]
    assert Vtk(path).steps == frames
    write_rods(path, frames + 1, start=frames)
    assert_frames(path, range(frames + 1))


def assert_frames(path, expected):
    """The file holds these frames of `rods_frame` and no others, for us and for VTK."""
    vtk = Vtk(path)
    with Trajectory(path) as rods:
        assert len(rods) == vtk.steps == len(expected)
        for k, i in enumerate(expected):
            points, at_points, at_cells = rods_frame(i)
            assert rods.times[k] == 0.1 * i
            np.testing.assert_array_equal(rods.points(k), points)
            same(arrays_of(vtk.frame(k).GetPointData()), rods.point_data(k))
            for arrays, stored in ((at_points, rods.point_data(k)), (at_cells, rods.cell_data(k))):
                for name, array in arrays.items():
                    np.testing.assert_array_equal(stored[name], array.astype(np.float32))


@pytest.mark.parametrize("left", [0, 1, 7, 16, 20])
def test_cut_and_go_on(tmp_path, left):
    """No time twice and none missing, wherever the run goes on from."""
    path = tmp_path / "rods.vtkhdf"
    write_rods(path, 20)
    last = 0.1 * (left - 1)
    assert vtkhdf.cut(path, last + 0.05) == (last if left else None)
    if left:
        assert_frames(path, range(left))
    write_rods(path, 25, start=left)
    assert_frames(path, range(25))
    vtkhdf.cut(path, 0.1 * 3)  # exactly at a frame: it stays
    vtkhdf.trim(path)
    assert_frames(path, range(4))
    write_rods(path, 6, start=4)
    assert_frames(path, range(6))


def test_file_size_is_that_of_the_frames(tmp_path):
    path = tmp_path / "tracers.vtkhdf"
    vtkhdf.create(path, Topology(np.empty(0, int), []))
    for i in range(20):
        vtkhdf.append(path, i, np.zeros((5000, 3)), {"velocity": np.zeros((5000, 3))})
    vtkhdf.trim(path)
    assert path.stat().st_size < 20 * 5000 * (3 * 8 + 3 * 4) + 30_000


APPENDER = """
from mrs.output import vtkhdf
from mrs.output.trajectory import Trajectory
path = sys.argv[1]
with Trajectory(path) as t:
    start = len(t)
pattern = np.arange(30_000.0).reshape(-1, 3) / 1024
for i in range(start, 100_000):
    vtkhdf.append(path, i, pattern + i, {"velocity": pattern - i, "number": pattern[:, 0] * i})
    print(i + 1, flush=True)
"""


def test_killed_while_appending(tmp_path):
    """Every frame whose append has returned is there, at once and for VTK as well."""
    path = tmp_path / "rods.vtkhdf"
    vtkhdf.create(path, Topology(np.empty(0, int), [np.arange(10_000)]), {}, {}, {"kind": "rods"})
    pattern = np.arange(30_000.0).reshape(-1, 3) / 1024
    rng = np.random.default_rng(0)
    for _ in range(20):
        done = kill_at_random(APPENDER, path, rng)
        vtk = Vtk(path)
        with Trajectory(path) as rods:
            assert done <= len(rods) <= done + 1
            assert len(rods) <= vtk.steps <= done + 1
            np.testing.assert_array_equal(rods.times, np.arange(len(rods)))
            for i in range(len(rods)):
                np.testing.assert_array_equal(rods.points(i), pattern + i)
                expected = (pattern - i).astype(np.float32)
                np.testing.assert_array_equal(rods.point_data(i)["velocity"], expected)
            last = vtk.frame(vtk.steps - 1)
            seen = vtk_to_numpy(last.GetPoints().GetData())
            np.testing.assert_array_equal(seen, pattern + vtk.steps - 1)
        del vtk  # older ones keep the file open, and a second reader sees what the first one saw
        vtkhdf.cut(path, np.inf)  # as on resume: our count becomes VTK's
        with Trajectory(path) as rods:
            assert Vtk(path).steps == len(rods)


HOLDER = """
import h5py
from vtkmodules.vtkIOHDF import vtkHDFReader
path = sys.argv[1]
def vtk():
    reader = vtkHDFReader()
    reader.SetFileName(path)
    reader.UpdateInformation()
    reader.SetStep(reader.GetNumberOfSteps() - 1)
    reader.Update()
    return reader
held = h5py.File(path, "r"), vtk()
print("holding", flush=True)
sys.stdin.readline()
print(held[0]["VTKHDF/Points"][:12].sum(), held[1].GetNumberOfSteps(), vtk().GetNumberOfSteps())
"""


def test_appending_while_others_read(tmp_path):
    path = tmp_path / "rods.vtkhdf"
    write_rods(path, 3)
    command = [sys.executable, "-c", PRELUDE + HOLDER, str(path)]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen(command, **pipes) as child:
        assert child.stdout.readline() == "holding\n"
        write_rods(path, 40, start=3)
        total, held, fresh = child.communicate("go\n")[0].split()
    assert float(total) == pytest.approx(rods_frame(0)[0].sum(), rel=1e-6)
    assert (held, fresh) == ("3", "40")
    assert_frames(path, range(40))
