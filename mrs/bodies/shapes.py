"""Shapes in the axes of their body, fixed or as functions of time."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from mrs import check, rotations
from mrs.bodies.surfaces import Surface, joined

_STEP = 1e-3  # of the time that is given, over which velocities are found by differences


class Shape(Protocol):
    """Points in the axes of a body, and their velocities there.

    Attributes
    ----------
    surface : Surface
        At time zero.
    """

    surface: Surface

    def points(self, time: float) -> np.ndarray:
        """Return the points, (p, 3)."""

    def velocities(self, time: float) -> np.ndarray:
        """Return the velocities of the points, (p, 3)."""


class Still:
    """A shape that does not change.

    Parameters
    ----------
    surface : Surface
    """

    def __init__(self, surface: Surface) -> None:
        self.surface = surface

    def points(self, time: float) -> np.ndarray:
        """Return the points, (p, 3)."""
        return self.surface.points

    def velocities(self, time: float) -> np.ndarray:
        """Return zeros, (p, 3)."""
        return np.zeros_like(self.surface.points)


@check.spelling
class Turning:
    """Two parts of a body, of which one turns against the other: a head and its flagellum.

    Parameters
    ----------
    fixed, turning : Surface
        Both in the axes of the body, at time zero.
    rate : float
        Angular velocity of the turning part relative to the fixed one, radians per time.
    axis : (3,) array_like, optional
        Of the turning.
    centre : (3,) array_like, optional
        A point on the axis.

    Examples
    --------
    >>> import mrs
    >>> import numpy as np
    >>> head = mrs.surfaces.sphere(radius=1.0, count=50)
    >>> tail = mrs.surfaces.helix(radius=0.5, pitch=2.0, length=4.0, thickness=0.1)
    >>> shape = mrs.Turning(fixed=head, turning=tail.moved((0, 0, 1)), rate=2.0 * np.pi)
    >>> speeds = np.linalg.norm(shape.velocities(0.0), axis=1)
    >>> print(speeds.min(), speeds.max().round(4))  # of the head, of the tail
    0.0 3.1416
    """

    def __init__(
        self,
        fixed: Surface,
        turning: Surface,
        *,
        rate: float,
        axis: ArrayLike = (0.0, 0.0, 1.0),
        centre: ArrayLike = (0.0, 0.0, 0.0),
    ) -> None:
        self.surface = joined(
            check.instance("fixed", fixed, Surface), check.instance("turning", turning, Surface)
        )
        self.rate = check.number("rate", rate, -np.inf, np.inf)
        self.axis, self.centre = check.direction("axis", axis), check.vector("centre", centre)
        self._first = len(fixed.points)

    def _turned(self, time: float) -> np.ndarray:
        """Return the turning part, from the centre."""
        turn = rotations.exponential((self.rate * time * self.axis)[None])
        return rotations.rotate(turn, self.surface.points[self._first :] - self.centre)

    def points(self, time: float) -> np.ndarray:
        """Return the points, (p, 3)."""
        fixed = self.surface.points[: self._first]
        return np.concatenate([fixed, self.centre + self._turned(time)])

    def velocities(self, time: float) -> np.ndarray:
        """Return the velocities of the points, (p, 3)."""
        turning = rotations.cross(self.rate * self.axis[None], self._turned(time))
        return np.concatenate([np.zeros((self._first, 3)), turning])


@check.spelling
class Moving:
    """A shape that a function of time gives.

    Parameters
    ----------
    points : callable
        Of the time: returns (p, 3).
    period : float
        In which the shape changes: its velocities are central differences of fourth order over a
        thousandth of that.
    epsilon : float
        Blob size.
    lines : bool, optional
        Whether the points, in their order, are those of a centreline.

    Examples
    --------
    >>> import mrs
    >>> import numpy as np
    >>> ball = mrs.surfaces.sphere(radius=1.0, count=100)
    >>> def breathing(time):
    ...     return (1.0 + 0.1 * np.sin(2.0 * np.pi * time)) * ball.points
    >>> shape = mrs.Moving(breathing, period=1.0, epsilon=ball.epsilon, lines=False)
    >>> print(np.linalg.norm(shape.velocities(0.0), axis=1).max().round(4))  # 0.2 pi
    0.6283
    """

    def __init__(
        self,
        points: Callable[[float], Any],
        *,
        period: float,
        epsilon: float,
        lines: bool = True,
    ) -> None:
        self._function = check.function("points", points, "time")
        self.period = check.positive("period", period)
        check.positive("epsilon", epsilon)
        check.flag("lines", lines)
        start = check.points("points", points(0.0))
        line = (np.arange(len(start)),) if lines else ()
        self.surface = Surface(start, epsilon, line)

    def points(self, time: float) -> np.ndarray:
        """Return the points, (p, 3)."""
        count = len(self.surface.points)
        value = np.asarray(self._function(time), float)
        if value.shape != (count, 3):
            raise check.FunctionError(
                f"points must give shape ({count}, 3) at any time, got {value.shape} at {time:g}"
            )
        return check.vectors("points", value, count, lambda row: f"in row {row} at time {time:g}")

    def velocities(self, time: float) -> np.ndarray:
        """Return the velocities of the points, (p, 3)."""
        step = _STEP * self.period
        near, far = (
            self.points(time + distance) - self.points(time - distance)
            for distance in (step, 2.0 * step)
        )
        return (8.0 * near - far) / (12.0 * step)
