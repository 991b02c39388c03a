"""Bodies whose shape is given in their own axes: rigid ones, and ones with a given stroke."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
import scipy
from numpy.typing import ArrayLike

from mrs import check, rotations
from mrs.bodies.base import Body
from mrs.bodies.drive import Drive
from mrs.bodies.shapes import Shape, Still
from mrs.bodies.surfaces import Surface
from mrs.rigid_motion import GivenMotion
from mrs.time.state import Arrays, State

_TOUCHING = 0.65  # of the distance of neighbours: the radius of spheres without holes between


@check.spelling
class Rigid(Body):
    """Bodies of one shape, which no flow changes: rigid, or with parts and strokes that are given.

    Parameters
    ----------
    shape : Surface, (p, 3) array_like, or Shape
        Points of the surface in the axes of the body (`mrs.surfaces`), or a shape that changes with
        time, such as `mrs.Turning` and `mrs.Moving`.
    positions : (n, 3) array_like, optional
        Of the origin of these axes, for each body; one body at the origin by default.
    orientations : (n, 4) array_like, optional
        Quaternions (x, y, z, w) from these axes to those of space; along them by default.
    motion : {"free", "held"} or Drive, optional
        Of the axes. Free bodies move so that they put `force` and `torque` on the fluid.
    force, torque : (3,) or (n, 3) array_like, optional
        On each free body, for example its weight; the torque is about the origin of its axes.
    delay : float or array_like, optional
        Lag of each body's own time behind the time of the run, a number or (n,).
    epsilon : float or (p,) array_like, optional
        Blob sizes; by default those of the surface, then the fluid's.
    radius : float, optional
        Of the points in pictures. By default spheres touch their neighbours, and lines are as thick
        as their blob size tells, epsilon / sqrt(e).
    name : str, optional
        Of the output file.

    Raises
    ------
    ValueError, TypeError
        The message names the argument and the allowed values.

    Notes
    -----
    Each point carries a regularized Stokeslet. The forces are such that the fluid moves with the
    points (R. Cortez, L. Fauci & A. Medovikov, Phys. Fluids 17, 031504, 2005), see
    `mrs.fluid.Resistance`.

    Examples
    --------
    >>> import mrs
    >>> import numpy as np
    >>> weight = (0.0, 0.0, -6.0 * np.pi)
    >>> ball = mrs.Rigid(mrs.surfaces.sphere(radius=1.0, count=100), force=weight)
    >>> sim = mrs.Simulation(mrs.Fluid(viscosity=1.0), [ball])
    >>> print(round(sim.now.rates[0, 2], 2))  # Stokes: -1
    -0.99
    """

    kind = "rigid"
    has_given_motion = True

    def __init__(
        self,
        shape: Surface | ArrayLike | Shape,
        *,
        positions: ArrayLike = ((0.0, 0.0, 0.0),),
        orientations: ArrayLike | None = None,
        motion: Literal["free", "held"] | Drive = "free",
        force: ArrayLike = (0.0, 0.0, 0.0),
        torque: ArrayLike = (0.0, 0.0, 0.0),
        delay: ArrayLike = 0.0,
        epsilon: ArrayLike | None = None,
        radius: float | None = None,
        name: str = "rigid",
    ) -> None:
        self.made_with = {k: v for k, v in locals().items() if k != "self"}
        self.name = check.file_name("name", name)
        self.shape = _shape(shape)
        self.positions = check.points("positions", positions)
        count, points = len(self.positions), self.shape.surface.points
        self.quaternions = np.tile(rotations.IDENTITY, (count, 1))
        if orientations is not None:
            self.quaternions = check.rows("orientations", orientations, 4, count)
            if not self.quaternions.any(axis=1).all():
                raise ValueError("orientations must not be zero")
            self.quaternions = rotations.normalize(self.quaternions)
        self.motion = (
            motion
            if isinstance(motion, Drive)
            else check.one_of("motion", motion, ("free", "held"))
        )
        self._load = np.hstack(
            [check.broadcast(n, v, (count, 3)) for n, v in (("force", force), ("torque", torque))]
        )
        if motion != "free" and self._load.any():
            raise ValueError(
                "force and torque must be zero unless motion is 'free': they follow from the motion"
            )
        self._delay = check.broadcast("delay", delay, (count,))
        if epsilon is None:
            epsilon = getattr(self.shape.surface, "epsilon", None)
        self._epsilon = (
            None if epsilon is None else check.broadcast("epsilon", epsilon, (len(points),), 0.0)
        )
        self.radius = None if radius is None else check.positive("radius", radius)
        self.length_scale = float(np.linalg.norm(points, axis=1).max(initial=0.0))
        self._at_rates(0.0)  # refuses bad results of functions

    def _at_rates(self, time: float) -> np.ndarray:
        """Return the given velocities and angular velocities of the axes, (n, 6); zero if free."""
        count = len(self.positions)
        if not isinstance(self.motion, Drive):
            return np.zeros((count, 6))
        times, name = time - self._delay, f"body {{}} of {self.name!r}"
        return np.hstack(
            [
                self.motion.at(what, times, "motion", name)
                for what in ("velocity", "angular_velocity")
            ]
        )

    def _of_shape(self, what: str, time: float) -> np.ndarray:
        """Return points or velocities of all bodies in their own axes, (n p, 3)."""
        times, number = np.unique(time - self._delay, return_inverse=True)
        values = [getattr(self.shape, what)(float(t)) for t in times]
        return np.concatenate([values[i] for i in number]) if len(number) else np.empty((0, 3))

    @property
    def _frame(self) -> np.ndarray:
        return np.repeat(np.arange(len(self.positions)), len(self.shape.surface.points))

    def points(self, time: float, state: State) -> np.ndarray:
        """Return the points of one body after the other, (n p, 3)."""
        frame = self._frame
        local = self._of_shape("points", time)
        return state.positions[frame] + rotations.rotate(state.quaternions[frame], local)

    def given_motion(self, time: float, state: State) -> GivenMotion:
        """Return how the points move."""
        frame = self._frame
        velocity = rotations.rotate(state.quaternions[frame], self._of_shape("velocities", time))
        return GivenMotion(
            local=self._of_shape("points", time),
            velocity=velocity,
            frame=frame,
            centre=state.positions,
            quaternion=state.quaternions,
            free=np.full(len(self.positions), self.motion == "free"),
            motion=self._at_rates(time),
            load=self._load,
        )

    def epsilons(self, default: float) -> np.ndarray:
        """Return the blob size at each point, (n p,)."""
        count = len(self.shape.surface.points)
        own = np.full(count, default) if self._epsilon is None else self._epsilon
        return np.tile(own, len(self.positions))

    def pieces(self) -> np.ndarray:
        """Return the number of the body, (n,)."""
        return np.arange(len(self.positions))

    def contact_labels(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the bodies' numbers; points of one body do not touch each other."""
        frame = self._frame
        return frame, np.zeros(len(frame)), np.full(len(frame), np.inf)

    def topology(self) -> tuple[np.ndarray, list[np.ndarray]]:
        """Return the points that are on no line as vertices, and the lines of the surface."""
        surface = self.shape.surface
        starts = len(surface.points) * np.arange(len(self.positions))
        vertices = (starts[:, None] + self._single).ravel()
        return vertices, [line + start for start in starts for line in surface.lines]

    @property
    def _single(self) -> np.ndarray:
        """Points of the surface that are on no line."""
        surface = self.shape.surface
        on_lines = np.concatenate([np.empty(0, int), *surface.lines])
        return np.setdiff1d(np.arange(len(surface.points)), on_lines)

    def constant_fields(self, epsilons: np.ndarray) -> tuple[Arrays, Arrays]:
        """Return radius and the body's number at points."""
        radius = epsilons / np.sqrt(np.e)
        if self.radius is not None:
            radius = np.full(len(epsilons), self.radius)
        elif len(single := self._single):
            points = self.shape.surface.points[single]
            distance, _ = scipy.spatial.cKDTree(points).query(points, k=[min(2, len(points))])
            radius.reshape(len(self.positions), -1)[:, single] = _TOUCHING * distance[:, 0]
        return {"radius": radius, "body_id": self._frame}, {}


class Prescribed(Rigid):
    """Bodies whose motion is prescribed: cilia with a given beat, a sheet with a given wave.

    Parameters
    ----------
    shape : Shape
        Points as a function of time, such as `mrs.Moving` and `mrs.Beat`.
    motion : {"held", "free"} or Drive, optional
        Of the axes of the bodies: by default they do not move. Free bodies swim.
    positions, orientations, force, torque, delay, epsilon, radius, name
        As for `Rigid`; with `delay` the bodies have phases.

    Raises
    ------
    ValueError, TypeError
        The message names the argument and the allowed values.

    Examples
    --------
    >>> import mrs
    >>> import numpy as np
    >>> beat = mrs.Beat.read("lung_cilium", length=1.0, period=1.0, thickness=0.05, spacing=0.6)
    >>> cilium = mrs.Prescribed(beat, positions=[[0.0, 0.0, 0.1]])
    >>> sim = mrs.Simulation(mrs.Fluid(boundary=mrs.Wall()), [cilium])
    >>> velocity = sim.now.motion[:, :3] - beat.velocities(0.0)
    >>> bool(np.abs(velocity).max() < 1e-3)  # the fluid moves with the cilium
    True
    """

    kind = "prescribed"

    def __init__(
        self,
        shape: Shape,
        *,
        positions: ArrayLike = ((0.0, 0.0, 0.0),),
        orientations: ArrayLike | None = None,
        motion: Literal["held", "free"] | Drive = "held",
        force: ArrayLike = (0.0, 0.0, 0.0),
        torque: ArrayLike = (0.0, 0.0, 0.0),
        delay: ArrayLike = 0.0,
        epsilon: ArrayLike | None = None,
        radius: float | None = None,
        name: str = "prescribed",
    ) -> None:
        given = {k: v for k, v in locals().items() if k not in ("self", "__class__")}
        super().__init__(**given)


def _shape(shape: Any) -> Shape:
    if isinstance(shape, Surface):
        return Still(shape._replace(points=check.points("shape.points", shape.points)))
    if callable(getattr(shape, "velocities", None)) and hasattr(shape, "surface"):
        return shape
    if callable(shape):
        raise TypeError("shape must not be a function; wrap it: mrs.Moving(function, period=...)")
    return Still(Surface(check.points("shape", shape), None))  # type: ignore[arg-type]
