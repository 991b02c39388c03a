"""Flow of the fluid in stored frames: all that it depends on is in the files of a run."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import asdict, fields, is_dataclass
from typing import Any, NamedTuple

import numpy as np

from mrs import check
from mrs.fluid import BOUNDARIES, Backend, Fluid, Mobility, Periodic
from mrs.fluid.flows import Flow, QuadraticFlow
from mrs.fluid.mobility import DIRECT, Boundary, FreeSpace
from mrs.fluid.sheared import carried
from mrs.output import frames
from mrs.output.trajectory import Trajectory

QUANTITIES = ("velocity", "vorticity", "pressure")
_SAMPLE = 200  # targets, and points of each body, that errors are taken at
_FLOW = ("constant", "gradient", "quadratic")  # the numbers of a QuadraticFlow


def fluid_meta(fluid: Fluid, tolerance: float) -> dict[str, Any]:
    """Return the facts on the fluid that the files of a run hold.

    Parameters
    ----------
    fluid : Fluid
        A background that is a `QuadraticFlow`, and a boundary of `mrs.BOUNDARIES` that is a
        dataclass, is kept by its numbers; any other one by its name only.
    tolerance : float
        Of the run's sums.
    """
    meta: dict[str, Any] = {"viscosity": fluid.viscosity, "tolerance": tolerance}
    background = fluid.background
    if not isinstance(fluid.boundary, FreeSpace):
        meta |= _boundary_meta(fluid.boundary)
    if background is not None:
        meta["background"] = type(background).__qualname__
    if type(background) is QuadraticFlow:
        meta |= {f"background {name}": getattr(background, name) for name in _FLOW}
    return meta


def _boundary_meta(boundary: Boundary) -> dict[str, Any]:
    """Return the name of a boundary, and its numbers if it can be made of them again."""
    kind = type(boundary)
    meta: dict[str, Any] = {"boundary": kind.__qualname__}
    if kind in BOUNDARIES.values() and is_dataclass(boundary):
        meta["boundary kind"] = next(name for name, own in BOUNDARIES.items() if own is kind)
        meta |= {f"boundary {name}": value for name, value in asdict(boundary).items()}
    return meta


def stored_boundary(meta: Mapping[str, Any], time: float) -> Boundary | None:
    """Return the boundary that a file holds, if it holds its numbers, where it is at a time.

    Parameters
    ----------
    meta : dict
        Of a trajectory.
    time : float
    """
    kind = BOUNDARIES.get(meta.get("boundary kind", ""))
    if kind is None or not is_dataclass(kind):
        return None
    names = [field.name for field in fields(kind) if f"boundary {field.name}" in meta]
    boundary = kind(**{name: meta[f"boundary {name}"] for name in names})
    return carried(boundary, _stored_background(meta), time)


def _stored_background(meta: Mapping[str, Any]) -> QuadraticFlow | None:
    """Return the background that a file holds, if it holds its numbers."""
    if f"background {_FLOW[0]}" not in meta:
        return None
    return QuadraticFlow(**{name: meta[f"background {name}"] for name in _FLOW})


def stored_lattices(meta: Mapping[str, Any], times: Iterable[float]) -> np.ndarray | None:
    """Return the lattice vectors of a periodic run at some times, (T, 3, 3), in rows.

    Parameters
    ----------
    meta : dict
        Of a trajectory.
    times : (T,) float ndarray
    """
    boxes = [stored_boundary(meta, time) for time in times]
    lattices = [box.vectors for box in boxes if isinstance(box, Periodic)]
    return np.stack(lattices) if lattices else None


class FieldError(NamedTuple):
    """How far values that were computed from a frame may be off."""

    sums: float
    """Relative error, K eq. (8.1), of the sums at targets drawn at random."""
    rounding: float
    """Likewise, of the rounding to single precision when the frame was stored."""
    at_bodies: float
    """Difference from the velocities stored with the frame: median over points of the bodies, in
    root mean squares of these velocities; nan if the background is unknown, and for other values
    than velocities."""


class StoredFrame:
    """A frame of a run, and the flow of the fluid in it.

    Parameters
    ----------
    directory : path
        Of the run.
    frame : int, optional
        Its number; negative ones count from the end.
    background : Flow, optional
        In place of one that the files only name.
    boundary : treecode.Boundary, optional
        Likewise; that of time 0.

    Attributes
    ----------
    time : float
    points : (N, 3) float64 ndarray
        Of all bodies.
    tolerance : float
        Of the sums, as in the run.
    unknown : str or None
        Name of a background that neither the files nor the caller define. All values are then
        those of the disturbance by the bodies alone.
    unknown_boundary : str or None
        Name of a boundary that neither defines. There are no values then.

    Raises
    ------
    FileNotFoundError
        If there are no trajectories.
    IndexError
        If there is no such frame; the message names the files without it.
    ValueError
        If the files lack numbers that the flow depends on, as files of earlier versions do.
    """

    def __init__(
        self,
        directory: str | os.PathLike[str],
        frame: int = -1,
        background: Flow | None = None,
        boundary: Boundary | None = None,
    ) -> None:
        with frames.trajectories(directory) as bodies:
            common = frames.Frames(bodies)
            number = common.number(frame)
            self.time = common.times[number]
            places = common.places(number)
            self._parts = [_part(body, i) for body, i in zip(bodies, places, strict=True)]
            self._meta = meta = bodies[0].meta
        self.points = np.concatenate([part.points for part in self._parts]).astype(np.float64)
        self.tolerance: float = meta["tolerance"]
        self._background = background or _stored_background(meta)
        self.unknown = meta.get("background") if self._background is None else None
        given = carried(boundary, background, self.time) if boundary else None
        self._boundary = given or stored_boundary(meta, self.time)
        self.unknown_boundary = meta.get("boundary") if self._boundary is None else None
        self._sources = _sources(self._parts)
        self._sums = self._mobility(self._sources, "auto")

    @property
    def loads(self) -> tuple[np.ndarray, np.ndarray]:
        """Points that put loads on the fluid, (M, 3), and forces and torques there, (M, 6)."""
        return self._sources.points, self._sources.loads

    def velocity(self, targets: np.ndarray) -> np.ndarray:
        """Return the velocity of the fluid, (M, 3).

        Parameters
        ----------
        targets : (M, 3) float ndarray
            Any points; behind a wall the velocity is zero.

        Raises
        ------
        ValueError
            If the boundary is unknown.
        """
        return self.values("velocity", targets)

    def vorticity(self, targets: np.ndarray) -> np.ndarray:
        """Return the curl of the velocity, (M, 3).

        Parameters
        ----------
        targets : (M, 3) float ndarray
            Any points; behind a wall the vorticity is zero.

        Raises
        ------
        ValueError
            If the boundary is unknown, or the background has no vorticity.
        """
        return self.values("vorticity", targets)

    def pressure(self, targets: np.ndarray) -> np.ndarray:
        """Return the pressure of the fluid, (M,).

        That of the bodies vanishes far away, that of the background at the origin.

        Parameters
        ----------
        targets : (M, 3) float ndarray
            Any points.

        Raises
        ------
        ValueError
            If there is a boundary, of whose images no pressure is known, or if the background has
            no pressure.
        """
        return self.values("pressure", targets)

    def values(self, quantity: str, targets: np.ndarray) -> np.ndarray:
        """Return one of `QUANTITIES`, (M, 3) or (M,)."""
        self._require(quantity)
        return self._at(quantity, targets, self._sources, self._sums)

    def _require(self, quantity: str) -> None:
        """Refuse what is not known of the boundary or the background."""
        if self.unknown_boundary:
            raise ValueError(
                f"boundary must be given: the run had a {self.unknown_boundary}, which files "
                "cannot hold"
            )
        if quantity == "pressure" and not isinstance(self._boundary, FreeSpace | None):
            raise ValueError(
                f"pressure is known in free space only, got a run with {self._boundary}: its "
                "images are given by their velocities"
            )
        if self._background is not None and not hasattr(self._background, quantity):
            raise ValueError(
                f"background must have a {quantity}, got {type(self._background).__qualname__}"
            )

    def error(self, targets: np.ndarray, values: np.ndarray, of: str = "velocity") -> FieldError:
        """Return how far values may be off.

        Parameters
        ----------
        targets : (M, 3) float ndarray
        values : (M, 3) or (M,) float ndarray
            Of `values` there.
        of : str, optional
            What they are, of `QUANTITIES`.
        """
        rng = np.random.default_rng(0)
        drawn = _draw(len(targets), rng)
        exact = self._directly(of, targets[drawn], self._sources)
        unrounded = _sources(_perturbed(part, rng) for part in self._parts)
        other = self._directly(of, targets[drawn], unrounded)
        scale = np.linalg.norm(exact) or 1.0
        compared = of == "velocity" and not self.unknown
        return FieldError(
            float(np.linalg.norm(values[drawn] - exact) / scale),
            float(np.linalg.norm(other - exact) / scale),
            self._beside_stored(rng) if compared else np.nan,
        )

    def _beside_stored(self, rng: np.random.Generator) -> float:
        """Compare with the frame's own velocities. A median, since held nodes have others."""
        points, stored = [], []
        for part in self._parts:
            drawn = _draw(len(part.points), rng)
            points.append(part.points[drawn].astype(np.float64))
            stored.append(part.velocity[drawn].astype(np.float64))
        velocity = self._directly("velocity", np.concatenate(points), self._sources)
        difference = velocity - np.concatenate(stored)
        square = np.mean(np.sum(np.concatenate(stored) ** 2, axis=1))
        return float(np.median(np.linalg.norm(difference, axis=1)) / (np.sqrt(square) or 1.0))

    def _directly(self, quantity: str, targets: np.ndarray, sources: _Sources) -> np.ndarray:
        return self._at(quantity, targets, sources, self._mobility(sources, DIRECT))

    def _at(
        self, quantity: str, targets: np.ndarray, sources: _Sources, sums: Mobility
    ) -> np.ndarray:
        """Return a quantity of the flow of some sources, zero outside of the fluid."""
        targets = check.points("targets", targets)
        inside = np.ones(len(targets), bool)
        if self._boundary is not None:
            inside[self._boundary.outside(targets)] = False
        there = targets[inside]
        flow: np.ndarray = getattr(sums, quantity)(sources.points, sources.loads, there)
        if self._background is not None:
            more = (self._meta["viscosity"],) if quantity == "pressure" else ()
            flow += getattr(self._background, quantity)(there, self.time, *more)
        values = np.zeros((len(targets), *flow.shape[1:]))
        values[inside] = flow
        return values

    def _mobility(self, sources: _Sources, backend: str) -> Mobility:
        """Return the sums over the sources, which want no angular velocities."""
        forced = np.ones(len(sources.points), bool)
        return Mobility(
            viscosity=self._meta["viscosity"],
            epsilons=sources.epsilons,
            forced=forced,
            torqued=sources.torqued,
            spinning=~forced,
            bodies=np.zeros(len(forced), int),
            backend=Backend(backend, tolerance=self.tolerance),
            boundary=self._boundary,
        )


class _Part(NamedTuple):
    """The arrays of one body in a frame, with the types of its file."""

    points: np.ndarray
    velocity: np.ndarray
    epsilon: np.ndarray | None
    force: np.ndarray | None
    torque: np.ndarray | None


class _Sources(NamedTuple):
    """All points with forces, in float64."""

    points: np.ndarray
    loads: np.ndarray
    epsilons: np.ndarray
    torqued: np.ndarray


def _part(body: Trajectory, i: int) -> _Part:
    data = body.point_data(i)
    missing = {"velocity"} - set(data)
    if "force" in data or "epsilon" in data:
        missing |= {"force", "epsilon"} - set(data)
    missing |= {"viscosity", "tolerance"} - set(body.meta)
    if missing:
        raise ValueError(
            f"{body.path} lacks {', '.join(sorted(missing))}, on which the flow of the fluid "
            "depends: files of earlier versions do; run it again, or build the simulation in "
            "Python and take mrs.restart(sim).velocity(points)"
        )
    loads = {name: data.get(name) for name in ("epsilon", "force", "torque")}
    return _Part(body.points(i), data["velocity"], **loads)


def _sources(parts: Iterable[_Part]) -> _Sources:
    """Return the points with forces of all parts."""
    points, loads, epsilons, torqued = [np.empty((0, 3))], [np.empty((0, 6))], [], []
    for part in parts:
        if part.epsilon is not None and part.force is not None:
            torque = np.zeros_like(part.force) if part.torque is None else part.torque
            points.append(part.points)
            loads.append(np.hstack([part.force, torque]))
            epsilons.append(part.epsilon)
            torqued.append(np.full(len(part.points), part.torque is not None))
    return _Sources(
        np.concatenate(points).astype(np.float64),
        np.concatenate(loads).astype(np.float64),
        np.concatenate([[], *epsilons]).astype(np.float64),
        np.concatenate([[], *torqued]).astype(bool),
    )


def _perturbed(part: _Part, rng: np.random.Generator) -> _Part:
    """Return a part as it may have been before it was stored."""
    values = {k: _unrounded(v, rng) for k, v in part._asdict().items() if v is not None}
    if part.epsilon is not None:  # equal ones stay equal
        sizes, index = np.unique(part.epsilon, return_inverse=True)
        values["epsilon"] = _unrounded(sizes, rng)[index]
    return part._replace(**values)


def _unrounded(values: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return numbers that singles stand for; doubles as they are."""
    if values.dtype != np.float32:
        return values
    return values + rng.uniform(-0.5, 0.5, values.shape) * np.spacing(np.abs(values))


def _draw(count: int, rng: np.random.Generator) -> np.ndarray:
    return rng.choice(count, min(count, _SAMPLE), replace=False)
