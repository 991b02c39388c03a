"""From where a run is seen: all frames of it, and the wall under it, fit into the pictures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from mrs.fluid import Periodic, Wall
from mrs.fluid.mobility import Boundary
from mrs.output.trajectory import Trajectory

_VIEW = np.array([0.5, -1.0, 0.45])  # from where one looks at the scene
ANGLE = 30.0  # degrees that the camera sees, up
TIP = 2.6  # radii from the centre of a swimmer's head to the tip of its arrow
_MARGIN = 0.06  # of the picture, free on each side
_FOOT = 0.12  # of the picture, free for the bar of colours
_FAR = 5.0  # lengths of the scene to a wall that is not drawn: bodies would be small beside it
_EDGE = 0.15  # of the scene's longest side, by which the wall goes on beyond the bodies
_SAMPLE = 1_000_000  # points that the picture is fitted to, at most
Camera = Sequence[Any]
Places = list[int]  # of one frame in the file of each body


class Stage(NamedTuple):
    """Where the bodies stand, alike in all frames.

    All places are measured from the centre of the scene, in lengths of its longest side: singles,
    which graphics computes with, serve any unit of length, and any distance from the origin.
    """

    center: np.ndarray
    extent: float
    camera: Camera
    foot: float  # of the picture, free for the bar
    size: tuple[int, int]
    floor: np.ndarray | None  # corners of the piece of wall under the bodies, (4, 3)


def stage_of(
    bodies: list[Trajectory],
    frames: list[Places],
    camera: Camera | None,
    size: tuple[int, int],
    boundaries: Sequence[Boundary | None],
) -> Stage:
    """Return the stage; without a camera given, all frames fit into the picture above the bar.

    Parameters
    ----------
    bodies : list of Trajectory
    frames : list of list of int
        Of each frame, its place in the file of each body.
    camera : (position, focal point, up) or None
        Three numbers each.
    size : (width, height)
        In pixels.
    boundaries : sequence of Boundary or None
        Of each frame; a wall is left out if it is far away.
    """
    points, reach = _points(bodies, frames), _reach(bodies)
    points = np.concatenate([points, *map(cell_corners, boundaries)])
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    extent = float(np.ptp(points, axis=0).max()) or reach or 1.0
    scene = (points - middle) / extent
    floor, boundary = None, boundaries[0]
    if isinstance(boundary, Wall):
        floor = _floor(scene, (boundary.point - middle) / extent, boundary.frame)
    if camera is not None:
        *places, up = np.asarray(camera, np.float64)
        view = [*((place - middle) / extent for place in places), up]
        return Stage(middle, extent, view, 0.0, size, floor)
    towards = _VIEW / np.linalg.norm(_VIEW)
    slope = np.tan(np.radians(ANGLE / 2)) * (1 - _MARGIN)
    slopes = np.array([slope * size[0] / size[1], slope * (1 - _FOOT)])
    seen = scene if floor is None else np.concatenate([scene, floor])
    center, distance = _fit(seen, towards, slopes, reach / extent)
    view = [center + distance * towards, center, (0, 0, 1)]
    return Stage(middle, extent, view, _FOOT, size, floor)


def _floor(scene: np.ndarray, origin: np.ndarray, frame: np.ndarray) -> np.ndarray | None:
    """Return the corners of the piece of wall under the bodies, (4, 3); None if it is far away.

    They go round the normal.

    Parameters
    ----------
    scene : (n, 3) float ndarray
        Points of the bodies, in lengths of the scene.
    origin : (3,) float ndarray
        A point of the wall.
    frame : (3, 3) float ndarray
        Rows, of which the last is the wall's normal.
    """
    *plane, height = ((scene - origin) @ frame.T).T
    if height.min() > _FAR:
        return None
    (west, east), (south, north) = ((x.min() - _EDGE, x.max() + _EDGE) for x in plane)
    corners = np.array([[west, south], [east, south], [east, north], [west, north]])
    return origin + corners @ frame[:2]


def cell_corners(boundary: Boundary | None) -> np.ndarray:
    """Return the corners of the cell of a periodic box, (8, 3), of a slab, (4, 3), or none, (0, 3).

    Bit d of the number of a corner says whether it is away from the first one along vector d.

    Parameters
    ----------
    boundary : Boundary, optional
    """
    if not isinstance(boundary, Periodic):
        return np.empty((0, 3))
    count = len(boundary.vectors)
    away = np.arange(2**count)[:, None] >> np.arange(count) & 1
    return np.asarray(away @ boundary.vectors)


def _points(bodies: list[Trajectory], frames: list[Places]) -> np.ndarray:
    """Return points of all frames, (n, 3): all of them, or a fair sample if there are many."""
    pairs = [pair for places in frames for pair in zip(bodies, places, strict=True)]
    total = len(frames) * sum(len(body.points(i)) for body, i in pairs[: len(bodies)])
    every = 1 + total // _SAMPLE
    return np.concatenate([body.points(i)[::every] for body, i in pairs]).astype(np.float64)


def _reach(bodies: list[Trajectory]) -> float:
    """Return how far bodies reach beyond their points; the tips of arrows are the longest."""
    radii = [body.point_data(-1).get("radius", np.zeros(1)) for body in bodies]
    return TIP * max(float(radius.max(initial=0.0)) for radius in radii)


def _fit(
    points: np.ndarray, towards: np.ndarray, slopes: np.ndarray, reach: float
) -> tuple[np.ndarray, float]:
    """Return focal point and distance from which the points just fill a picture.

    Parameters
    ----------
    points : (n, 3) float ndarray
    towards : (3,) float ndarray
        Unit vector towards the camera.
    slopes : (2,) float ndarray
        Of the sides of the picture, across and up.
    reach : float
        Room to leave around every point.
    """
    right = np.cross((0, 0, 1), towards)
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(towards, right)])
    center, distance = (points.min(axis=0) + points.max(axis=0)) / 2, 1.0
    for _ in range(5):  # moving the center changes which points are near, and so at the rim
        depth, seen = (points - center) @ towards, (points - center) @ axes.T
        distance = np.max(depth[:, None] + reach + (np.abs(seen) + reach) / slopes) or 1.0
        rim = seen / np.maximum(distance - depth, 1e-6 * distance)[:, None]
        center = center + distance * (rim.min(axis=0) + rim.max(axis=0)) / 2 @ axes
    return center, float(distance)
