"""Points on surfaces and along lines, at which rigid bodies are in touch with the fluid."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
import scipy
from numpy.typing import ArrayLike

from mrs import check
from mrs.bodies import geometry

# The errors of drag and torque of a sphere have this blob size as their best, in spacings.
_SPACING = 0.4
_DENSE = 0.3  # nodes along a thin body, in blob sizes apart
_GOLDEN = np.pi * (3.0 - np.sqrt(5.0))
_FINE = 4001  # heights at which the area of a surface is tabulated


class Surface(NamedTuple):
    """Points of a body, and the blob size that suits their spacing.

    Attributes
    ----------
    points : (p, 3) ndarray
    epsilon : float or (p,) ndarray
    lines : tuple of int ndarray
        Points that are joined in pictures, along each line; the others are drawn as spheres.

    Examples
    --------
    >>> import mrs
    >>> ball = mrs.surfaces.sphere(radius=1.0, count=100).moved((0.0, 0.0, 3.0))
    >>> print(ball.points.mean(axis=0).round(3) + 0.0, round(ball.epsilon, 4))
    [0. 0. 3.] 0.1418
    """

    points: np.ndarray
    epsilon: float | np.ndarray
    lines: tuple[np.ndarray, ...] = ()

    def moved(
        self,
        shift: ArrayLike = (0.0, 0.0, 0.0),
        rotation: scipy.spatial.transform.Rotation | None = None,
    ) -> Surface:
        """Return a copy, turned about the origin by `rotation` (scipy's), then shifted."""
        turn = geometry.one_rotation(rotation)
        return self._replace(points=turn.apply(self.points) + check.vector("shift", shift))


@check.spelling
def sphere(radius: float, count: int) -> Surface:
    """Return points on a sphere about the origin, on a spiral of equal areas (Fibonacci's).

    Parameters
    ----------
    radius : float
    count : int
        Of points. The resistance is too large by 0.7 % with 200, by 0.3 % with 800.

    Examples
    --------
    >>> import mrs
    >>> import numpy as np
    >>> ball = mrs.surfaces.sphere(radius=2.0, count=200)
    >>> print(np.linalg.norm(ball.points, axis=1).round(6).max())
    2.0
    >>> drag = mrs.resistance(mrs.Rigid(ball), mrs.Fluid())[0, 0]
    >>> print(round(drag / (6.0 * np.pi * 2.0), 3))  # of Stokes's
    1.007
    """
    return ellipsoid((radius, radius, radius), count)


@check.spelling
def ellipsoid(semi_axes: ArrayLike, count: int) -> Surface:
    """Return points on an ellipsoid about the origin.

    Parameters
    ----------
    semi_axes : (3,) array_like
        Along x, y and z. Areas are equal about each point if those along x and y are equal.
    count : int
        Of points.

    Examples
    --------
    >>> import mrs
    >>> cell = mrs.surfaces.ellipsoid((0.5, 0.5, 1.0), count=100)
    >>> x, y, z = cell.points.T
    >>> print(((x / 0.5) ** 2 + (y / 0.5) ** 2 + z**2).round(4).max())
    1.0
    """
    a, b, c = check.within("semi_axes", check.vector("semi_axes", semi_axes), 0.0).tolist()
    mean = np.sqrt(a * b)

    def profile(height: np.ndarray) -> np.ndarray:
        return mean * np.sqrt(np.maximum(1.0 - (height / c) ** 2, 0.0))

    round_one = revolution(profile, (-c, c), count)
    return round_one._replace(points=round_one.points * [a / mean, b / mean, 1.0])


@check.spelling
def capsule(radius: float, length: float, count: int) -> Surface:
    """Return points on a cylinder along z with round ends, about the origin.

    Parameters
    ----------
    radius : float
    length : float
        From tip to tip, at least twice the radius.
    count : int
        Of points.

    Examples
    --------
    >>> import mrs
    >>> import numpy as np
    >>> rod = mrs.surfaces.capsule(radius=0.5, length=3.0, count=200)
    >>> print(np.hypot(rod.points[:, 0], rod.points[:, 1]).max().round(6))
    0.5
    """
    check.positive("radius", radius)
    check.number("length", length, 2.0 * radius, 1e60, low_inclusive=True)

    def profile(height: np.ndarray) -> np.ndarray:
        beyond = np.maximum(np.abs(height) - (0.5 * length - radius), 0.0)
        return np.sqrt(np.maximum(radius**2 - beyond**2, 0.0))

    return revolution(profile, (-0.5 * length, 0.5 * length), count)


@check.spelling
def revolution(
    profile: Callable[[np.ndarray], np.ndarray], heights: tuple[float, float], count: int
) -> Surface:
    """Return points on a surface of revolution about z, each with the same area about it.

    Parameters
    ----------
    profile : callable
        Of heights z, (n,): returns the radii there, (n,).
    heights : (float, float)
        Where the surface begins and ends.
    count : int
        Of points.

    Examples
    --------
    >>> import mrs
    >>> cone = mrs.surfaces.revolution(lambda z: 0.5 * z, heights=(0.0, 2.0), count=400)
    >>> low = cone.points[:, 2] < 1.0  # a quarter of the area
    >>> print(low.mean())
    0.25
    """
    check.integer("count", count, 1)
    low, high = check.vector("heights", (*heights, 0.0))[:2]
    if not low < high:
        raise ValueError(f"heights must be two numbers, the smaller one first, got {heights!r}")
    # Many heights at both ends, where a round surface is steep.
    z = 0.5 * (low + high) - 0.5 * (high - low) * np.cos(np.linspace(0.0, np.pi, _FINE))
    radius = np.asarray(check.function("profile", profile, "heights")(z), float)
    if check.shaped("profile", radius, z.shape).min() < 0.0:
        raise ValueError(f"profile must give radii of at least 0, got {radius.min():g}")
    strips = np.pi * (radius[1:] + radius[:-1]) * np.hypot(np.diff(z), np.diff(radius))
    area = np.concatenate([[0.0], np.cumsum(strips)])
    place = np.interp((np.arange(count) + 0.5) / count * area[-1], area, np.arange(_FINE))
    height, width = (np.interp(place, np.arange(_FINE), of) for of in (z, radius))
    angle = _GOLDEN * np.arange(count)
    points = np.column_stack([width * np.cos(angle), width * np.sin(angle), height])
    return Surface(points, _SPACING * float(np.sqrt(area[-1] / count)))


@check.spelling
def disc(radius: float, count: int) -> Surface:
    """Return points on a flat disc in the x-y plane about the origin, with equal areas.

    Parameters
    ----------
    radius : float
    count : int
        Of points.

    Examples
    --------
    >>> import mrs
    >>> disc = mrs.Rigid(mrs.surfaces.disc(radius=1.0, count=200))
    >>> print(round(mrs.resistance(disc, mrs.Fluid())[2, 2], 1))  # broadside 16, with more points
    15.0
    """
    check.positive("radius", radius)
    check.integer("count", count, 1)
    distance = radius * np.sqrt((np.arange(count) + 0.5) / count)
    angle = _GOLDEN * np.arange(count)
    points = np.column_stack([distance * np.cos(angle), distance * np.sin(angle), 0.0 * angle])
    return Surface(points, _SPACING * radius * float(np.sqrt(np.pi / count)))


@check.spelling
def along(centerline: geometry.Centerline, thickness: float, *, spacing: float = _DENSE) -> Surface:
    """Return points along a thin body, with the blob size that gives it its drag.

    Parameters
    ----------
    centerline : Centerline
        Of `mrs.geometry`; its nodes are replaced by others, equally spaced along straight pieces.
    thickness : float
        Radius of the body.
    spacing : float, optional
        Between points, in blob sizes.

    Examples
    --------
    >>> import mrs
    >>> ring = mrs.surfaces.along(mrs.geometry.ring(1.0, nodes=60), thickness=0.05)
    >>> len(ring.points), round(ring.epsilon, 4)
    (254, 0.0824)
    """
    nodes = check.points("centerline.nodes", centerline.nodes)
    if centerline.closed:
        nodes = np.concatenate([nodes, nodes[:1]])
    arclength = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(nodes, axis=0), axis=1))])
    count, epsilon = slender(arclength[-1], thickness, spacing)
    middles = (np.arange(count) + 0.5) / count * arclength[-1]
    curve = scipy.interpolate.make_interp_spline(
        arclength,
        nodes,
        k=min(3, len(nodes) - 1),
        bc_type="periodic" if centerline.closed else None,
    )
    line = np.arange(count)
    if centerline.closed:
        line = np.append(line, 0)
    return Surface(curve(middles), epsilon, (line,))


def slender(length: float, thickness: float, spacing: float) -> tuple[int, float]:
    """Return how many points a thin body has, and the blob size that gives it its drag.

    Parameters
    ----------
    length, thickness : float
        Of its centreline, and its radius.
    spacing : float
        Between points, in blob sizes.

    Examples
    --------
    >>> import mrs
    >>> count, epsilon = mrs.surfaces.slender(length=2.0, thickness=0.1, spacing=0.3)
    >>> count, round(epsilon, 4)
    (40, 0.1649)
    """
    epsilon = float(np.sqrt(np.e)) * check.positive("thickness", thickness)
    return max(1, round(length / (check.positive("spacing", spacing) * epsilon))), epsilon


@check.spelling
def helix(
    radius: float,
    pitch: float,
    length: float,
    thickness: float,
    *,
    spacing: float = _DENSE,
    handedness: Literal["right", "left"] = "right",
) -> Surface:
    """Return points along a helical filament about z, which begins at z = 0.

    Parameters
    ----------
    radius, pitch, length : float
        Of the helix; `length` is along its axis.
    thickness : float
        Radius of the filament. The blob size is sqrt(e) times that, which gives its drag.
    spacing : float, optional
        Between points, in blob sizes.
    handedness : {"right", "left"}, optional

    Examples
    --------
    >>> import mrs
    >>> tail = mrs.Rigid(mrs.surfaces.helix(0.2, pitch=1.0, length=2.0, thickness=0.1))
    >>> matrix = mrs.resistance(tail, mrs.Fluid())
    >>> print(matrix[2, 5].round(2))  # the force along z of a turn about z
    -0.24
    """
    nodes = max(16, int(np.ceil(64.0 * length / check.positive("pitch", pitch))))
    line = geometry.helix(radius, pitch, length, nodes, handedness=handedness)
    return along(line, thickness, spacing=spacing)


def joined(*surfaces: Surface) -> Surface:
    """Return several surfaces as one; each point keeps its blob size.

    Raises
    ------
    ValueError
        If there is none.

    Examples
    --------
    >>> import mrs
    >>> ball = mrs.surfaces.sphere(radius=1.0, count=50)
    >>> pair = mrs.surfaces.joined(ball, ball.moved((0.0, 0.0, 3.0)))
    >>> pair.points.shape
    (100, 3)
    """
    if not surfaces:
        raise ValueError("surfaces must be at least one")
    counts = [len(surface.points) for surface in surfaces]
    before = np.cumsum([0, *counts])
    lines = tuple(
        line + first
        for surface, first in zip(surfaces, before[:-1], strict=True)
        for line in surface.lines
    )
    epsilons = [np.full(len(surface.points), surface.epsilon) for surface in surfaces]
    points = np.concatenate([surface.points for surface in surfaces])
    return Surface(points, np.concatenate(epsilons), lines)


def read(path: str | os.PathLike[str]) -> Surface:
    """Return the vertices of the triangles in a file, for example .stl, .obj, .msh, .vtu, .ply.

    Parameters
    ----------
    path : path
        Read by meshio. The blob size is 0.4 times the root of the area of a vertex.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If there are no triangles, or meshio cannot read the file.

    Examples
    --------
    >>> import mrs
    >>> import pyvista
    >>> pyvista.Sphere(radius=1.0).save("head.stl")
    >>> head = mrs.surfaces.read("head.stl")
    >>> print(len(head.points), round(abs(head.points).max(), 4))
    842 1.0
    """
    import meshio  # not before it is used: it takes a fifth of a second

    if not Path(path).exists():
        raise FileNotFoundError(f"path: there is no file {str(path)!r}")
    try:
        with np.errstate(over="ignore"):  # meshio takes text in a .stl for a number at first
            mesh = meshio.read(Path(path))
    except (SystemExit, meshio.ReadError) as error:  # it ends the program where it cannot read
        raise ValueError(
            "path must be a file that meshio reads, such as a .stl, .ply, .obj or .vtu, got "
            f"{str(path)!r}"
        ) from error
    triangles = [block.data for block in mesh.cells if block.type == "triangle"]
    if not triangles:
        kinds = sorted({block.type for block in mesh.cells})
        raise ValueError(f"{path} must have triangles, it has {', '.join(kinds) or 'no cells'}")
    points, number = np.unique(np.asarray(mesh.points, float), axis=0, return_inverse=True)
    corners = points[number.ravel()[np.concatenate(triangles)]]
    sides = corners[:, 1:] - corners[:, :1]
    area = 0.5 * np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1).sum()
    used = np.unique(number.ravel()[np.concatenate(triangles)])
    return Surface(points[used], _SPACING * float(np.sqrt(area / len(used))))
