"""Fluxes and mean velocities of the fluid."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from mrs import check
from mrs.fluid import Wall

Velocity = Callable[[np.ndarray], np.ndarray]
"""From points, (n, 3), to velocities, (n, 3): as `Simulation.velocity`, or of `frame_velocity`."""

_PARALLEL = 1e-12  # sine of the angle between directions that count as parallel


@check.spelling
class Rectangle:
    """A part of a plane, with the points and weights of a Gauss-Legendre rule.

    Parameters
    ----------
    corner : (3,) array_like
    sides : (2, 3) array_like
        Both sides from the corner. If they are not perpendicular, it is a parallelogram.
    order : int, optional
        Points along each side: polynomials up to degree ``2 order - 1`` along it are exact.

    Attributes
    ----------
    normal : (3,) float64 ndarray
        Unit vector along the cross product of the sides.
    area : float
    points : (order**2, 3) float64 ndarray
    weights : (order**2,) float64 ndarray
        Of a mean over the rectangle; their sum is 1.

    Raises
    ------
    ValueError, TypeError
        If the sides are parallel, or an argument has another shape.

    Examples
    --------
    >>> import mrs
    >>> square = mrs.observables.Rectangle(corner=(0, 0, 0), sides=[(2, 0, 0), (0, 2, 0)], order=3)
    >>> x = square.points[:, 0]
    >>> print(square.area, round(square.weights @ x**4, 6))  # the mean of x^4 is 3.2
    4.0 3.2
    """

    def __init__(self, corner: ArrayLike, sides: ArrayLike, order: int = 16) -> None:
        corner = check.vector("corner", corner)
        first, second = check.shaped("sides", sides, (2, 3))
        check.integer("order", order, 1, 1000)
        across = np.cross(first, second)
        self.area = float(np.linalg.norm(across))
        if self.area <= _PARALLEL * np.linalg.norm(first) * np.linalg.norm(second):
            raise ValueError(f"sides must not be parallel, got {sides!r}")
        self.normal = across / self.area
        nodes, weights = np.polynomial.legendre.leggauss(order)
        s, t = np.meshgrid(0.5 + 0.5 * nodes, 0.5 + 0.5 * nodes, indexing="ij")
        self.points = corner + s.reshape(-1, 1) * first + t.reshape(-1, 1) * second
        self.weights = 0.25 * np.outer(weights, weights).ravel()


def flux(velocity: Velocity, rectangle: Rectangle) -> float:
    """Return the volume of fluid that flows through a rectangle, along its normal, per time.

    Parameters
    ----------
    velocity : callable
        From points, (n, 3), to velocities, (n, 3).
    rectangle : Rectangle

    Raises
    ------
    ValueError
        If the velocity is not finite or has another shape.

    Examples
    --------
    >>> import mrs
    >>> square = mrs.observables.Rectangle((0, -1, -1), [(0, 2, 0), (0, 0, 2)])
    >>> tube = mrs.flows.poiseuille(speed=1.0, radius=2.0)
    >>> print(round(mrs.observables.flux(lambda points: tube.velocity(points, 0.0), square), 6))
    3.333333
    """
    (mean,) = velocity_profile(velocity, rectangle, [0.0])
    return float(rectangle.area * rectangle.normal @ mean)


def velocity_profile(velocity: Velocity, rectangle: Rectangle, heights: ArrayLike) -> np.ndarray:
    """Return the mean velocity over a rectangle that is moved along its normal, (k, 3).

    Parameters
    ----------
    velocity : callable
        From points, (n, 3), to velocities, (n, 3).
    rectangle : Rectangle
        At height 0.
    heights : (k,) array_like

    Raises
    ------
    ValueError
        If the velocity is not finite or has another shape.

    Examples
    --------
    >>> import mrs
    >>> tube = mrs.flows.poiseuille(speed=1.0, radius=2.0)
    >>> strip = mrs.observables.Rectangle((0, 0, 0), [(1, 0, 0), (0, 1e-3, 0)])
    >>> velocity = lambda points: tube.velocity(points, 0.0)
    >>> print(mrs.observables.velocity_profile(velocity, strip, [0, 1, 2])[:, 0].round(4) + 0.0)
    [1.   0.75 0.  ]
    """
    heights = check.shaped("heights", heights, (np.size(heights),))
    points = (rectangle.points + heights[:, None, None] * rectangle.normal).reshape(-1, 3)
    values = check.vectors(
        "velocity", velocity(points), len(points), lambda row: f"at {points[row]}"
    )
    return rectangle.weights @ values.reshape(len(heights), len(rectangle.weights), 3)


def pumped_flux(
    points: ArrayLike,
    loads: ArrayLike,
    viscosity: float,
    direction: ArrayLike = (1.0, 0.0, 0.0),
    wall: Wall | None = None,
) -> float:
    """Return the volume per time that loads pump along a no-slip wall.

    It flows through each whole plane across `direction`, from the wall to infinity. It is exact
    for loads on blobs of any size, and does not include a background flow.

    Parameters
    ----------
    points : (n, 3) array_like
    loads : (n, 3) or (n, 6) array_like
        Forces, or forces and torques, on the fluid there.
    viscosity : float
    direction : (3,) array_like, optional
        Along the wall.
    wall : Wall, optional
        By default at z = 0, with the fluid above.

    Raises
    ------
    ValueError, TypeError
        If an argument has another shape, a point is behind the wall, or `direction` is not along
        the wall.

    Notes
    -----
    Q = sum_j [ h_j f_j . d + n_j . (N x d) / 2 ] / (pi mu) for forces f and torques n at heights h
    along the normal N: the far field of each is a stresslet, of which the flux through planes
    across d does not depend on the plane. For forces see Liron (1978), J. Fluid Mech. 86, 705, and
    Smith, Blake & Gaffney (2008), J. R. Soc. Interface 5, 567. A torque is a couple of forces at
    two heights, of which the symmetric half pumps nothing: so follows its factor of one half.

    Examples
    --------
    >>> import mrs
    >>> import numpy as np
    >>> flux = mrs.observables.pumped_flux([[0, 0, 2]], [[1, 0, 0]], viscosity=1.0)
    >>> print(round(flux * np.pi, 6))  # height times force
    2.0
    """
    wall = Wall() if wall is None else check.instance("wall", wall, Wall)
    points = check.points("points", points)
    wall.require_inside("points", points)
    count = len(points)
    loads = check.shaped("loads", loads, (count, 3), (count, 6))
    check.positive("viscosity", viscosity)
    along = along_wall(wall, direction)
    pumped = wall.heights(points) @ loads[:, :3] @ along
    if loads.shape[1] == 6:
        pumped += 0.5 * loads[:, 3:].sum(axis=0) @ np.cross(wall.normal, along)
    return float(pumped / (np.pi * viscosity))


def along_wall(wall: Wall, direction: ArrayLike) -> np.ndarray:
    """Return the unit vector along `direction`, (3,), which must be at right angles to the normal.

    Raises
    ------
    ValueError, TypeError
        If it is not.
    """
    along = check.direction("direction", direction)
    if abs(along @ wall.normal) > _PARALLEL:
        raise ValueError(
            f"direction must be along the wall, at right angles to its normal {wall.normal}, "
            f"got {direction!r}"
        )
    return along
