"""What ParaView is given: frames that can be looked at live, and a macro that opens a run.

ParaView is no package of Python's: a module stands for it that reads by VTK, as ParaView does.
"""

import sys
import types
from pathlib import Path

import numpy as np
import pytest
import pyvista as pv

import mrs
from mrs.output import paraview, pvd
from mrs.output.export import export
from mrs.output.trajectory import Trajectory
from mrs.output.vtp import read_pvd
from tests.cases.trajectories import RODS, rods_frame


def script(directory, formats=("vtkhdf",)):
    """Run a rod, swimmers and tracers."""
    line = mrs.geometry.straight(1.0, 5)
    bodies = [
        mrs.Rods(line, bending=1.0, twisting=1.0, shearing=10.0, stretching=10.0),
        mrs.Swimmers([[2.0, 0, 0]], [[0, 0, 1.0]], length=1.0, force=1.0),
        mrs.Tracers(np.eye(3)),
    ]
    output = mrs.Output(directory, interval=0.01, formats=formats)
    mrs.Simulation(mrs.Fluid(epsilon=0.1), bodies, output=output).run(0.02)


class Reader:
    def __init__(self, mesh):
        self.mesh, self.PointData = mesh, mesh.point_data

    def UpdatePipeline(self):  # noqa: N802
        pass

    def GetDataInformation(self):  # noqa: N802
        return types.SimpleNamespace(GetNumberOfPoints=lambda: self.mesh.n_points)


class Filter(types.SimpleNamespace):
    """A tube or a glyph: what goes in comes out."""

    @property
    def PointData(self):  # noqa: N802
        return self.Input.PointData


def stand_in(reads_vtkhdf):
    """Return a stand-in for paraview.simple; with False or "empty" it is one before 5.12."""
    module = types.ModuleType("paraview.simple")
    module.opened, module.filters = [], []

    def open_data_file(name):
        path = Path(name)
        if path.suffix == ".vtkhdf" and not reads_vtkhdf:
            raise RuntimeError(f"File not readable. No reader found for '{name}' ")
        module.opened.append(path)
        if path.suffix == ".vtkhdf" and reads_vtkhdf == "empty":
            return Reader(pv.PolyData())
        mesh = pv.read(path)
        return Reader(mesh[0] if isinstance(mesh, pv.MultiBlock) else mesh)

    def make(kind):
        def filtered(**options):
            module.filters.append(Filter(kind=kind, **options))
            return module.filters[-1]

        return filtered

    module.OpenDataFile = open_data_file
    module.Tube, module.Glyph = make("tube"), make("glyph")
    module.GetActiveViewOrCreate = lambda kind: kind
    module.Show = lambda source, view: types.SimpleNamespace(
        RescaleTransferFunctionToDataRange=lambda extend: None,
        SetScalarBarVisibility=lambda view, visible: None,
    )
    module.GetAnimationScene = lambda: types.SimpleNamespace(
        UpdateAnimationUsingDataTimeSteps=lambda: None
    )
    for name in ("ColorBy", "Delete", "ResetCamera", "Render"):
        setattr(module, name, lambda *arguments: None)
    return module


def run_macro(directory, monkeypatch, reads_vtkhdf):
    module = stand_in(reads_vtkhdf)
    package = types.ModuleType("paraview")
    package.simple = module
    monkeypatch.setitem(sys.modules, "paraview", package)
    monkeypatch.setitem(sys.modules, "paraview.simple", module)
    macro = directory / "paraview" / "open_in_paraview.py"
    exec(compile(macro.read_text(), macro, "exec"), {"__name__": "__main__"})
    return module


def test_frames_to_look_at_have_all_arrays(tmp_path):
    """Constant ones as well: without the radius ParaView draws no tubes."""
    script(tmp_path, ["vtkhdf", "pvd"])
    for name in ("rods", "swimmers", "tracers"):
        files = sorted((tmp_path / name).glob("*.vtp"))
        with Trajectory(tmp_path / f"{name}.vtkhdf") as ours:
            assert len(files) == len(ours) == 3
            for i, file in enumerate(files):
                mesh = pv.read(file)
                for seen, stored in (
                    (mesh.point_data, ours.point_data(i)),
                    (mesh.cell_data, ours.cell_data(i)),
                ):
                    assert set(seen.keys()) == set(stored)
                    for key, array in stored.items():
                        np.testing.assert_allclose(seen[key], array, rtol=1e-6, atol=1e-30)
    assert {"radius", "arclength", "epsilon"} <= set(
        pv.read(tmp_path / "rods/000002.vtp").point_data
    )


@pytest.mark.parametrize("reads_vtkhdf", [True, False, "empty"])
@pytest.mark.parametrize("frames", ["written", "exported"])
def test_macro_opens_a_run(tmp_path, monkeypatch, capsys, reads_vtkhdf, frames):
    """The trajectories, or where ParaView cannot read them the frames beside."""
    script(tmp_path, ["vtkhdf", "pvd"] if frames == "written" else ["vtkhdf"])
    (tmp_path / ".rods.partial.vtkhdf").write_text("half of it")
    folder = tmp_path if frames == "written" else tmp_path / "vtp"
    if frames == "exported":
        export(tmp_path, "vtp")
    module = run_macro(tmp_path, monkeypatch, reads_vtkhdf)
    suffix = ".vtkhdf" if reads_vtkhdf is True else ".pvd"
    shown = [path for path in module.opened if path.suffix == suffix]
    place = tmp_path if reads_vtkhdf is True else folder
    assert shown == [place / f"{name}{suffix}" for name in ("rods", "swimmers", "tracers")]
    tube, glyph = module.filters
    assert tube.Scalars == ["POINTS", "radius"]
    assert glyph.OrientationArray == ["POINTS", "orientation"]
    assert capsys.readouterr().out == ""


def test_macro_says_what_to_do(tmp_path, monkeypatch, capsys):
    script(tmp_path)
    module = run_macro(tmp_path, monkeypatch, False)
    assert module.opened == module.filters == []
    said = capsys.readouterr().out
    for name in ("rods", "swimmers", "tracers"):
        assert f"{name}.vtkhdf: no points read. ParaView before 5.12 cannot" in said
    assert f"`mrs export {tmp_path}` writes frames" in said


def test_live_frames_read_back(tmp_path):
    path = tmp_path / "rods.pvd"
    assert pvd.cut(path, 1.0) is None
    for i in range(4):
        points, at_points, at_cells = rods_frame(i)
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
