"""Formats of trajectories, by the names with which `Output` asks for them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mrs.output import pvd, run_directory, vtkhdf
from mrs.output.atomic import DamagedError
from mrs.output.frame_files import BodyFile
from mrs.output.stored import fluid_meta
from mrs.output.topology import same_topology
from mrs.output.trajectory import Trajectory
from mrs.registry import Registry

if TYPE_CHECKING:
    from mrs.run.simulation import Simulation

FORMATS: Registry[type[BodyFile]] = Registry("format", "name")
_META = {
    "force": "per node, on the fluid",
    "torque": "per node, on the fluid",
    "units": "those of the input",
}


@FORMATS.register
class VtkhdfFile(BodyFile):
    """One transient VTKHDF file."""

    name = "vtkhdf"
    suffix = ".vtkhdf"

    def times(self, sim: Simulation) -> Sequence[float]:
        points = sim.scene.layout.point_count(self.body)
        with Trajectory(self.path) as found:
            kind = found.meta.get("kind")
            if kind != self.body.kind:
                raise DamagedError(
                    self.path, f"is of another scene: its body is {kind}, not {self.body.kind}"
                )
            if found.size not in (0, points):
                raise DamagedError(
                    self.path, f"is of another scene: it has {found.size} points, not {points}"
                )
            if not same_topology(found.topology, self.topology):
                raise DamagedError(
                    self.path, "is of another scene: other points are joined by lines"
                )
            return found.times.tolist()

    def cut(self, sim: Simulation) -> float | None:
        if self.path.exists():
            return vtkhdf.cut(self.path, sim.time)
        fluid = fluid_meta(sim.fluid, sim.backend.tolerance)
        meta = {"kind": self.body.kind, **run_directory.versions(), **_META, **fluid}
        precision = "float32" if sim.output is None else sim.output.precision
        arrays = sim.scene.constant_fields(self.body)
        vtkhdf.create(self.path, self.topology, *arrays, meta, precision)
        return None

    def write(self, sim: Simulation) -> None:
        vtkhdf.append(self.path, sim.time, *sim.frame(self.body))

    def finish(self) -> None:
        if self.path.exists():
            vtkhdf.trim(self.path)

    @classmethod
    def summary(cls, path: Path) -> dict[str, Any]:
        with Trajectory(path) as file:
            last = float(file.times[-1]) if len(file) else None
            return {"frames": len(file), "points": file.size, "time": last}


@FORMATS.register
class PvdFile(BodyFile):
    """A .vtp file for each frame, and a list of them."""

    name = "pvd"
    suffix = ".pvd"

    def times(self, sim: Simulation) -> Sequence[float]:
        return pvd.times(self.path, sim.scene.layout.point_count(self.body))

    def cut(self, sim: Simulation) -> float | None:
        return pvd.cut(self.path, sim.time)

    def write(self, sim: Simulation) -> None:
        points, *varying = sim.frame(self.body)
        pairs = zip(sim.scene.constant_fields(self.body), varying, strict=True)
        arrays = (constant | changing for constant, changing in pairs)
        run_directory.note(self.path.parent, pvd.next_frame(self.path))
        pvd.append(self.path, sim.time, self.topology, points, *arrays)

    @classmethod
    def summary(cls, path: Path) -> dict[str, Any]:
        return pvd.summary(path)
