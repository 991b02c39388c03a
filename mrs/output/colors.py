"""Colours of a picture: which array they show, and over which range in all frames."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mrs.output.camera import Places
from mrs.output.trajectory import Trajectory

_DEFAULT_FIELD = "velocity"
_TRANSIENT = 2.0  # times as far as three quarters of the frames reach


def colors_of(
    bodies: list[Trajectory],
    frames: list[Places],
    color_by: str | None,
    color_range: tuple[float, float] | None = None,
) -> Colors:
    """Find the range of colours of all frames.

    They span the values in all frames, but for a transient: a frame that reaches more than twice as
    far as three quarters of the frames do is left out, and the title says how far it reaches.

    Parameters
    ----------
    bodies : list of Trajectory
    frames : list of list of int
        Of each, its place in the file of each body.
    color_by : str or None
        An array at points or cells; "velocity", if there is such an array, by default.
    color_range : (low, high), optional
        In place of the range that is found. Values beyond have the colours of its ends.

    Raises
    ------
    ValueError
        If no body has the array; the message names those that there are.
    """
    field = _DEFAULT_FIELD if color_by is None else color_by
    ranges, vector = [], False
    for places in frames:
        fields = [field_at_points(body, i, field) for body, i in zip(bodies, places, strict=True)]
        known = [values for values in fields if values is not None and np.isfinite(values).any()]
        vector |= any(values.ndim == 2 for values in known)
        if known:
            values = np.concatenate([magnitude(values) for values in known])
            ranges.append((0.0 if vector else np.nanmin(values), np.nanmax(values)))
    if not ranges and color_by is not None:
        data = [d for body in bodies for d in (body.point_data(-1), body.cell_data(-1))]
        names = ", ".join(sorted({name for arrays in data for name in arrays}))
        raise ValueError(f"color_by must be one of {names}, got {color_by!r}")
    if not ranges:
        return Colors(None, (0.0, 0.0), "")
    low, high = color_range or _without_transient(np.array(ranges))
    title = field.replace("_", " ") + (" (magnitude)" if vector else "")
    beyond = max(top for _, top in ranges)
    return Colors(field, (low, high), title + (f", up to {beyond:.3g}" if beyond > high else ""))


def _without_transient(ranges: np.ndarray) -> tuple[float, float]:
    """Return the least and largest value in most frames.

    Often the first frames have by far the largest values, where loads are let go at the start, and
    would leave all others in one colour. Quantiles of all values would cut the tips of every
    frame as well.

    Parameters
    ----------
    ranges : (frames, 2) float ndarray
        Least and largest value of each.
    """
    reach = np.abs(ranges).max(axis=1)
    most = np.quantile(reach, 0.75, method="lower")
    kept = ranges[reach <= _TRANSIENT * most] if most else ranges
    return float(kept[:, 0].min()), float(kept[:, 1].max())


class Colors(NamedTuple):
    """The array that is shown by colours, and its range, alike in all frames."""

    field: str | None
    range: tuple[float, float]
    title: str


def field_at_points(body: Trajectory, i: int, name: str) -> np.ndarray | None:
    """Return an array at points; one at cells is carried to the points of each cell.

    Parameters
    ----------
    body : Trajectory
    i : int
        Place of the frame in the file of the body.
    name : str

    Returns
    -------
    (n,) or (n, k) ndarray, or None
        None if the body has no such array.
    """
    at_points, at_cells = body.point_data(i), body.cell_data(i)
    if name in at_points or name not in at_cells:
        return at_points.get(name)
    values = at_cells[name].astype(np.float64)
    result = np.full((len(body.points(i)), *values.shape[1:]), np.nan)
    vertices, lines = body.topology
    result[vertices] = values[: len(vertices)]
    for line, value in zip(lines, values[len(vertices) :], strict=True):
        result[line] = value
    return result


def magnitude(values: np.ndarray) -> np.ndarray:
    """Return numbers as they are, and the lengths of vectors, as doubles.

    Parameters
    ----------
    values : (n,) or (n, k) ndarray
    """
    values = values.astype(np.float64)  # squares of large singles are beyond their range
    return np.linalg.norm(values, axis=1) if values.ndim == 2 else values
