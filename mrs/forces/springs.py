"""Springs between points of bodies, and from points of bodies to places in space."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from mrs import check
from mrs.bodies.layout import Layout
from mrs.fluid import Fluid, Periodic
from mrs.forces.base import Force

Point = tuple[str, int]  # name of a body, and number of a point


@check.spelling
class Springs(Force):
    """Linear springs: tethers to fixed places, crosslinks between bodies or within one.

    A spring of length r pulls its ends together by the force ``stiffness (r - rest_length)`` along
    the line between them, so that two bodies feel no net force and no net torque of it.

    Parameters
    ----------
    starts : sequence of (str, int)
        A point of a body for each spring: the body's name, and the number of the point among all
        points of the body, as in messages ("node 3 of 'rods'"). Of `Swimmers` all bodies come
        first, then all flagella.
    ends : sequence of (str, int) or (float, float, float)
        The other end of each: a point as well, or a place in space.
    stiffness : float or array_like
        Force over length, a number or (springs,).
    rest_length : "initial", float or array_like, optional
        A number or (springs,); "initial" for the lengths at time zero.

    Raises
    ------
    ValueError, TypeError
        In a scene also if a body or a point is not there.

    Notes
    -----
    In a periodic box a spring goes to that image of its end which is nearest at time zero, and
    stays with it, however far the ends move, and where a shear flow carries the box. Positions of a
    state are not wrapped into the box.

    Examples
    --------
    >>> import mrs
    >>> pusher = mrs.Swimmers([[0, 0, 0]], [[0, 0, 1]], length=1.0, force=1.0, epsilon=0.1)
    >>> tether = mrs.Springs([("swimmers", 0)], [(0, 0, 2)], stiffness=3.0, rest_length=1.0)
    >>> mrs.Simulation(mrs.Fluid(), [pusher], forces=[tether]).energy()
    1.5
    """

    kind = "springs"

    def __init__(
        self,
        starts: Sequence[Any],
        ends: Sequence[Any],
        *,
        stiffness: ArrayLike,
        rest_length: ArrayLike | Literal["initial"] = "initial",
    ) -> None:
        self.starts = [_point(f"starts[{i}]", start) for i, start in enumerate(starts)]
        self.ends = [_end(f"ends[{i}]", end) for i, end in enumerate(ends)]
        count = len(self.starts)
        if len(self.ends) != count:
            raise ValueError(f"ends must be as many as starts, {count}, got {len(self.ends)}")
        self.stiffness = check.broadcast("stiffness", stiffness, (count,), 0.0)
        self.rest_length = rest_length
        if isinstance(rest_length, str):
            check.one_of("rest_length", rest_length, ("initial",))
        else:
            self.rest_length = check.broadcast("rest_length", rest_length, (count,))
            if (self.rest_length < 0.0).any():
                raise ValueError(f"rest_length must not be negative, got {rest_length!r}")
        self._linked = np.array([len(end) == 2 for end in self.ends], bool)
        self._places = np.array([end if len(end) == 3 else (0.0,) * 3 for end in self.ends], float)
        self._places = self._places.reshape(-1, 3)

    def require(self, layout: Layout, fluid: Fluid) -> None:
        """Refuse points that are not there."""
        self._rows(layout)

    def forces(self, time: float, points: np.ndarray, layout: Layout, fluid: Fluid) -> np.ndarray:
        """Return the force on each point, (F, 3)."""
        starts, ends = self._rows(layout)
        between, extension = self._stretched(time, points, layout, fluid)
        length = np.linalg.norm(between, axis=1)
        pull = (self.stiffness * extension / np.where(length > 0.0, length, 1.0))[:, None] * between
        forces = np.zeros_like(points)
        np.add.at(forces, starts, pull)
        np.subtract.at(forces, ends, pull[self._linked])
        return forces

    def energy(self, time: float, points: np.ndarray, layout: Layout, fluid: Fluid) -> float:
        """Return the sum of ``1/2 stiffness (r - rest_length)^2``."""
        _, extension = self._stretched(time, points, layout, fluid)
        return float(0.5 * self.stiffness @ extension**2)

    def _stretched(
        self, time: float, points: np.ndarray, layout: Layout, fluid: Fluid
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the steps from starts to ends, (springs, 3), and how far they are extended."""
        between, initial = (
            self._between(x, layout) for x in (points, layout.initial_points[layout.forced])
        )
        if isinstance(fluid.boundary, Periodic):
            nearest = _nearest(initial, fluid.boundary)
            between = between + fluid.carried(nearest - initial, time)
            initial = nearest
        at_rest = self.rest_length
        if isinstance(at_rest, str):
            at_rest = np.linalg.norm(initial, axis=1)
        return between, np.linalg.norm(between, axis=1) - at_rest

    def _between(self, points: np.ndarray, layout: Layout) -> np.ndarray:
        starts, ends = self._rows(layout)
        places = self._places.copy()
        places[self._linked] = points[ends]
        return places - points[starts]

    def _rows(self, layout: Layout) -> tuple[np.ndarray, np.ndarray]:
        """Return the rows of the starts, and of those ends that are points of bodies."""
        linked = [end for end in self.ends if len(end) == 2]
        return _rows("starts", self.starts, layout), _rows("ends", linked, layout)


def _rows(role: str, points: Sequence[Any], layout: Layout) -> np.ndarray:
    """Return the rows of points of bodies among the points that can have forces."""
    where = {name: layout.forced_part(role, name)[1] for name in {name for name, _ in points}}
    for name, number in points:
        count = where[name].stop - where[name].start
        if number >= count:
            raise ValueError(
                f"{role}: number must be less than {count}, the points of {name!r}, got {number}"
            )
    return np.array([where[name].start + number for name, number in points], np.int64)


def _point(name: str, value: Any) -> Point:
    """Return a point of a body."""
    pair = list(value) if isinstance(value, (list, tuple)) else []
    if len(pair) != 2 or not isinstance(pair[0], str):
        raise ValueError(f"{name} must be the name of a body and a number, got {value!r}")
    return pair[0], check.integer(f"{name}[1]", pair[1], 0)


def _end(name: str, value: Any) -> Point | tuple[float, ...]:
    """Return a point of a body, or a place."""
    if isinstance(value, (list, tuple)) and any(isinstance(item, str) for item in value):
        return _point(name, value)
    return tuple(check.vector(name, value).tolist())


def _nearest(between: np.ndarray, box: Periodic) -> np.ndarray:
    """Return steps to the nearest images, (n, 3), in a lattice."""
    near = between - np.round(box.places(between)) @ box.vectors
    around = itertools.product((0.0, -1.0, 1.0), repeat=len(box.vectors))
    images = near[:, None] + np.array(list(around)) @ box.vectors
    closest = np.argmin(np.linalg.norm(images, axis=2), axis=1)  # in a skewed cell others may be
    return np.asarray(images[np.arange(len(near)), closest])
