"""Paired-particle swimmers: a body and a phantom flagellum, rigidly linked.

Relatives: Hernandez-Ortiz, Stoltz & Graham (2005), Saintillan & Shelley (2007), Hoover, Boindala &
Cortez (2025). Two free particles with opposite forces would not swim: the pair would stretch or
collapse.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
import scipy
from numpy.typing import ArrayLike

from mrs import check, rotations
from mrs.bodies import geometry
from mrs.bodies.base import Body
from mrs.bodies.noise import Noise
from mrs.time.state import Arrays, State

_AXIS = np.array([[0.0, 0.0, 1.0]])


@check.spelling
class Swimmers(Body):
    """Swimmers that push or pull themselves along their orientation p.

    Parameters
    ----------
    positions : (n, 3) array_like
        Of the bodies, x_B.
    orientations : (n, 3) array_like
        Directions p in which they swim; scaled to unit length.
    length : float or array_like
        Distance l from body to flagellum, a number or (n,).
    force : float or array_like
        Thrust f, a number or (n,): +f p on the fluid at the body, -f p at the flagellum.
    stroke : {"pusher", "puller"}, optional
        Whether the flagellum is behind the body, x_F = x_B - l p, or before it.
    epsilon, flagellum_epsilon : float or array_like, optional
        Blob sizes of body and flagellum, a number or (n,). By default the fluid's for the body, and
        the body's for the flagellum.
    radius : float or array_like, optional
        Of the beads in pictures, a number or (n,); their epsilon by default.
    tumble_rate, tumble_angle, rotational_diffusivity, diffusivity : float or array_like, optional
        Of their random motion, a number or (n,), as for `mrs.bodies.Noise`. A direction turns about
        the body, and tumbles to a direction that is uniform over the sphere by default.
    seed : int, optional
        Of the random motion.
    name : str, optional
        Of the output file.

    Notes
    -----
    With d from flagellum to body, dx_B/dt = u(x_B) and
    dd/dt = (I - d d^T)(u(x_B) - u(x_F)) / l, with u due to all particles and the background.
    Alone, a swimmer moves at f / (4 pi mu) (1/eps_B - 1/sqrt(l^2 + eps_F^2)) along p.

    Examples
    --------
    >>> import mrs
    >>> pusher = mrs.Swimmers([[0, 0, 0]], [[0, 0, 1]], length=1.0, force=1.0, epsilon=0.1)
    >>> sim = mrs.Simulation(mrs.Fluid(viscosity=1.0), [pusher])
    >>> print(round(sim.now.rates[0, 2], 4))  # (1/0.1 - 1/sqrt(1.01)) / (4 pi)
    0.7166
    """

    kind = "swimmers"

    def __init__(
        self,
        positions: ArrayLike,
        orientations: ArrayLike,
        *,
        length: ArrayLike,
        force: ArrayLike,
        stroke: Literal["pusher", "puller"] = "pusher",
        epsilon: ArrayLike | None = None,
        flagellum_epsilon: ArrayLike | None = None,
        radius: ArrayLike | None = None,
        tumble_rate: ArrayLike = 0.0,
        tumble_angle: ArrayLike | None = None,
        rotational_diffusivity: ArrayLike = 0.0,
        diffusivity: ArrayLike = 0.0,
        seed: int = 0,
        name: str = "swimmers",
    ) -> None:
        self.made_with = {k: v for k, v in locals().items() if k != "self"}
        self.name = check.file_name("name", name)
        self.positions = check.points("positions", positions)
        count = len(self.positions)
        along = check.rows("orientations", orientations, 3, count)
        if not np.linalg.norm(along, axis=1).all():
            raise ValueError("orientations must not be zero")
        self.quaternions = _orient(along)
        self.sign = {"pusher": 1.0, "puller": -1.0}[
            check.one_of("stroke", stroke, ("pusher", "puller"))
        ]
        self.length = check.broadcast("length", length, (count,), 0.0)[:, None]
        self.force = check.broadcast("force", force, (count,))[:, None]
        self._epsilon = (
            None if epsilon is None else check.broadcast("epsilon", epsilon, (count,), 0.0)
        )
        self._flagellum_epsilon = (
            self._epsilon
            if flagellum_epsilon is None
            else check.broadcast("flagellum_epsilon", flagellum_epsilon, (count,), 0.0)
        )
        self.radius = None if radius is None else check.broadcast("radius", radius, (count,), 0.0)
        self.length_scale = float(self.length.max(initial=0.0))
        self.noise = Noise(
            count,
            diffusivity=diffusivity,
            rotational_diffusivity=rotational_diffusivity,
            tumble_rate=tumble_rate,
            tumble_angle=tumble_angle,
            seed=seed,
        )

    def orientations(self, quaternions: np.ndarray) -> np.ndarray:
        """Return the directions p, (n, 3)."""
        return rotations.rotate(quaternions, _AXIS)

    def points(self, time: float, state: State) -> np.ndarray:
        """Return bodies, then flagella, (2 n, 3)."""
        arm = self.sign * self.length * self.orientations(state.quaternions)
        return np.concatenate([state.positions, state.positions - arm])

    def loads(self, time: float, state: State) -> tuple[np.ndarray, None]:
        """Return the pairs of opposite forces, (2 n, 3), and no torques."""
        thrust = self.force * self.orientations(state.quaternions)
        return np.concatenate([thrust, -thrust]), None

    def rates(
        self,
        time: float,
        state: State,
        velocity: np.ndarray,
        spin: np.ndarray | None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the bodies' velocities, and the angular velocities p x (u_B - u_F) / (sigma l)."""
        body, flagellum = np.split(velocity, 2)
        arm = self.sign * self.orientations(state.quaternions)
        return body, rotations.cross(arm, (body - flagellum) / self.length)

    def epsilons(self, default: float) -> np.ndarray:
        """Return the blob sizes of bodies, then flagella, (2 n,)."""
        count = len(self.positions)
        own = np.full(count, default) if self._epsilon is None else self._epsilon
        other = own if self._flagellum_epsilon is None else self._flagellum_epsilon
        return np.concatenate([own, other])

    def pieces(self) -> np.ndarray:
        """Return the swimmers' numbers, (n,)."""
        return np.arange(len(self.positions))

    def contact_labels(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the swimmers' numbers; the two particles of one do not touch each other."""
        count = len(self.positions)
        return np.tile(np.arange(count), 2), np.zeros(2 * count), np.full(2 * count, np.inf)

    def topology(self) -> tuple[np.ndarray, list[np.ndarray]]:
        """Return both particles as vertices, and a line from body to flagellum."""
        count = len(self.positions)
        return np.arange(2 * count), [np.array([i, i + count]) for i in range(count)]

    def constant_fields(self, epsilons: np.ndarray) -> tuple[Arrays, Arrays]:
        """Return radius, which of the two (0 body, 1 flagellum) and the swimmer at points."""
        count = len(self.positions)
        numbers = np.tile(np.arange(count), 2)
        radius = epsilons if self.radius is None else np.tile(self.radius, 2)
        at_points = {"bead": np.repeat([0, 1], count), "swimmer_id": numbers, "radius": radius}
        return at_points, {"swimmer_id": np.concatenate([numbers, np.arange(count)])}

    def fields(self, time: float, state: State, **at_points: Any) -> tuple[Arrays, Arrays]:
        """Return orientation, velocity and force at points."""
        fields = {"orientation": np.tile(self.orientations(state.quaternions), (2, 1))}
        return fields | {k: at_points[k] for k in ("velocity", "force")}, {}


def _orient(along: np.ndarray) -> np.ndarray:
    """Return quaternions that take z to each of `along`, (n, 4)."""
    unit = along / np.linalg.norm(along, axis=1)[:, None]
    down = unit[:, 2] < -0.5  # the shortest rotation from z is not defined at -z: go by way of x
    about_x = np.array([1.0, 0.0, 0.0, 0.0])
    start = np.where(down[:, None], -_AXIS, _AXIS)
    turn = rotations.between(start, unit)
    return np.where(down[:, None], rotations.multiply(turn, about_x), turn)


@check.spelling
def random_suspension(
    count: int,
    size: ArrayLike,
    spacing: float,
    *,
    reach: float = 0.0,
    seed: int = 0,
    periodic: bool = False,
) -> tuple[np.ndarray, np.ndarray]:
    """Return random positions and orientations in a box, no two bodies closer than `spacing`.

    Parameters
    ----------
    count : int
    size : float or (3,) array_like
        Edges of the box, centred at the origin.
    spacing : float
        Least distance of any two of the particles, bodies and flagella.
    reach : float, optional
        Where the flagellum is: at ``x_B - reach p`` (length for pushers, -length for pullers).
        0 leaves flagella out of the test.
    seed : int, optional
    periodic : bool, optional
        Whether the box repeats itself, so that the images of particles keep the distance as well.

    Raises
    ------
    ValueError
        If that many do not fit, after as many draws as make it certain in practice.

    Examples
    --------
    >>> import mrs
    >>> from scipy.spatial.distance import pdist
    >>> positions, orientations = mrs.random_suspension(20, size=4.0, spacing=0.5)
    >>> positions.shape, bool(pdist(positions).min() >= 0.5)
    ((20, 3), True)
    """
    check.integer("count", count, 0)
    edges = check.broadcast("size", size, (3,), 0.0)
    spacing = check.not_negative("spacing", spacing)
    reach = check.number("reach", reach, -1e60, 1e60)
    check.flag("periodic", periodic)
    if count * spacing**3 * np.pi / 6.0 > 0.64 * edges.prod():  # random close packing
        raise ValueError(
            f"count: {count} swimmers {spacing:g} apart do not fit a box of size {size!r}"
        )
    rng = np.random.default_rng(seed)
    positions, along = np.empty((0, 3)), np.empty((0, 3))
    for _ in range(200):
        missing = count - len(positions)
        if not missing:
            return positions, along
        positions = np.concatenate([positions, (rng.random((missing, 3)) - 0.5) * edges])
        along = np.concatenate([along, _random_directions(missing, rng)])
        keep = _apart(positions, positions - reach * along, spacing, edges if periodic else None)
        positions, along = positions[keep], along[keep]
    raise ValueError(
        f"count: {count} swimmers at least {spacing:g} apart do not fit a box of size {size!r}; "
        f"{len(positions)} did"
    )


def _apart(
    bodies: np.ndarray, flagella: np.ndarray, spacing: float, box: np.ndarray | None
) -> np.ndarray:
    """Return which swimmers to keep: of two that overlap, the earlier one."""
    count = len(bodies)
    points = np.concatenate([bodies, flagella])
    if box is not None:
        points = points % box
    tree = scipy.spatial.cKDTree(points, boxsize=box)
    pairs = tree.query_pairs(spacing, output_type="ndarray")
    pairs = np.sort(pairs % count, axis=1)
    keep = np.ones(count, bool)
    keep[pairs[pairs[:, 0] != pairs[:, 1]][:, 1]] = False
    return keep


def _random_directions(count: int, rng: np.random.Generator) -> np.ndarray:
    """Return unit vectors, uniform over the sphere, (count, 3)."""
    return scipy.spatial.transform.Rotation.random(count, rng).apply(_AXIS[0]).reshape(-1, 3)


@check.spelling
def lattice_suspension(
    shape: Sequence[int], spacing: float, *, direction: ArrayLike | None = None, seed: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Return positions on a cubic lattice centred at the origin, with orientations.

    Parameters
    ----------
    shape : (3,) of int
        Swimmers along x, y and z.
    spacing : float
        Of the lattice.
    direction : (3,) array_like, optional
        Of all of them; random by default.
    seed : int, optional
        Of random directions.

    Examples
    --------
    >>> import mrs
    >>> positions, orientations = mrs.lattice_suspension((2, 1, 1), 3.0, direction=(0, 0, 2))
    >>> print(positions)
    [[-1.5  0.   0. ]
     [ 1.5  0.   0. ]]
    >>> print(orientations)
    [[0. 0. 1.]
     [0. 0. 1.]]
    """
    positions = geometry.grid(shape, spacing)
    if direction is None:
        rng = np.random.default_rng(seed)
        return positions, _random_directions(len(positions), rng)
    return positions, np.tile(check.direction("direction", direction), (len(positions), 1))
