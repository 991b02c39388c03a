"""Frames as pyvista sees them, and lists of files with their times."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree

import numpy as np
from numpy.typing import ArrayLike

from mrs.output.atomic import DamagedError, replacing
from mrs.output.topology import Topology

if TYPE_CHECKING:
    import pyvista as pv


def polydata(
    topology: Topology,
    points: ArrayLike,
    point_data: Mapping[str, ArrayLike] | None = None,
    cell_data: Mapping[str, ArrayLike] | None = None,
) -> pv.PolyData:
    """Return a frame as VTK's PolyData.

    Parameters
    ----------
    topology : Topology
    points : (n, 3) array_like
    point_data : dict of (n,) or (n, k) array_like, optional
    cell_data : dict of (cells,) or (cells, k) array_like, optional
    """
    import pyvista as pv

    mesh = pv.PolyData()
    mesh.points = np.array(points)
    mesh.verts = _cells([[point] for point in topology.vertices])
    mesh.lines = _cells(topology.lines)
    for data, arrays in ((mesh.point_data, point_data), (mesh.cell_data, cell_data)):
        for name, values in (arrays or {}).items():
            data[name] = np.asarray(values)
    return mesh


def write_xml(path: Path, data: pv.DataSet) -> None:
    """Write a .vtp or .vti file, or another of VTK's formats in XML.

    VTK makes the text and Python writes it: VTK's own writing ends in a crash on a full disk.

    Parameters
    ----------
    path : Path
    data : pyvista.DataSet
    """
    from vtkmodules.vtkIOXML import vtkXMLDataObjectWriter

    writer = vtkXMLDataObjectWriter.NewWriter(data.GetDataObjectType())
    writer.SetInputData(data)
    writer.SetDataModeToBinary()
    writer.WriteToOutputStringOn()
    writer.Write()
    with replacing(path) as temporary:
        temporary.write_text(writer.GetOutputString(), encoding="utf-8")


def write_pvd(path: Path, files: Sequence[tuple[float, str]]) -> None:
    """Write a list of files and their times, for ParaView.

    Parameters
    ----------
    path : Path
    files : list of (float, str)
        Time, and name relative to the folder of `path`.
    """
    root = ElementTree.Element("VTKFile", type="Collection", version="0.1")
    collection = ElementTree.SubElement(root, "Collection")
    for time, name in files:
        ElementTree.SubElement(collection, "DataSet", timestep=repr(float(time)), file=name)
    ElementTree.indent(root)
    with replacing(path) as temporary:
        ElementTree.ElementTree(root).write(temporary, encoding="utf-8", xml_declaration=True)


def read_pvd(path: Path) -> list[tuple[float, str]]:
    """Return times and names in such a list; none if there is no file.

    Parameters
    ----------
    path : Path

    Raises
    ------
    DamagedError
        If it is cut short, or no such list.
    """
    if not path.exists():
        return []
    try:
        entries = ElementTree.parse(path).iter("DataSet")
        return [(float(entry.attrib["timestep"]), entry.attrib["file"]) for entry in entries]
    except (ElementTree.ParseError, KeyError, ValueError) as error:
        reason = f"is cut short, damaged or no .pvd file ({error})"
        raise DamagedError(path, reason) from None


def _cells(cells: Sequence[ArrayLike]) -> np.ndarray:
    """Return cells as VTK has them: the number of points, then the points."""
    parts = [np.append(len(np.asarray(cell)), cell) for cell in cells]
    return np.concatenate([np.empty(0, np.int64), *parts]).astype(np.int64)
