"""Files of a run: VTK reads what was written, and no moment to be killed at loses a frame."""

import csv
import os
import subprocess
import sys
import time
from pathlib import Path

import h5py
import meshio
import numpy as np
import pytest
import pyvista as pv
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkIOHDF import vtkHDFReader

from mrs.output import checkpoint, export, log, paraview, pvd, vtkhdf
from mrs.output.vtkhdf import Topology, Trajectory
from mrs.output.vtp import read_pvd

MRS = Path(checkpoint.__file__).parents[1]

# A child has mrs.output without the rest of mrs, which takes a second to import.
PRELUDE = f"""
import sys, types
mrs = types.ModuleType("mrs")
mrs.__path__ = [{str(MRS)!r}]
sys.modules["mrs"] = mrs
import numpy as np
"""

RODS = Topology(np.empty(0, int), [np.array([0, 1, 2, 3, 0]), np.arange(4, 9), np.arange(9, 12)])
SWIMMERS = Topology(np.arange(6), [np.array([i, i + 3]) for i in range(3)])
TRACERS = Topology(np.arange(5), [])


def rods_frame(i):
    """Arrays that vary, at points, at cells and of the frame."""
    rng = np.random.default_rng(i)
    at_points = {"velocity": rng.standard_normal((12, 3)), "tension": rng.random(12)}
    return rng.random((12, 3)), at_points, {"bending_energy": rng.random(3)}, {"energy": i / 3}


def write_rods(path, frames, start=0):
    if not path.exists():
        constant = {"radius": np.linspace(0.1, 0.2, 12)}, {"rod_id": np.arange(3)}
        vtkhdf.create(path, RODS, *constant, {"kind": "rods", "epsilon": 0.1, "tags": ["a", "b"]})
    for i in range(start, frames):
        vtkhdf.append(path, 0.1 * i, *rods_frame(i))


def write_run(directory, frames=3):
    """Write one body of each kind."""
    write_rods(directory / "rods.vtkhdf", frames)
    radius = {"radius": np.full(6, 0.1)}
    vtkhdf.create(directory / "swimmers.vtkhdf", SWIMMERS, radius, {}, {"kind": "swimmers"})
    vtkhdf.create(directory / "tracers.vtkhdf", TRACERS, meta={"kind": "tracers"})
    for i in range(frames):
        rng = np.random.default_rng(i)
        arrays = {"orientation": rng.random((6, 3)), "velocity": rng.random((6, 3))}
        energy = {"energy": rng.random(9)}
        vtkhdf.append(directory / "swimmers.vtkhdf", 0.1 * i, rng.random((6, 3)), arrays, energy)
        vtkhdf.append(directory / "tracers.vtkhdf", 0.1 * i, rng.random((5, 3)))


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


def same(left, right):
    assert set(left) == set(right)
    for name, array in left.items():
        np.testing.assert_array_equal(array, right[name], err_msg=name)


@pytest.mark.parametrize("frames", [1, 2, 16, 17, 40])
def test_vtk_reads_what_was_written(tmp_path, frames):
    path = tmp_path / "rods.vtkhdf"
    write_rods(path, frames)
    for _ in range(2):  # with room for more frames, and without
        vtk = Vtk(path)
        assert vtk.steps == frames
        for i in range(frames):
            points, at_points, at_cells, numbers = rods_frame(i)
            at_points["radius"] = np.linspace(0.1, 0.2, 12)
            mesh = vtk.frame(i)
            seen = vtk_to_numpy(mesh.GetPoints().GetData())
            np.testing.assert_array_equal(seen, points)
            expected = {name: a.astype(np.float32) for name, a in at_points.items()}
            same(arrays_of(mesh.GetPointData()), expected)
            energy = at_cells["bending_energy"].astype(np.float32)
            expected = {"bending_energy": energy, "rod_id": np.arange(3)}
            same(arrays_of(mesh.GetCellData()), expected)
            numbers = arrays_of(mesh.GetFieldData())
            assert numbers["energy"] == i / 3
            assert frames == 1 or numbers["Time"] == 0.1 * i
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
        assert rods.field_data(0) == {"energy": 0.0}
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


POINTS, AT_POINTS, AT_CELLS, NUMBERS = rods_frame(2)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((0.1, POINTS, AT_POINTS, AT_CELLS, NUMBERS), "later"),
        ((np.nan, POINTS, AT_POINTS, AT_CELLS, NUMBERS), "later"),
        ((0.2, POINTS[:, :2], AT_POINTS, AT_CELLS, NUMBERS), "points"),
        ((0.2, POINTS[:5], {}, AT_CELLS, NUMBERS), "missing: .*tension.*velocity"),
        ((0.2, POINTS, AT_POINTS, {}, NUMBERS), "missing: .*bending_energy"),
        ((0.2, POINTS, AT_POINTS, AT_CELLS), "missing: .*energy"),
        ((0.2, POINTS, AT_POINTS | {"new": POINTS}, AT_CELLS, NUMBERS), "unknown: .*new"),
        ((0.2, POINTS, AT_POINTS | {"tension": POINTS}, AT_CELLS, NUMBERS), "tension"),
        ((0.2, POINTS, AT_POINTS | {"tension": np.arange(12)}, AT_CELLS, NUMBERS), "tension"),
        ((0.2, POINTS, AT_POINTS | {"tension": np.ones(11)}, AT_CELLS, NUMBERS), "tension"),
        ((0.2, POINTS, AT_POINTS | {"a.b": np.ones(12)}, AT_CELLS, NUMBERS), "a.b"),
        ((0.2, POINTS, AT_POINTS | {"a/b": np.ones(12)}, AT_CELLS, NUMBERS), "a/b"),
        ((0.2, POINTS, AT_POINTS | {"tension": ["x"] * 12}, AT_CELLS, NUMBERS), "tension"),
        ((0.2, POINTS, AT_POINTS | {"radius": np.ones(12)}, AT_CELLS, NUMBERS), "radius"),
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
            points, at_points, at_cells, numbers = rods_frame(i)
            assert rods.times[k] == 0.1 * i
            np.testing.assert_array_equal(rods.points(k), points)
            same(arrays_of(vtk.frame(k).GetPointData()), rods.point_data(k))
            for arrays, stored in ((at_points, rods.point_data(k)), (at_cells, rods.cell_data(k))):
                for name, array in arrays.items():
                    np.testing.assert_array_equal(stored[name], array.astype(np.float32))
            assert rods.field_data(k) == numbers


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
path = sys.argv[1]
with vtkhdf.Trajectory(path) as t:
    start = len(t)
pattern = np.arange(30_000.0).reshape(-1, 3) / 1024
for i in range(start, 100_000):
    vtkhdf.append(path, i, pattern + i, {"velocity": pattern - i, "number": pattern[:, 0] * i})
    print(i + 1, flush=True)
"""


def kill_at_random(program, path, rng):
    """Run a program that reports what it has done, kill it, and return its last report."""
    command = [sys.executable, "-c", PRELUDE + program, str(path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as child:
        reports = [child.stdout.readline() for _ in range(rng.integers(1, 6))]
        time.sleep(rng.random() * 0.03)
        child.kill()
        reports += child.stdout.readlines()
    whole = [line for line in reports if line.endswith("\n")]
    return int(whole[-1])


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


STATE = {
    "time": np.array(0.1),
    "positions": np.random.default_rng(0).standard_normal((50, 3)),
    "integrator/vector": np.array([1e-320, np.inf, -0.0]),
    "integrator/steps": np.array([3, 4]),
    "none": np.empty((0, 3)),
}


def test_checkpoint_is_exact(tmp_path):
    path = tmp_path / "checkpoint.h5"
    random = np.random.Generator(np.random.Philox(3))
    random.random(5)
    attributes = {
        "random": random.bit_generator.state,
        "pcg": np.random.default_rng(2**100).bit_generator.state,
        "integrator": {"h": 0.1, "step": np.int64(3), "name": "rkc", "none": None, "list": [1]},
        "config": "x" * 100_000,
    }
    checkpoint.save(path, STATE, attributes)
    arrays, loaded = checkpoint.load(path)
    assert set(arrays) == set(STATE)
    for name, array in STATE.items():
        assert (arrays[name].dtype, arrays[name].shape) == (array.dtype, array.shape)
        assert arrays[name].tobytes() == array.tobytes()
    assert loaded["integrator"] == attributes["integrator"]
    assert loaded["pcg"] == attributes["pcg"]
    again = np.random.Generator(np.random.Philox())
    again.bit_generator.state = loaded["random"]
    assert again.random() == random.random()


def damaged(path, how):
    content = bytearray(path.read_bytes())
    where = content.find(STATE["positions"].tobytes()[:64])
    if how == "bit":
        content[where + 5] ^= 1
    path.write_bytes({"bit": content, "half": content[:where], "empty": b""}[how])
    if how == "missing":
        path.unlink()


@pytest.mark.parametrize("how", ["bit", "half", "empty"])
def test_checkpoint_falls_back(tmp_path, how):
    path = tmp_path / "checkpoint.h5"
    for step in range(3):
        checkpoint.save(path, STATE, {"step": step})
    damaged(path, how)
    with pytest.warns(UserWarning, match="damaged"):
        assert checkpoint.load(path)[1] == {"step": 1}
    checkpoint.save(path, STATE, {"step": 3})
    damaged(path, how)
    with pytest.warns(UserWarning, match="damaged"):  # the damaged one did not replace step 1
        assert checkpoint.load(path)[1] == {"step": 1}
    damaged(path.with_name("checkpoint.previous.h5"), how)
    with pytest.raises(ValueError, match="no intact checkpoint"):
        checkpoint.load(path)


def test_checkpoint_missing(tmp_path):
    path = tmp_path / "checkpoint.h5"
    with pytest.raises(FileNotFoundError, match="no checkpoint"):
        checkpoint.load(path)
    checkpoint.save(path, STATE, {"step": 0})
    checkpoint.save(path, STATE, {"step": 1})
    path.unlink()
    with pytest.warns(UserWarning, match="missing"):
        assert checkpoint.load(path)[1] == {"step": 0}


def test_checkpoint_that_cannot_be_written_leaves_the_last(tmp_path):
    path = tmp_path / "checkpoint.h5"
    checkpoint.save(path, STATE, {"step": 0})
    with pytest.raises(TypeError, match="object"):
        checkpoint.save(path, STATE, {"step": object()})
    with pytest.raises(TypeError):
        checkpoint.save(path, {"bad": np.array([object()])}, {})
    assert checkpoint.load(path)[1] == {"step": 0}
    assert [p.name for p in tmp_path.iterdir()] == ["checkpoint.h5"]


SAVER = """
from mrs.output import checkpoint
for i in range(int(sys.argv[2]), 100_000):
    checkpoint.save(sys.argv[1], {"a/b": np.full(100_000, float(i))}, {"step": i})
    print(i, flush=True)
"""


@pytest.mark.filterwarnings("ignore:.*is missing")  # killed between two renamings
def test_killed_while_saving(tmp_path):
    path = tmp_path / "checkpoint.h5"
    rng = np.random.default_rng(1)
    program = SAVER.replace("int(sys.argv[2])", "0")
    for _ in range(10):
        done = kill_at_random(program, path, rng)
        arrays, attributes = checkpoint.load(path)
        assert attributes["step"] in (done - 1, done, done + 1)
        np.testing.assert_array_equal(arrays["a/b"], np.full(100_000, attributes["step"]))


def test_log(tmp_path):
    path = tmp_path / "log.csv"
    assert log.cut(path, 1.0) is None
    assert log.last(path) == {}
    times = [0.1 * i for i in range(5)]
    for i, t in enumerate(times):
        log.append(path, {"step": i, "t": t, "note": "a,b" if i else ""})
    with path.open() as file:
        rows = list(csv.DictReader(file))
    assert [float(row["t"]) for row in rows] == times
    assert log.last(path) == {"step": 4, "t": 0.4, "note": "a,b"}
    with pytest.raises(ValueError, match="columns"):
        log.append(path, {"step": 5})
    with path.open("a") as file:
        file.write("5,0.5")  # killed while writing
    assert log.last(path)["step"] == 4
    assert log.cut(path, times[3]) == times[3]
    log.append(path, {"step": 4, "t": 0.45, "note": ""})
    assert path.read_text().splitlines()[-2:] == [f'3,{times[3]!r},"a,b"', "4,0.45,"]
    assert path.read_text().count("step") == 1
    assert log.cut(path, -1.0) is None


def test_log_with_half_a_header(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("step,t")
    assert log.cut(path, 1.0) is None
    log.append(path, {"step": 0, "t": 0.0})
    assert path.read_text() == "step,t\n0,0.0\n"


def test_live(tmp_path):
    path = tmp_path / "rods.pvd"
    assert pvd.cut(path, 1.0) is None
    for i in range(4):
        points, at_points, at_cells, _ = rods_frame(i)
        pvd.append(path, 0.1 * i, RODS, points, at_points, at_cells)
    reader = pv.get_reader(path)
    assert reader.time_values == [0.1 * i for i in range(4)]
    reader.set_active_time_point(3)
    mesh = reader.read()[0]
    np.testing.assert_array_equal(mesh.points, rods_frame(3)[0])
    np.testing.assert_array_equal(mesh["velocity"], rods_frame(3)[1]["velocity"])
    np.testing.assert_array_equal(mesh["bending_energy"], rods_frame(3)[2]["bending_energy"])
    assert mesh.n_lines == 3
    assert pvd.cut(path, 0.15) == 0.1
    assert sorted(p.name for p in (tmp_path / "rods").iterdir()) == ["000000.vtp", "000001.vtp"]
    pvd.append(path, 0.2, RODS, rods_frame(2)[0])
    times = [time for time, _ in read_pvd(path)]
    assert times == [0.0, 0.1, 0.2]


def test_macro_compiles(tmp_path):
    path = paraview.write_macro(tmp_path)
    assert path == tmp_path / "paraview" / "open_in_paraview.py"
    source = path.read_text()
    compile(source, path, "exec")
    assert repr(str(tmp_path)) in source


def segments(topology):
    lines = [np.stack([n[:-1], n[1:]], axis=1) for n in topology.lines]
    return np.concatenate(lines) if lines else topology.vertices[:, None]


def reader_of(suffix):
    """Return the program that the format is for, where that is a package."""
    return meshio.read if suffix == "med" else pv.read


@pytest.mark.parametrize("suffix", export.FORMATS)
def test_exports_read_back(tmp_path, suffix):
    write_run(tmp_path)
    files = export.export(tmp_path, suffix, frames=[0, -1])
    frames = [path for path in files if path.suffix != ".pvd"]
    assert [p.name for p in frames] == [
        f"{body}_00000{i}.{suffix}" for body in ("rods", "swimmers", "tracers") for i in (0, 2)
    ]
    assert set(files) == set((tmp_path / suffix).iterdir())
    for path in frames:
        name, i = path.stem.split("_")
        mesh = reader_of(suffix)(path)
        with Trajectory(tmp_path / f"{name}.vtkhdf") as ours:
            np.testing.assert_array_equal(mesh.points, ours.points(int(i)))
            at_points, at_cells = ours.point_data(int(i)), ours.cell_data(int(i))
            topology = ours.topology
        same({k: np.squeeze(v) for k, v in mesh.point_data.items()}, at_points)
        if suffix == "vtp":
            same(dict(mesh.cell_data), at_cells)
            assert mesh.n_lines == len(topology.lines)
            continue
        cells = (
            mesh.cells[0].data if suffix == "med" else mesh.cells.reshape(mesh.n_cells, -1)[:, 1:]
        )
        np.testing.assert_array_equal(cells, segments(topology))
        for key, array in at_cells.items():
            seen = np.squeeze(mesh.cell_data[key])
            lines = array[len(topology.vertices) :] if topology.lines else array
            assert set(seen) == set(lines)
    if suffix in ("vtp", "vtu"):
        assert pv.get_reader(tmp_path / suffix / "rods.pvd").time_values == [0.0, 0.2]
    if suffix == "xdmf":
        assert pv.get_reader(files[1]).time_values == [0.2]


def test_truth_values_are_exported(tmp_path):
    """They are stored as bytes, which meshio's xdmf does not know."""
    vtkhdf.create(tmp_path / "a.vtkhdf", TRACERS, {"wet": np.arange(5) > 2})
    vtkhdf.append(tmp_path / "a.vtkhdf", 0.0, np.zeros((5, 3)))
    (file,) = export.export(tmp_path, "xdmf")
    np.testing.assert_array_equal(pv.read(file)["wet"], [0, 0, 0, 1, 1])


def test_a_second_export_leaves_no_frames_of_the_first(tmp_path):
    write_run(tmp_path)
    export.export(tmp_path, "vtu")
    foreign = [tmp_path / "vtu" / name for name in ("mine_000007.vtu", "rods_1.vtu", "notes.txt")]
    for path in foreign:
        path.write_text("mine")
    second = export.export(tmp_path, "vtu", frames=[1])
    assert set((tmp_path / "vtu").iterdir()) == {*second, *foreign}


def test_an_export_that_is_interrupted_leaves_no_broken_file(tmp_path, monkeypatch):
    def interrupted(mesh, path):
        path.write_text("half of it")
        raise KeyboardInterrupt

    write_run(tmp_path, frames=1)
    monkeypatch.setattr(meshio.Mesh, "write", interrupted)
    with pytest.raises(KeyboardInterrupt):
        export.export(tmp_path, "vtu")
    assert list((tmp_path / "vtu").iterdir()) == []


def test_export_repeats_data_of_a_line_on_its_segments(tmp_path):
    write_run(tmp_path, frames=1)
    export.export(tmp_path, ".vtu", tmp_path / "there")
    rods = meshio.read(tmp_path / "there" / "rods_000000.vtu")
    np.testing.assert_array_equal(rods.cell_data["rod_id"][0], [0] * 4 + [1] * 4 + [2] * 2)
    swimmers = meshio.read(tmp_path / "there" / "swimmers_000000.vtu")
    with Trajectory(tmp_path / "swimmers.vtkhdf") as ours:
        expected = ours.cell_data(0)["energy"][6:]  # those of the lines, after six vertices
    np.testing.assert_array_equal(swimmers.cell_data["energy"][0], expected)


def test_export_refuses(tmp_path):
    with pytest.raises(FileNotFoundError, match="no trajectories"):
        export.export(tmp_path, "vtp")
    write_run(tmp_path, frames=1)
    with pytest.raises(ValueError, match=r"vtp, vtu, xdmf.*got 'obj'"):
        export.export(tmp_path, "obj")
    with pytest.raises(IndexError, match=r"frame: .* has 1 frames, none number 1"):
        export.export(tmp_path, "vtp", frames=[1])
