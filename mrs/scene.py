"""The physics of a scene: from a state to points, loads, motion and rates. It knows no files."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from mrs import check
from mrs.bodies import Body
from mrs.bodies.layout import Layout
from mrs.fluid import Backend, Fluid, Mobility, Periodic
from mrs.fluid.mobility import Boundary
from mrs.forces import Force
from mrs.profile import Profile
from mrs.time.state import Arrays, State
from treecode.ranks import joint

_PERTURBATION = 1e-3  # of positions in blob sizes and of triads in radians, to estimate eigenvalues


class Evaluation(NamedTuple):
    """All that follows from one state."""

    time: float
    state: State
    points: np.ndarray
    """Where forces act and velocities are known, (N, 3)."""
    loads: np.ndarray
    """Forces, and torques if any body has them, (N, 3 or 6)."""
    motion: np.ndarray
    """Velocities, and angular velocities if any body wants them, (N, 3 or 6)."""
    rates: np.ndarray
    """Velocities of positions and angular velocities of triads, (P + Q, 3)."""


class OutsideError(check.NotFiniteValueError):
    """A point is not in the fluid, which may be due to too long a step."""


class Scene:
    """Bodies in a viscous fluid, and the forces on them.

    Parameters
    ----------
    fluid : Fluid
    bodies : sequence of Body
        Their names must differ.
    forces : sequence of Force, optional
        Besides the loads of the bodies themselves.
    backend : Backend, optional
        How velocities are summed.
    comm : mpi4py.MPI.Comm, optional
        Ranks that share the sums.

    Attributes
    ----------
    layout : Layout
        The bodies in flat arrays.
    epsilons : (N,) float64 ndarray
        Blob sizes; 1 at points without forces.
    mobility : Mobility
    profile : Profile
        Where time is counted.
    ranks : treecode.ranks.OneRank
    error_scale : (P + Q, 1) float64 ndarray
        Unit of errors of each coordinate; 0 where nothing has a length.
    perturbation : (P + Q, 1) float64 ndarray
        A small displacement of each coordinate; 0 likewise.
    """

    def __init__(
        self,
        fluid: Fluid,
        bodies: Sequence[Body],
        forces: Sequence[Force] = (),
        backend: Backend | None = None,
        comm: Any = None,
    ) -> None:
        self.fluid, self.bodies, self.forces = fluid, tuple(bodies), tuple(forces)
        self.backend = backend or Backend()
        self.profile = Profile()
        self.layout = layout = Layout(self.bodies)
        background = fluid.background
        spins = layout.has_spin.any()
        if background is not None and spins and not hasattr(background, "vorticity"):
            raise ValueError("background must have a vorticity, since it turns the triads of rods")
        self.epsilons = layout.epsilons(fluid.epsilon)
        self.mobility = Mobility(
            fluid.viscosity,
            self.epsilons,
            layout.has_force,
            layout.has_torque,
            layout.has_spin,
            layout.numbers,
            self.backend,
            fluid.boundary,
            comm,
        )
        self.ranks = self.mobility.ranks
        self._set_scales()
        self._require_inside(layout.points(layout.initial), 0.0)
        self._last: Evaluation | None = None

    def _set_scales(self) -> None:
        """Set the units of errors, and of perturbations, of the local coordinates."""
        turns = np.ones(len(self.layout.initial.quaternions))
        lengths = self.layout.length_scales()
        largest = max(body.length_scale for body in self.bodies)
        smallest = self.epsilons[self.layout.has_force].min(initial=max(largest, 0.0))
        self.error_scale = np.concatenate([lengths, turns])[:, None]
        small = np.concatenate([np.full(len(lengths), smallest), turns])
        self.perturbation = _PERTURBATION * small[:, None]

    @joint
    def evaluate(self, time: float, state: State, near: State | None = None) -> Evaluation:
        """Return loads, motion and rates in a state; the last answer is kept.

        With `near`, a state that differs little, points that are not in the fluid are taken where
        they are in that state. Otherwise they are refused.
        """
        with self.mobility.lock:
            last = self._last
            if last is None or last.time != time or not last.state.equals(state):
                with self.profile.stage("forces"):
                    last = self._last = self._evaluate(time, state, near)
            return last

    def rates(self, time: float, state: State, near: State | None = None) -> np.ndarray:
        """Return velocities and angular velocities of the coordinates, (P + Q, 3).

        `near` is as for `evaluate`.
        """
        return self.evaluate(time, state, near).rates

    def forget(self) -> None:
        """Compute the next evaluation anew, since the sums are done by other methods now."""
        self._last = None

    def _evaluate(self, time: float, state: State, near: State | None) -> Evaluation:
        points = self.layout.points(state)
        if near is not None:
            rows = self.fluid.boundary.outside(points)
            points[rows] = self.layout.points(near)[rows]
        self._require_inside(points, time)
        loads = self._loads(time, state, points)
        if check.computable(points, loads):
            motion = self._motion(time, points, loads)
        else:  # the stepper rejects the step, or stops
            motion = np.full_like(loads, np.nan)
        rates = self.layout.rates(time, state, motion)
        return Evaluation(time, state, points, loads, motion, rates)

    def _require_inside(self, points: np.ndarray, time: float) -> None:
        """Refuse points that are not in the fluid."""
        rows = self.fluid.boundary.outside(points)
        if len(rows):
            row = int(rows[0])
            raise OutsideError(
                f"{self.layout.point_name(row)} must be in the fluid, within "
                f"{self.fluid.boundary}, got {tuple(points[row].tolist())} at time {time:g}"
            )

    def refusal(self, time: float, state: State) -> check.NotFiniteValueError | None:
        """Return why a state cannot be: a point outside the fluid; None if it can."""
        try:
            self._require_inside(self.layout.points(state), time)
        except OutsideError as error:
            return error
        return None

    def _loads(self, time: float, state: State, points: np.ndarray) -> np.ndarray:
        """Return the loads of the bodies, and the forces between them."""
        loads = self.layout.loads(time, state)
        forced = self.layout.forced
        if self.forces and len(forced):
            touching = points[forced]
            for force in self.forces:
                values = force.forces(time, touching, self.layout, self.fluid)
                loads[forced, :3] += self._checked(force, values, time)
        return loads

    def _checked(self, force: Force, values: np.ndarray, time: float) -> np.ndarray:
        """Return the forces, (F, 3), that a force gives at the points `layout.forced`."""

        def where(row: int) -> str:
            return f"at {self.layout.point_name(int(self.layout.forced[row]))} and time {time:g}"

        return check.vectors(f"force {force.kind!r}", values, len(self.layout.forced), where)

    def _motion(self, time: float, points: np.ndarray, loads: np.ndarray) -> np.ndarray:
        """Return the motion that the loads cause, and that of the background."""
        motion = self._sum(time, points, loads)
        if self.fluid.background is not None:
            name = self.layout.point_name
            with self.profile.stage("background"):
                motion[:, :3] += self.fluid.flow("velocity", points, time, name)
                if self.layout.width == 6:
                    motion[:, 3:] += 0.5 * self.fluid.flow("vorticity", points, time, name)
        return motion

    def _sum(self, time: float, points: np.ndarray, loads: np.ndarray) -> np.ndarray:
        boundary = self.fluid.boundary_at(time)
        if not self.mobility.evaluations:
            with self.profile.stage("start"):
                return self.mobility(points, loads, boundary)
        with self.profile.stage("sums"):
            motion = self.mobility(points, loads, boundary)
            for info in self.mobility.infos():
                self.profile.divide(info["seconds"], info["near_pairs"], info["far_pairs"])
        return motion

    @joint
    def correct(self, time: float, state: State) -> None:
        """Let the sums meet their tolerance again."""
        now = self.evaluate(time, state)
        with self.profile.stage("error samples"):
            if self.mobility.correct(*self._sources(now)):
                self.forget()

    def energy(self, time: float, state: State) -> float:
        """Return the elastic energy of all bodies."""
        return sum(part.body.energy(time, part.state(state)) for part in self.layout.parts)

    @joint
    def sampled_error(self, time: float, state: State) -> float:
        """Return the relative error of the sums in a state; see `Mobility.sampled_error`."""
        now = self.evaluate(time, state)
        with self.profile.stage("error samples"):
            return self.mobility.sampled_error(*self._sources(now))

    def _sources(self, now: Evaluation) -> tuple[np.ndarray, np.ndarray, Boundary]:
        """Return what the sums of an evaluation were made of: points, loads and the boundary."""
        return now.points, now.loads, self.fluid.boundary_at(now.time)

    @joint
    def velocity(self, points: np.ndarray, now: Evaluation) -> np.ndarray:
        """Return the velocity of the fluid at points, (M, 3), in a state that was evaluated.

        Raises
        ------
        ValueError
            If a point is not in the fluid.
        """
        boundary = self.fluid.boundary_at(now.time)
        boundary.require_inside("points", points)
        with self.mobility.lock:
            velocity = self.mobility.velocity(now.points, now.loads, points, boundary)
        if self.fluid.background is not None:
            velocity += self.fluid.flow("velocity", points, now.time)
        return velocity

    def constant_fields(self, body: Body) -> tuple[Arrays, Arrays]:
        """Return arrays of one body at points and at cells that are the same in all frames.

        With the blob sizes, since the velocity of the fluid follows from them.
        """
        epsilons = self.epsilons[self.layout.part(body).points]
        at_points, at_cells = body.constant_fields(epsilons)
        return at_points | ({"epsilon": epsilons} if body.has_force else {}), at_cells

    def frame(self, body: Body, now: Evaluation) -> tuple[np.ndarray, Arrays, Arrays]:
        """Return the points of one body, (p, 3), and its arrays at points and at cells.

        In a periodic box points are in it, and the array "image" has the multiples of the lattice
        vectors of that time, (p, 3), that lead to where they are in the state.
        """
        part = self.layout.part(body)
        at_points = {"velocity": now.motion[part.points, :3]}
        if body.has_force:
            at_points["force"] = now.loads[part.points, :3]
        if body.has_torque:
            at_points["torque"] = now.loads[part.points, 3:]
        if body.has_spin:
            at_points["angular_velocity"] = now.motion[part.points, 3:]
        of_points, of_cells = body.fields(now.time, part.state(now.state), **at_points)
        points = now.points[part.points]
        box = self.fluid.boundary_at(now.time)
        if isinstance(box, Periodic):
            image = self._images(body, points, box)
            points, of_points = points - image @ box.vectors, of_points | {"image": image}
        return points, of_points, of_cells

    def _images(self, body: Body, points: np.ndarray, box: Periodic) -> np.ndarray:
        """Return the image of a box that each point is in, (p, 3): that of the middle of its line.

        A line is drawn whole, and not across the box.
        """
        line = np.arange(len(points))
        for joined in body.topology()[1]:
            line[joined] = np.min(joined)
        _, line, size = np.unique(line, return_inverse=True, return_counts=True)
        middle = np.stack([np.bincount(line, column) for column in points.T], axis=1)
        return box.images(middle / size[:, None])[line]
