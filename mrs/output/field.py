"""Velocity of the fluid on a grid around the bodies, and streamlines through it."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from mrs.output.atomic import replacing

if TYPE_CHECKING:
    import pyvista as pv

Velocity = Callable[[np.ndarray], np.ndarray]


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


def grid_around(
    points: ArrayLike,
    *,
    spacing: float | None = None,
    resolution: int = 40,
    padding: float = 0.2,
) -> Grid:
    """Return a grid around points, centred on their box.

    Parameters
    ----------
    points : (n, 3) array_like
    spacing : float, optional
        Distance of neighbours in the grid; by default from `resolution`.
    resolution : int, optional
        Number of grid points along the longest side, at least 2.
    padding : float, optional
        Room on each side, in lengths of the longest side of the box of the points.

    Raises
    ------
    ValueError
        If there are no points, they coincide and no spacing is given, or an argument is out of
        its range.
    """
    points = np.asarray(points, np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or not len(points):
        raise ValueError(f"points must have shape (n, 3) with n > 0, got {points.shape}")
    if resolution < 2 or padding < 0 or (spacing is not None and not spacing > 0):
        raise ValueError(
            "resolution must be at least 2, padding not negative and spacing positive, "
            f"got {resolution}, {padding} and {spacing}"
        )
    low, high = points.min(axis=0), points.max(axis=0)
    size = high - low + 2 * padding * (high - low).max()
    if spacing is None:
        spacing = float(size.max()) / (resolution - 1)
        if spacing == 0:
            raise ValueError("points must not coincide, unless spacing is given")
    nx, ny, nz = (int(np.ceil(side / spacing * (1 - 1e-12))) + 1 for side in size)
    corner = (low + high - spacing * (np.array([nx, ny, nz]) - 1)) / 2
    return Grid(corner, float(spacing), (nx, ny, nz))


def write_field(
    path: str | os.PathLike[str],
    grid: Grid,
    velocity: ArrayLike | Velocity,
    **extra: ArrayLike,
) -> None:
    """Write velocity, and what else there is, on a grid to a .vti file.

    Parameters
    ----------
    path : path
        Ends in .vti.
    grid : Grid
    velocity : (n, 3) array_like or callable
        At ``grid.points``, or what returns it for (n, 3) points.
    **extra : (n,) or (n, k) array_like
        Other arrays at the same points.

    Raises
    ------
    ValueError
        If an array has not a row for each point of the grid.
    """
    image = _image(grid, velocity)
    for name, values in extra.items():
        image.point_data[name] = np.asarray(values)
    with replacing(Path(path)) as temporary:
        image.save(temporary)


def streamlines(
    path: str | os.PathLike[str],
    grid: Grid,
    velocity: ArrayLike | Velocity,
    seeds: ArrayLike,
    max_length: float | None = None,
) -> None:
    """Write streamlines through seeds, both ways, to a .vtp file; speed is among their arrays.

    Parameters
    ----------
    path : path
        Ends in .vtp.
    grid : Grid
        They end where it ends.
    velocity : (n, 3) array_like or callable
        As for `write_field`; interpolated between grid points.
    seeds : (m, 3) array_like
    max_length : float, optional
        Of a line either way; four times the longest side of the grid by default.
    """
    import pyvista as pv

    image = _image(grid, velocity)
    longest = grid.spacing * (max(grid.dimensions) - 1)
    lines = image.streamlines_from_source(
        pv.PolyData(np.array(seeds, np.float64)),
        vectors="velocity",
        integration_direction="both",
        max_length=4 * longest if max_length is None else max_length,
        max_steps=10_000,
        terminal_speed=0.0,
    )
    lines.point_data["speed"] = np.linalg.norm(lines.point_data["velocity"], axis=1)
    with replacing(Path(path)) as temporary:
        lines.save(temporary)


def _image(grid: Grid, velocity: ArrayLike | Velocity) -> pv.ImageData:
    import pyvista as pv

    values = np.asarray(velocity(grid.points) if callable(velocity) else velocity)
    count = int(np.prod(grid.dimensions))
    if values.shape != (count, 3):
        raise ValueError(f"velocity must have shape ({count}, 3), got {values.shape}")
    image = pv.ImageData(
        dimensions=grid.dimensions, spacing=(grid.spacing,) * 3, origin=tuple(grid.origin)
    )
    image.point_data["velocity"] = values
    return image
