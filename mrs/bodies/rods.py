"""Kirchhoff rods in a viscous fluid: Olson, Lim & Cortez (2013), "OLC"; Lim et al. (2008)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from mrs import check, rotations
from mrs.bodies.along import Along, FunctionOfS
from mrs.bodies.base import Body
from mrs.bodies.drive import Drive, Mount
from mrs.bodies.geometry import Centerline
from mrs.rigid_motion import Mounted
from mrs.stiffness import Stiffness, assembled
from mrs.time.state import Arrays, State

Strain = Callable[[np.ndarray, np.ndarray], Any]

_SMALL = 1e-5  # radians, and parts of a segment: steps of central differences


class Elasticity(NamedTuple):
    """Internal state of the segments, halfway between nodes."""

    quaternions: np.ndarray
    """Triads D^{k+1/2}, (segments, 4)."""
    steps: np.ndarray
    """X_{k+1} - X_k, (segments, 3)."""
    strain: np.ndarray
    """Curvatures about D1, D2 and twist, in the triad's axes, (segments, 3)."""
    strain_excess: np.ndarray
    """Strain less the intrinsic one, (segments, 3)."""
    shift: np.ndarray
    """D_i . X_s - delta_i3: shear along D1 and D2, stretch along D3, (segments, 3)."""


@check.spelling
class Rods(Body):
    """Elastic rods, many at once; each may differ from the others.

    Parameters
    ----------
    centerlines : Centerline or sequence of Centerline
        Shapes at time zero (`mrs.geometry`). A segment's rest length is its present one, along D3.
    bending : float, array_like or callable
        Moduli a1, a2 (force times length squared). A number is both moduli everywhere; (rods,) and
        (segments,) have one number for both moduli of each rod, or of each segment of all rods;
        rows [a1, a2], (1, 2), (rods, 2) or (segments, 2), have a number for each modulus. Shape
        (2,) is refused, since it could be meant either way. A function of s, for example a
        `Taper`, is given the arclengths of the segments' middles from the first node of their rod,
        (segments,), and returns a number, (segments,) or (segments, 2).
    twisting : float, array_like or callable
        Modulus a3: a number, (rods,), (segments,), or a function of s that returns (segments,).
    shearing : float, array_like or callable
        Moduli b1, b2 (force), as `bending`.
    stretching : float, array_like or callable
        Modulus b3, as `twisting`.
    intrinsic_curvature : "initial", array_like or callable, optional
        The strain (Omega_1, Omega_2, Omega_3) at which the rods are free of moments: two
        curvatures and a twist, radians per length. "initial" is the centrelines' own; else (3,)
        for all segments, (segments, 3), or a function of (s, t), both (segments,): arclength of the
        segments' middles from the first node of their rod, and the rod's own time.
    beat : callable, optional
        A function of (s, t) as above that is added, for example a `TravellingWave`.
    delay : float or array_like, optional
        Lag of each rod's own time behind the time of the run, a number or (rods,): phases of
        metachronal waves. Refused where nothing depends on the rods' own time.
    base : {"free", "clamped"}, Drive or Mount, optional
        Motion of the first node and its triad. A base that is held or driven hands its load to its
        holder, not to the fluid; with a `Mount` the holder is another body.
    epsilon : float, array_like or callable, optional
        Blob size; the fluid's by default. A number, (rods,), one for each node of all rods,
        (nodes,), or a function of s that returns (nodes,). Each different size costs a sum: a
        `Taper` with `steps` has few.
    radius : float, array_like or callable, optional
        Of the rods in pictures, as `epsilon`; epsilon / sqrt(e) by default, which gives a rod of
        that radius its drag.
    name : str, optional
        Of the output file.

    Raises
    ------
    ValueError, TypeError
        The message names the argument and the allowed values.

    Notes
    -----
    With F_i = b_i (D_i . X_s - delta_i3) and N_i = a_i (Omega_i - O_i) halfway between nodes (OLC
    eqs. 8-9 on a staggered grid), node k puts on the fluid the force
    F_{k+1/2} - F_{k-1/2} and the torque N_{k+1/2} - N_{k-1/2} + (DX x F)_{k+1/2} / 2 + (DX x
    F)_{k-1/2} / 2. Beyond open ends F and N vanish. With q the rotation from one triad to the next,
    the discrete strain D2_s . D3, D3_s . D1, D1_s . D2 is exactly 2 Im(q) / ds.

    Examples
    --------
    >>> import mrs
    >>> ring = mrs.Rods(
    ...     mrs.geometry.ring(radius=2.0, nodes=100),
    ...     bending=1.0, twisting=1.0, shearing=100.0, stretching=100.0,
    ...     intrinsic_curvature=(0.0, 0.0, 0.0),  # a straight rod, bent
    ... )
    >>> sim = mrs.Simulation(mrs.Fluid(epsilon=0.1), [ring])
    >>> print(round(sim.energy(), 3))  # pi bending / radius
    1.571
    """

    kind = "rods"
    is_stiff = True
    has_torque = True
    has_spin = True

    def __init__(
        self,
        centerlines: Centerline | Sequence[Centerline],
        *,
        bending: ArrayLike | FunctionOfS,
        twisting: ArrayLike | FunctionOfS,
        shearing: ArrayLike | FunctionOfS,
        stretching: ArrayLike | FunctionOfS,
        intrinsic_curvature: ArrayLike | Strain = "initial",
        beat: Strain | None = None,
        delay: ArrayLike = 0.0,
        base: Literal["free", "clamped"] | Drive | Mount = "free",
        epsilon: ArrayLike | FunctionOfS | None = None,
        radius: ArrayLike | FunctionOfS | None = None,
        name: str = "rods",
    ) -> None:
        self.made_with = {k: v for k, v in locals().items() if k != "self"}
        rods = [centerlines] if isinstance(centerlines, Centerline) else list(centerlines)
        if not rods or not all(isinstance(rod, Centerline) for rod in rods):
            raise TypeError(
                f"centerlines must be one or more mrs.geometry.Centerline, got {centerlines!r}"
            )
        self.name = check.file_name("name", name)
        places, triads = zip(*(_checked(rod, i) for i, rod in enumerate(rods)), strict=True)
        self.positions = np.concatenate(places)
        self.quaternions = rotations.normalize(np.concatenate(triads))
        self.base = (
            base
            if isinstance(base, (Drive, Mount))
            else check.one_of("base", base, ("free", "clamped"))
        )
        self._connect(rods)
        self._measure()
        segments = Along("segment", self.rod_of_segment, self._middles)
        self._moduli = np.column_stack(
            [segments.pairs("bending", bending), segments.numbers("twisting", twisting)]
        )
        self._stiffness = np.column_stack(
            [segments.pairs("shearing", shearing), segments.numbers("stretching", stretching)]
        )
        self._delay = check.broadcast("delay", delay, (len(rods),))
        self._set_intrinsic(intrinsic_curvature, beat)
        if isinstance(self.base, Drive):
            for what in ("velocity", "angular_velocity"):
                self._at_bases(what, 0.0)
        self.mounted(0.0, State(self.positions, self.quaternions))  # refuses bad numbers
        self._require_own_time(delay)
        nodes = Along("node", self.rod_of_node, self.arclength)
        self.epsilon = None if epsilon is None else nodes.numbers("epsilon", epsilon)
        self.radius = None if radius is None else nodes.numbers("radius", radius)

    def _connect(self, rods: Sequence[Centerline]) -> None:
        """Number nodes and segments."""
        sizes = np.array([len(rod.nodes) for rod in rods])
        self.first = np.concatenate([[0], np.cumsum(sizes)[:-1]])
        last = self.first + sizes - 1
        self.closed = np.array([rod.closed for rod in rods])
        if self.base != "free" and self.closed.any():
            raise ValueError("base must be 'free' for closed rods, which have no end")
        if (sizes < 2 + self.closed).any():
            raise ValueError("centerlines must have at least 2 nodes, 3 if closed")
        self.rod_of_node = np.repeat(np.arange(len(rods)), sizes)
        ends = np.isin(np.arange(sizes.sum()), last)
        self._left = np.flatnonzero(~ends | self.closed[self.rod_of_node])
        self._right = self._left + 1
        wraps = ends[self._left]
        self._right[wraps] = self.first[self.closed]
        self.rod_of_segment = self.rod_of_node[self._left]

    def _measure(self) -> None:
        """Take rest lengths and arclengths from the shapes at time zero."""
        start, end, steps = self._ends(State(self.positions, self.quaternions))
        between, middle = _halfway(start, end)
        along = rotations.rotate(middle, np.array([[0.0, 0.0, 1.0]]))
        self.spacing = np.einsum("ni,ni->n", along, steps)
        if (self.spacing <= 0.0).any():
            worst = int(np.argmin(self.spacing))
            raise ValueError(
                f"centerlines: rod {self.rod_of_segment[worst]} has a segment, after node "
                f"{self._left[worst] - self.first[self.rod_of_segment[worst]]}, that does not run "
                "along its D3; nodes must differ and triads follow the rod"
            )
        self._initial_strain = 2.0 * between[:, :3] / self.spacing[:, None]
        ends = np.zeros(len(self.positions))
        ends[self._left] = self.spacing
        total = np.cumsum(ends) - ends
        self.arclength = total - total[self.first][self.rod_of_node]
        self._middles = self.arclength[self._left] + 0.5 * self.spacing
        self.lengths = np.bincount(self.rod_of_segment, self.spacing)
        self.length_scale = float(self.lengths.max())

    def _set_intrinsic(self, intrinsic: Any, beat: Strain | None) -> None:
        shape = (len(self.spacing), 3)
        if isinstance(intrinsic, str):
            check.one_of("intrinsic_curvature", intrinsic, ("initial",))
            intrinsic = self._initial_strain
        if not callable(intrinsic):
            given = check.shaped("intrinsic_curvature", intrinsic, (3,), shape)
            intrinsic = np.array(np.broadcast_to(given, shape))
        self._intrinsic = intrinsic
        self._beat = None if beat is None else check.function("beat", beat, "(s, t)")
        self.intrinsic_curvature(0.0)  # refuses bad results of the functions

    def intrinsic_curvature(self, time: float) -> np.ndarray:
        """Return the strain without moments, (segments, 3)."""
        if self._beat is None and not callable(self._intrinsic):
            return self._intrinsic
        s = self._middles
        t = (time - self._delay)[self.rod_of_segment]

        def where(row: int) -> str:
            rod = self.rod_of_segment[row]
            return f"for rod {rod} of {self.name!r} at s = {s[row]:g} and its own time {t[row]:g}"

        strain = self._intrinsic
        if callable(strain):
            strain = check.vectors("intrinsic_curvature", strain(s, t), len(s), where)
        if self._beat is not None:
            strain = strain + check.vectors("beat", self._beat(s, t), len(s), where)
        return strain

    def _require_own_time(self, delay: Any) -> None:
        """Refuse a delay that would change nothing."""
        timed = self._beat is not None or callable(self._intrinsic)
        if isinstance(self.base, Drive):
            timed = timed or self.base.depends_on_time
        if isinstance(self.base, Mount):
            timed = timed or callable(self.base.turning)
        if self._delay.any() and not timed:
            raise ValueError(
                "delay must be 0 where nothing depends on the rods' own time: there is no beat, "
                f"and neither intrinsic_curvature nor base is a function; got {delay!r}"
            )

    def elasticity(self, time: float, state: State) -> Elasticity:
        """Return strains halfway between the nodes."""
        return self._elasticity(*self._ends(state), self.intrinsic_curvature(time))

    def _elasticity(
        self, start: np.ndarray, end: np.ndarray, steps: np.ndarray, intrinsic: np.ndarray
    ) -> Elasticity:
        """Return strains for triads at the ends of the segments, and steps along them."""
        between, middle = _halfway(start, end)
        spacing = self.spacing[:, None]
        strain = 2.0 * between[:, :3] / spacing
        shift = rotations.rotate(rotations.conjugate(middle), steps) / spacing
        shift[:, 2] -= 1.0
        return Elasticity(middle, steps, strain, strain - intrinsic, shift)

    def _ends(self, state: State) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the triads at the starts and ends of the segments, and steps along them."""
        triads, places = state.quaternions, state.positions
        steps = places[self._right] - places[self._left]
        return triads[self._left], triads[self._right], steps

    def loads(self, time: float, state: State) -> tuple[np.ndarray, np.ndarray]:
        """Return the forces and torques of the nodes on the fluid, (nodes, 3) each."""
        force, torque = self._node_loads(time, state)
        if self.base != "free":
            force[self.first] = 0.0
            torque[self.first] = 0.0
        return force, torque

    def mounted(self, time: float, state: State) -> Mounted | None:
        """Return the first nodes if they are fixed to another body."""
        if not isinstance(self.base, Mount):
            return None
        count, times = len(self.first), time - self._delay
        drive, name = Drive(angular_velocity=self.base.turning), f"rod {{}} of {self.name!r}"
        turning = drive.at("angular_velocity", times, "base", name)
        loads = np.hstack([load[self.first] for load in self._node_loads(time, state)])
        return Mounted(self.first, self.base.body, self.base.numbers(count), loads, turning)

    def base_force(self, time: float, state: State) -> np.ndarray:
        """Return the forces of the rods on whatever holds their first nodes, (rods, 3)."""
        if self.base == "free":
            return np.zeros((len(self.first), 3))
        return self._node_loads(time, state)[0][self.first]

    def _node_loads(self, time: float, state: State) -> tuple[np.ndarray, np.ndarray]:
        internal_force, couple, moment = self._internal(self.elasticity(time, state))
        force, torque = np.zeros_like(state.positions), np.zeros_like(state.positions)
        # A node is left end of one segment at most, and right end of one.
        force[self._left] += internal_force
        force[self._right] -= internal_force
        torque[self._left] += couple + moment
        torque[self._right] += couple - moment
        return force, torque

    def _internal(self, inside: Elasticity) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the forces and moments halfway between nodes, and half the couples of forces."""
        force = rotations.rotate(inside.quaternions, self._stiffness * inside.shift)
        moment = rotations.rotate(inside.quaternions, self._moduli * inside.strain_excess)
        return force, 0.5 * rotations.cross(inside.steps, force), moment

    def stiffness(self, time: float, state: State) -> Stiffness:
        """Return how the loads of the nodes change with positions and triads.

        By central differences for each segment, whose loads depend on its two ends alone.
        """
        start, end, steps = self._ends(state)
        intrinsic = self.intrinsic_curvature(time)
        shift = self._elasticity(start, end, steps, intrinsic).shift

        def loads(start: np.ndarray, end: np.ndarray, steps: np.ndarray) -> np.ndarray:
            inside = self._elasticity(start, end, steps, intrinsic)
            return np.hstack(self._internal(inside._replace(shift=inside.shift - shift)))

        columns = []
        for unit in _SMALL * np.eye(3):
            move, turn = unit * self.spacing[:, None], rotations.exponential(unit)
            back = rotations.conjugate(turn)
            change = loads(start, end, steps + move) - loads(start, end, steps - move)
            columns.append(change / self.spacing[:, None])
            starts = rotations.multiply(turn, start), rotations.multiply(back, start)
            columns.append(loads(starts[0], end, steps) - loads(starts[1], end, steps))
            ends = rotations.multiply(turn, end), rotations.multiply(back, end)
            columns.append(loads(start, ends[0], steps) - loads(start, ends[1], steps))
        by_step, by_start, by_end = (
            np.stack(columns[kind::3], axis=2) / (2.0 * _SMALL) for kind in range(3)
        )
        at_left, at_right = np.dstack([-by_step, by_start]), np.dstack([by_step, by_end])
        held = np.empty(0, int) if self.base == "free" else self.first
        one, none = np.eye(3), np.zeros((3, 3))
        on_left = np.block([[one, none, none], [none, one, one]])
        on_right = np.block([[-one, none, none], [none, one, -one]])
        left, right, count = self._left, self._right, len(self.positions)
        blocks = [on @ at for on in (on_left, on_right) for at in (at_left, at_right)]
        rows, others = np.concatenate([left, left, right, right]), np.tile([left, right], (2, 1))
        data = np.concatenate(blocks)
        data[np.isin(rows, held)] = 0.0
        return Stiffness(assembled(rows, others.ravel(), data, count), held, self.rod_of_node)

    def lengths_of_points(self) -> np.ndarray:
        """Return half the lengths of the segments that meet at each node, (nodes,)."""
        ends = np.concatenate([self._left, self._right])
        return np.bincount(ends, np.tile(0.5 * self.spacing, 2))

    def energy(self, time: float, state: State) -> float:
        """Return the elastic energy of all rods."""
        bending, stretching = self._energies(self.elasticity(time, state))
        return float(bending.sum() + stretching.sum())

    def _energies(self, inside: Elasticity) -> tuple[np.ndarray, np.ndarray]:
        """Return the energies of strain and of shift of each segment."""
        moments = np.einsum("ni,ni->n", self._moduli, inside.strain_excess**2)
        forces = np.einsum("ni,ni->n", self._stiffness, inside.shift**2)
        return 0.5 * self.spacing * moments, 0.5 * self.spacing * forces

    def rates(
        self,
        time: float,
        state: State,
        velocity: np.ndarray,
        spin: np.ndarray | None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the fluid's velocities, and at held bases the prescribed ones."""
        assert spin is not None
        if self.base == "clamped":
            velocity[self.first] = 0.0
            spin[self.first] = 0.0
        elif isinstance(self.base, Drive):
            velocity[self.first] = self._at_bases("velocity", time)
            spin[self.first] = self._at_bases("angular_velocity", time)
        return velocity, spin

    def _at_bases(self, what: str, time: float) -> np.ndarray:
        assert isinstance(self.base, Drive)
        return self.base.at(what, time - self._delay, "base", f"rod {{}} of {self.name!r}")

    def epsilons(self, default: float) -> np.ndarray:
        """Return the blob size at each node, (nodes,)."""
        return np.full(len(self.positions), default) if self.epsilon is None else self.epsilon

    def pieces(self) -> np.ndarray:
        """Return the rod of each node, (nodes,)."""
        return self.rod_of_node

    def contact_labels(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return rods, arclengths of the nodes, and the lengths of closed rods."""
        rounds = np.where(self.closed, self.lengths, np.inf)
        return self.rod_of_node, self.arclength, rounds[self.rod_of_node]

    def topology(self) -> tuple[np.ndarray, list[np.ndarray]]:
        """Return one polyline a rod; a closed one ends at its first node."""
        nodes = np.split(np.arange(len(self.positions)), self.first[1:])
        lines = [np.append(n, n[0]) if c else n for n, c in zip(nodes, self.closed, strict=True)]
        return np.empty(0, int), lines

    def constant_fields(self, epsilons: np.ndarray) -> tuple[Arrays, Arrays]:
        """Return radius and arclength at nodes, the rod's number at cells."""
        radius = epsilons / np.sqrt(np.e) if self.radius is None else self.radius
        at_points = {"arclength": self.arclength, "radius": radius}
        return at_points, {"rod_id": np.arange(len(self.first))}

    def fields(self, time: float, state: State, **at_points: Any) -> tuple[Arrays, Arrays]:
        """Return triads, loads, motion, curvature and tension at nodes, energy at rods."""
        inside = self.elasticity(time, state)
        triads = rotations.axes(state.quaternions)
        fields = {f"d{i + 1}": triads[:, i] for i in range(3)} | at_points
        fields["curvature"] = self._at_nodes(inside.strain)
        fields["tension"] = self._at_nodes(self._stiffness * inside.shift)[:, 2]
        bending, _ = self._energies(inside)
        return fields, {"bending_energy": np.bincount(self.rod_of_segment, bending)}

    def _at_nodes(self, values: np.ndarray) -> np.ndarray:
        """Return the mean over the segments that meet at each node."""
        total, count = np.zeros((len(self.positions), 3)), np.zeros((len(self.positions), 1))
        for side in (self._left, self._right):
            total[side] += values
            count[side] += 1.0
        return total / count


def _halfway(start: np.ndarray, end: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the rotations from triads to others, and the triads halfway."""
    between = rotations.relative(start, end)
    return between, rotations.multiply(start, rotations.halved(between))


def _checked(rod: Centerline, number: int) -> tuple[np.ndarray, np.ndarray]:
    """Return nodes and quaternions of a centreline."""
    name = f"centerlines[{number}]"
    nodes = check.points(f"{name}.nodes", rod.nodes)
    quaternions = check.rows(f"{name}.quaternions", rod.quaternions, 4, len(nodes))
    if not quaternions.any(axis=1).all():
        raise ValueError(f"{name}.quaternions must not be zero")
    return nodes, quaternions
