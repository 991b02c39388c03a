"""Exports: other programs read back what the trajectories hold."""

import meshio
import numpy as np
import pytest
import pyvista as pv

from mrs.output import export, vtkhdf
from mrs.output.trajectory import Trajectory
from tests.cases.trajectories import TRACERS, same, write_run


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
