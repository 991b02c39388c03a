"""A macro that opens the trajectories of a run in ParaView the way they should look."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from mrs.output.atomic import telling
from mrs.output.trackers import Tracker
from mrs.time.interrupts import Never

if TYPE_CHECKING:
    from mrs.run.simulation import Simulation

MACRO = Path("paraview") / "open_in_paraview.py"  # in the run directory

_MACRO = '''"""Open this run. In ParaView: Tools > Python Shell > Run Script, or as a macro.

From a terminal: paraview --script=open_in_paraview.py
"""

from pathlib import Path

from paraview.simple import *

RUN = Path({directory!r})


def opened(path):
    """Return a reader of a trajectory, or of its frames where ParaView is older than 5.12."""
    lists = [path.with_suffix(".pvd"), RUN / "vtp" / (path.stem + ".pvd")]
    for file in [path, *filter(Path.exists, lists)]:
        try:
            data = OpenDataFile(str(file))
            data.UpdatePipeline()
        except RuntimeError:  # no reader for such files
            continue
        if data.GetDataInformation().GetNumberOfPoints():
            return data
        Delete(data)
    print(
        f"{{path.name}}: no points read. ParaView before 5.12 cannot read it; the command "
        f"`mrs export {{RUN}}` writes frames that it can, then run this macro again."
    )
    return None


def fields(data):
    return set(data.keys())


def color(source, view):
    """Show what comes out of a filter, coloured by speed."""
    display = Show(source, view)
    display.Representation = "Surface"
    if "velocity" in fields(source.PointData):
        ColorBy(display, ("POINTS", "velocity", "Magnitude"))
        display.RescaleTransferFunctionToDataRange(True)
        display.SetScalarBarVisibility(view, True)
    return display


def show_rods(data, view):
    tube = Tube(Input=data)
    tube.NumberofSides = 16
    if "radius" in fields(data.PointData):
        tube.Scalars = ["POINTS", "radius"]
        tube.VaryRadius = "By Absolute Scalar"
    color(tube, view)


def show_swimmers(data, view):
    glyph = Glyph(Input=data, GlyphType="Arrow")
    glyph.OrientationArray = ["POINTS", "orientation"]
    glyph.ScaleArray = ["POINTS", "No scale array"]
    glyph.GlyphMode = "All Points"
    color(glyph, view)
    Show(data, view).Representation = "Wireframe"


def show_tracers(data, view):
    display = color(data, view)
    display.Representation = "Point Gaussian"


view = GetActiveViewOrCreate("RenderView")
for path in sorted(RUN.glob("[!.]*.vtkhdf")):
    data = opened(path)
    if data is None:
        continue
    if "orientation" in fields(data.PointData):
        show_swimmers(data, view)
    elif "arclength" in fields(data.PointData):
        show_rods(data, view)
    else:
        show_tracers(data, view)
GetAnimationScene().UpdateAnimationUsingDataTimeSteps()
ResetCamera(view)
Render(view)
'''


def write_macro(directory: str | os.PathLike[str]) -> Path:
    """Write ``paraview/open_in_paraview.py`` in a run directory.

    Parameters
    ----------
    directory : path
        Of the run. The macro holds its absolute path, since ParaView copies macros elsewhere.

    Returns
    -------
    Path
        Of the macro.
    """
    directory = Path(directory)
    path = directory / MACRO
    with telling(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(_MACRO.format(directory=str(directory.resolve())), encoding="utf-8")
    return path


class Macro(Tracker):
    """Writes the macro of a run at its start.

    Parameters
    ----------
    directory : Path
        Of the run.
    """

    def __init__(self, directory: Path) -> None:
        self._directory, self.when = directory, Never()

    def initialize(self, sim: Simulation) -> None:
        write_macro(self._directory)

    def output_files(self, sim: Simulation) -> list[Path]:
        return [self._directory / MACRO]
