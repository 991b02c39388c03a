"""Arrays of the fluid on a grid or along a line, and streamlines."""

from __future__ import annotations

import csv
import os
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from mrs.output.atomic import replacing
from mrs.output.vtp import write_xml

if TYPE_CHECKING:
    import pyvista as pv

AXES = ("x", "y", "z")
_ROOM = 0.2  # on each side of the box of the points, in lengths of its longest side


class Grid(NamedTuple):
    """A regular grid.

    Attributes
    ----------
    origin : (3,) float ndarray
        Its lowest corner.
    spacing : float
        Distance of neighbours.
    dimensions : tuple of three int
        Points along x, y and z.
    """

    origin: np.ndarray
    spacing: float
    dimensions: tuple[int, int, int]

    @property
    def points(self) -> np.ndarray:
        """All points, (n, 3), x fastest as in VTK."""
        z, y, x = np.meshgrid(*map(np.arange, self.dimensions[::-1]), indexing="ij")
        return self.origin + self.spacing * np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1)


def grid_around(points: ArrayLike, resolution: int, plane: tuple[str, float] | None = None) -> Grid:
    """Return a grid around points, centred on their box, with room on each side of it.

    Parameters
    ----------
    points : (n, 3) array_like
    resolution : int
        Number of grid points along the longest side of the box, at least 2.
    plane : (axis, place), optional
        In place of the whole grid one plane, such as ("z", 0.5).

    Raises
    ------
    ValueError
        If there are no points, if they coincide, or if the resolution is less than 2.
    """
    points = np.asarray(points, np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or not len(points):
        raise ValueError(f"points must have shape (n, 3) with n > 0, got {points.shape}")
    low, high = points.min(axis=0), points.max(axis=0)
    room = _ROOM * (high - low).max()
    if room == 0:
        raise ValueError("points must not coincide")
    return grid_over(low - room, high + room, resolution, plane)


def grid_over(
    low: np.ndarray, high: np.ndarray, resolution: int, plane: tuple[str, float] | None = None
) -> Grid:
    """Return a grid over a box, which may be flat, centred on it.

    Along the longest side it is the box. Along others it may reach up to a spacing further.

    Parameters
    ----------
    low, high : (3,) float ndarray
        Corners of the box.
    resolution : int
        Number of grid points along the longest side, at least 2.
    plane : (axis, place), optional
        In place of the whole grid one plane, such as ("z", 0.5).

    Raises
    ------
    ValueError
        If the resolution is less than 2.
    """
    if resolution < 2:
        raise ValueError(f"resolution must be at least 2, got {resolution}")
    size = high - low
    spacing = float(size.max()) / (resolution - 1)
    counts = np.ceil(size / spacing * (1 - 1e-12)).astype(int) + 1
    corner = (low + high - spacing * (counts - 1)) / 2
    if plane is not None:
        axis = AXES.index(plane[0])
        counts[axis], corner[axis] = 1, plane[1]
    nx, ny, nz = counts.tolist()
    return Grid(corner, spacing, (nx, ny, nz))


def seeds_in(points: ArrayLike, count: int) -> np.ndarray:
    """Return points spread evenly over the box of other points, (m, 3), none on its faces.

    Parameters
    ----------
    points : (n, 3) array_like
    count : int
        Seeds along the longest side of the box.
    """
    points = np.asarray(points, np.float64)
    low, size = points.min(axis=0), np.ptp(points, axis=0)
    shares = size / (size.max() or 1.0)
    counts = np.maximum(1, np.ceil(count * shares * (1 - 1e-12))).astype(int)
    places = [(np.arange(n) + 0.5) / n for n in counts]
    return low + size * np.stack(np.meshgrid(*places, indexing="ij"), axis=-1).reshape(-1, 3)


def write_grid(
    path: str | os.PathLike[str],
    grid: Grid,
    arrays: Mapping[str, ArrayLike],
    numbers: Mapping[str, float] | None = None,
) -> None:
    """Write arrays on a grid to a .vti file.

    Parameters
    ----------
    path : path
        Ends in .vti.
    grid : Grid
    arrays : dict of (n,) or (n, k) array_like
        At ``grid.points``.
    numbers : dict of float, optional
        Numbers of the whole grid, such as the time: VTK's field data.

    Raises
    ------
    ValueError
        If an array has not a row for each point of the grid.
    """
    import pyvista as pv

    image = pv.ImageData(
        dimensions=grid.dimensions, spacing=(grid.spacing,) * 3, origin=tuple(grid.origin)
    )
    for name, values in arrays.items():
        image.point_data[name] = _rows(name, values, grid)
    for name, number in (numbers or {}).items():
        image.field_data[name] = [float(number)]
    write_xml(Path(path), image)


def write_line(
    path: str | os.PathLike[str], points: np.ndarray, arrays: Mapping[str, np.ndarray]
) -> None:
    """Write arrays along a line to a .csv file: distance, x, y, z, and a column a component.

    Parameters
    ----------
    path : path
    points : (n, 3) float ndarray
        Distances are those from the first.
    arrays : dict of (n,) or (n, 3) float ndarray
    """
    columns = {"distance": np.linalg.norm(points - points[0], axis=1)}
    columns |= dict(zip(AXES, points.T, strict=True))
    for name, values in arrays.items():
        if values.ndim == 1:
            columns[name] = values
        else:
            columns |= {f"{name}_{axis}": v for axis, v in zip(AXES, values.T, strict=True)}
    with replacing(Path(path)) as temporary, temporary.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows(np.column_stack(list(columns.values())).tolist())


def streamlines(
    path: str | os.PathLike[str], grid: Grid, velocity: ArrayLike, seeds: ArrayLike
) -> None:
    """Write streamlines through seeds, both ways, to a .vtp file.

    Their arrays are the velocity, the speed, and VTK's IntegrationTime from the seed. A line ends
    where the grid ends, where the fluid is at rest, or after four times the longest side.

    Parameters
    ----------
    path : path
        Ends in .vtp.
    grid : Grid
    velocity : (n, 3) array_like
        At ``grid.points``; interpolated between them.
    seeds : (m, 3) array_like

    Raises
    ------
    ValueError
        If the velocity has not a row for each point of the grid.

    Warns
    -----
    UserWarning
        If there are no lines, and why.
    """
    import pyvista as pv

    velocity = _rows("velocity", velocity, grid)
    fastest = float(np.linalg.norm(velocity, axis=1).max()) or 1.0
    places = (np.asarray(seeds, np.float64) - grid.origin) / grid.spacing
    lines = _traced(grid.dimensions, velocity / fastest, places)
    if lines.n_lines:
        lines.points = grid.origin + grid.spacing * lines.points.astype(np.float64)
        data = lines.point_data
        data["velocity"] = fastest * data["velocity"]
        data["speed"] = np.linalg.norm(data["velocity"], axis=1)
        data["IntegrationTime"] = grid.spacing / fastest * data["IntegrationTime"]
    else:
        lines = pv.PolyData()
        reason = "they leave the grid at once" if velocity.any() else "the fluid is at rest"
        warnings.warn(f"no streamlines through {len(places)} seeds: {reason}", stacklevel=2)
    write_xml(Path(path), lines)


def _traced(
    dimensions: tuple[int, int, int], velocity: np.ndarray, seeds: np.ndarray
) -> pv.PolyData:
    """Return streamlines on a grid of spacing 1, of velocities of which the largest is 1.

    VTK bounds steps and the error of a line by lengths: in these units all grids are alike.
    """
    import pyvista as pv

    image = pv.ImageData(dimensions=dimensions)
    image.point_data["velocity"] = velocity
    return image.streamlines_from_source(
        pv.PolyData(seeds),
        vectors="velocity",
        integration_direction="both",
        max_length=4.0 * (max(dimensions) - 1),
        step_unit="l",
        initial_step_length=0.05,
        min_step_length=1e-3,
        max_step_length=0.5,  # a step that would leave the grid ends the line before it
        max_steps=10_000,
        max_error=1e-6,
        terminal_speed=0.0,
        compute_vorticity=False,
    )


def _rows(name: str, values: ArrayLike, grid: Grid) -> np.ndarray:
    """Return an array with a row for each point of a grid."""
    array = np.asarray(values)
    count = int(np.prod(grid.dimensions))
    if array.shape[:1] != (count,):
        raise ValueError(f"{name} must have a row for each of {count} points, got {array.shape}")
    return array
