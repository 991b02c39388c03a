"""Which points of a body are drawn, and which are joined by lines."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class Topology(NamedTuple):
    """Which points are drawn as such, and which are joined by lines.

    Cells are numbered vertices first, then lines.

    Attributes
    ----------
    vertices : (V,) int ndarray
        Points that are a cell each.
    lines : list of int ndarray
        The points along each line. A closed line ends at its first point.
    """

    vertices: np.ndarray
    lines: list[np.ndarray]

    @property
    def cells(self) -> int:
        """Number of vertices and lines."""
        return len(self.vertices) + len(self.lines)


def same_topology(one: Topology, other: Topology) -> bool:
    """Return whether the same points are drawn, and joined, in both.

    Parameters
    ----------
    one, other : Topology
    """
    return (
        np.array_equal(one.vertices, other.vertices)
        and len(one.lines) == len(other.lines)
        and all(map(np.array_equal, one.lines, other.lines))
    )
