"""All bodies of a scene in flat arrays, one after the other."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Sequence
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from mrs import check
from mrs.bodies.base import Body
from mrs.rigid_motion import GivenMotion, Mounted, joined
from mrs.time.state import State

_MANY = 16  # blob sizes


class Part(NamedTuple):
    """Where one body lives in the flat arrays."""

    body: Body
    positions: slice
    quaternions: slice
    points: slice
    frames: slice
    """Among those of all bodies whose motion is given: its positions, or none."""

    def state(self, state: State) -> State:
        """Return the body's own part of a state of all."""
        return State(state.positions[self.positions], state.quaternions[self.quaternions])


class Layout:
    """The bodies of a scene, and which rows of the flat arrays are theirs.

    Parameters
    ----------
    bodies : sequence of Body

    Attributes
    ----------
    parts : list of Part
    initial : State
        Of all bodies at time zero.
    noisy : dict
        By the number of each body that moves at random: its part, its noise.
    count : int
        Number N of points, at which forces act and velocities are known.
    width : int
        Columns of loads and motion: 6 if any body has torques or wants angular velocities, else 3.
    has_force, has_torque, has_spin : (N,) bool ndarray
        Whether the body of a point puts a force and a torque on the fluid, and whether it wants the
        angular velocity.
    numbers : (N,) int ndarray
        Of the body of each point.
    given : int ndarray
        Points of bodies whose motion is given.
    forced : int ndarray
        Points whose body puts forces on the fluid.

    Raises
    ------
    ValueError
        If there is no body or no point, or if two bodies have one name.

    Examples
    --------
    >>> import mrs
    >>> rod = mrs.Rods(
    ...     mrs.geometry.straight(1.0, nodes=11),
    ...     bending=1.0, twisting=1.0, shearing=10.0, stretching=10.0,
    ... )
    >>> layout = mrs.Layout([rod, mrs.Tracers([[1.0, 0.0, 0.0]])])
    >>> layout.count, layout.width, layout.point_name(3)
    (12, 6, "node 3 of 'rods'")
    """

    def __init__(self, bodies: Sequence[Body]) -> None:
        names = [body.name for body in bodies]
        if not bodies or len(set(names)) < len(names):
            raise ValueError(f"bodies must be at least one, with different names, got {names}")
        for body in bodies:
            count = len(body.positions)
            _require_shape(body, "positions", body.positions, (count, 3))
            _require_shape(body, "quaternions", body.quaternions, (0, 4), (count, 4))
        self.initial = State(
            np.concatenate([body.positions for body in bodies]),
            np.concatenate([body.quaternions for body in bodies]),
        )
        if not len(self.initial.positions):
            raise ValueError("bodies must have at least one point")
        sizes = [len(body.points(0.0, State(body.positions, body.quaternions))) for body in bodies]
        places = zip(
            bodies,
            _slices(len(body.positions) for body in bodies),
            _slices(len(body.quaternions) for body in bodies),
            _slices(sizes),
            _slices(len(body.positions) * body.has_given_motion for body in bodies),
            strict=True,
        )
        self.bodies = tuple(bodies)
        self.parts = [Part(*place) for place in places]
        self.noisy = {
            number: (part, part.body.noise)
            for number, part in enumerate(self.parts)
            if part.body.noise
        }
        self.count = sum(sizes)

        def at_points(values: Iterable[Any]) -> np.ndarray:
            return np.repeat(list(values), sizes)

        self.has_force = at_points(body.has_force for body in bodies)
        self.has_torque = at_points(body.has_torque for body in bodies)
        self.has_spin = at_points(body.has_spin for body in bodies)
        self.numbers = at_points(range(len(bodies)))
        self.given = np.flatnonzero(at_points(body.has_given_motion for body in bodies))
        self.forced = np.flatnonzero(self.has_force)
        self.width = 6 if self.has_torque.any() or self.has_spin.any() else 3

    def part(self, body: Body) -> Part:
        """Return where a body lives."""
        return next(part for part in self.parts if part.body is body)

    @property
    def forced_names(self) -> list[str]:
        """Names of the bodies that put forces on the fluid."""
        return [body.name for body in self.bodies if body.has_force]

    def forced_part(self, role: str, name: str) -> tuple[Part, slice]:
        """Return the body of a name, and which of the points `forced` are its own.

        Raises
        ------
        ValueError
            If it is no body that puts forces on the fluid; `role` is the argument that names it.
        """
        check.one_of(role, name, self.forced_names)
        part = next(part for part in self.parts if part.body.name == name)
        first = int(np.searchsorted(self.forced, part.points.start))
        return part, slice(first, first + part.points.stop - part.points.start)

    def point_count(self, body: Body) -> int:
        """Return how many points a body has."""
        points = self.part(body).points
        return points.stop - points.start

    def epsilons(self, default: float | None) -> np.ndarray:
        """Return the blob sizes, (N,), by default the fluid's; 1 where none is used.

        Raises
        ------
        ValueError
            If neither the fluid nor the body sets one.

        Warns
        -----
        UserWarning
            If there are more than sixteen sizes, since each costs a sum.
        """
        epsilons = np.concatenate([self._epsilons(body, default) for body in self.bodies])
        sizes = len(np.unique(epsilons[self.has_force]))
        if sizes > _MANY:
            warnings.warn(
                f"epsilon has {sizes} different values in this scene, and each costs a sum of its "
                "own; a few are faster, as those of mrs.Taper(..., steps=8) along a rod",
                stacklevel=4,
            )
        return epsilons

    def _epsilons(self, body: Body, default: float | None) -> np.ndarray:
        if not body.has_force:
            return np.ones(self.point_count(body))
        if default is not None:
            return body.epsilons(default)
        epsilons = body.epsilons(np.nan)
        if np.isnan(epsilons).any():
            raise ValueError(f"epsilon must be set, by the fluid or by {body.name!r}")
        return epsilons

    def points(self, time: float, state: State) -> np.ndarray:
        """Return where forces act and velocities are wanted, (N, 3)."""
        return np.concatenate([part.body.points(time, part.state(state)) for part in self.parts])

    def given_motion(self, time: float, state: State) -> GivenMotion:
        """Return the motion of the points `given`; frames are numbered through all bodies."""
        return joined(
            [
                part.body.given_motion(time, part.state(state))
                for part in self.parts
                if part.body.has_given_motion
            ]
        )

    def mounted(self, time: float, state: State) -> list[Mounted]:
        """Return the points that are fixed to other bodies; rows and frames are those of all."""
        found = []
        for part in self.parts:
            own = part.body.mounted(time, part.state(state))
            if own is not None:
                frames = self._holder(part.body, own.body).frames
                count = frames.stop - frames.start
                if own.number.max(initial=0) >= count:
                    raise ValueError(
                        f"base of {part.body.name!r}: number must be less than {count}, the bodies "
                        f"of {own.body!r}, got {own.number.max()}"
                    )
                rows, number = own.rows + part.points.start, own.number + frames.start
                found.append(own._replace(rows=rows, number=number))
        return found

    def _holder(self, of: Body, name: str) -> Part:
        """Return the body of a name, to which the base of a body is fixed."""
        for part in self.parts:
            if part.body.has_given_motion and part.body.name == name:
                return part
        raise ValueError(
            f"base of {of.name!r} must be fixed to a Rigid or Prescribed body of the scene, got "
            f"{name!r}"
        )

    def loads(self, time: float, state: State) -> np.ndarray:
        """Return the forces, and torques, of the bodies on the fluid, (N, width).

        They are zero at the points `given`.
        """
        loads = np.zeros((self.count, self.width))
        for part in self.parts:
            if part.body.has_force and not part.body.has_given_motion:
                force, torque = part.body.loads(time, part.state(state))
                own = loads[part.points]
                _require_shape(part.body, "forces of loads", force, (len(own), 3))
                own[:, :3] = force
                if torque is not None:
                    _require_shape(part.body, "torques of loads", torque, (len(own), 3))
                    own[:, 3:] = torque
        return loads

    def rates(
        self, time: float, state: State, motion: np.ndarray, frames: np.ndarray
    ) -> np.ndarray:
        """Return the rates of positions and triads, (P + Q, 3), for a motion of the points.

        `frames` is the motion of those of bodies whose motion is given, (k, 6).
        """
        velocities, spins = [], []
        for part in self.parts:
            if part.body.has_given_motion:
                own = frames[part.frames]
                velocities.append(own[:, :3])
                spins.append(own[:, 3:])
                continue
            own = motion[part.points]
            spin = own[:, 3:] if part.body.has_spin else None
            moved = part.state(state)
            velocity, turning = part.body.rates(time, moved, own[:, :3], spin)
            _require_shape(part.body, "velocities of rates", velocity, moved.positions.shape)
            count = len(moved.quaternions)
            _require_shape(part.body, "angular velocities of rates", turning, (count, 3))
            velocities.append(velocity)
            spins.append(turning)
        return np.concatenate([*velocities, *spins])

    def longest_step(self, length: float) -> float:
        """Return the longest step that resolves the noise, in flows that change over a length."""
        steps = (noise.longest_step(length) for _, noise in self.noisy.values())
        return min(steps, default=np.inf)

    def kicked(
        self,
        time: float,
        state: State,
        h: float,
        step: int,
        outside: Callable[[np.ndarray], np.ndarray],
    ) -> State:
        """Return the state after the random motion in a step of size h that ends, with its number.

        `outside` gives the rows of points that are not in the fluid. A piece of which a point would
        be there stays as it is. Random numbers depend on the seed and the place of a body and on
        the number of the step: there is no state of a generator to be kept.
        """
        if not self.noisy:
            return state
        positions, quaternions = state.positions.copy(), state.quaternions.copy()
        for number, (part, noise) in self.noisy.items():
            bits = np.random.Philox(key=noise.seed + (number << 64), counter=step << 192)
            moved = noise.kicked(part.state(state), h, np.random.Generator(bits))
            free = ~_pieces_with(part.body, outside(part.body.points(time, moved)))
            turning = free[: len(moved.quaternions)]
            positions[part.positions][free] = moved.positions[free]
            quaternions[part.quaternions][turning] = moved.quaternions[turning]
        return State(positions, quaternions)

    @cached_property
    def initial_points(self) -> np.ndarray:
        """Points of all bodies at time zero, (N, 3)."""
        return self.points(0.0, self.initial)

    @cached_property
    def contact_labels(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Connected pieces of all forced points, places along them, and rounds of closed ones.

        As `Body.contact_labels` returns them, with pieces numbered through all bodies.
        """
        labels, before = [], 0
        for body in self.bodies:
            if body.has_force:
                piece, place, length = body.contact_labels()
                labels.append((piece + before, place, length))
                before += int(piece.max(initial=-1)) + 1
        if not labels:
            return np.empty(0, int), np.empty(0), np.empty(0)
        pieces, places, rounds = (np.concatenate(column) for column in zip(*labels, strict=True))
        return pieces, places, rounds

    def length_scales(self) -> np.ndarray:
        """Return the length against which errors of each position are judged, (P,).

        Points without a length of their own take the smallest of the others'; in a scene without
        any length it is 0.
        """
        known = [body.length_scale for body in self.bodies if body.length_scale > 0.0]
        least = min(known, default=0.0)
        lengths = [np.full(len(b.positions), b.length_scale or least) for b in self.bodies]
        return np.concatenate(lengths)

    def point_name(self, row: int) -> str:
        """Name a point for a message."""
        part = next(part for part in self.parts if part.points.start <= row < part.points.stop)
        return f"node {row - part.points.start} of {part.body.name!r}"

    def coordinate_name(self, row: int) -> str:
        """Name a row of the coordinates, (P + Q, 3), for a message."""
        count = len(self.initial.positions)
        for part in self.parts:
            if row < count and part.positions.start <= row < part.positions.stop:
                return f"the position of node {row - part.positions.start} of {part.body.name!r}"
            turn = row - count
            if part.quaternions.start <= turn < part.quaternions.stop:
                return f"the triad of node {turn - part.quaternions.start} of {part.body.name!r}"
        raise IndexError(row)


def _require_shape(body: Body, what: str, array: np.ndarray, *shapes: tuple[int, ...]) -> None:
    """Refuse an array of a user's body, which would be stretched to fit or shift the others'."""
    if np.shape(array) not in shapes:
        allowed = " or ".join(map(str, shapes))
        raise ValueError(
            f"{what} of {body.name!r} must have shape {allowed}, got shape {np.shape(array)}"
        )


def _pieces_with(body: Body, rows: np.ndarray) -> np.ndarray:
    """Return of each position whether one of some points, in rows, is of its piece, (n,)."""
    return np.isin(body.pieces(), body.contact_labels()[0][rows])


def _slices(sizes: Iterable[int]) -> list[slice]:
    ends = np.cumsum([0, *sizes])
    return [slice(int(a), int(b)) for a, b in pairwise(ends)]
