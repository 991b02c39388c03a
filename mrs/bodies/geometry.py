"""Centrelines of rods with their triads: straight, helix, ring, and shapes at rest."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, Literal, NamedTuple

import numpy as np
import scipy
from numpy.typing import ArrayLike

from mrs import check, rotations

Grading = Literal["uniform", "cosine"] | Callable[[np.ndarray], Any]


class Centerline(NamedTuple):
    """Nodes of one rod and their triads, of which D3 points along the rod.

    Examples
    --------
    >>> import mrs
    >>> line = mrs.geometry.straight(1.0, nodes=3).moved((0.0, 0.0, 5.0))
    >>> print(line.nodes)
    [[0.  0.  5. ]
     [0.  0.  5.5]
     [0.  0.  6. ]]
    """

    nodes: np.ndarray
    """Positions, (M, 3)."""
    quaternions: np.ndarray
    """Triads, (M, 4), stored (x, y, z, w)."""
    closed: bool = False
    """Whether a last segment joins the last node to the first."""

    def moved(
        self,
        shift: ArrayLike = (0.0, 0.0, 0.0),
        rotation: scipy.spatial.transform.Rotation | None = None,
    ) -> Centerline:
        """Return a copy, turned about the origin by `rotation` (scipy's), then shifted."""
        turn = one_rotation(rotation)
        quaternions = rotations.multiply(turn.as_quat(), self.quaternions)
        return Centerline(
            turn.apply(self.nodes) + check.vector("shift", shift), quaternions, self.closed
        )


@check.spelling
def straight(
    length: float,
    nodes: int,
    *,
    grading: Grading = "uniform",
    origin: ArrayLike = (0, 0, 0),
    direction: ArrayLike = (0, 0, 1),
) -> Centerline:
    """Return a straight rod of `nodes` nodes from `origin` along `direction`.

    Parameters
    ----------
    length : float
    nodes : int
    grading : {"uniform", "cosine"} or callable, optional
        Where the nodes are. "cosine" has short segments at both ends, where loads change fastest:
        the last one is about ``pi^2 / (4 nodes)`` of the mean. A function takes equally spaced
        numbers from 0 to 1, (nodes,), and returns shares of the length that rise from 0 to 1.
    origin, direction : (3,) array_like, optional

    Examples
    --------
    >>> import mrs
    >>> print(mrs.geometry.straight(2.0, nodes=3, direction=(1, 0, 0)).nodes.round(6) + 0.0)
    [[0. 0. 0.]
     [1. 0. 0.]
     [2. 0. 0.]]
    """
    check.positive("length", length)
    check.vector("origin", origin)
    line = length * _shares(nodes, grading)[:, None] * np.array([0.0, 0.0, 1.0])
    triads = np.tile(rotations.IDENTITY, (nodes, 1))
    return Centerline(line, triads).moved(origin, _turn_from_z(direction))


@check.spelling
def helix(
    radius: float,
    pitch: float,
    length: float,
    nodes: int,
    *,
    grading: Grading = "uniform",
    handedness: Literal["right", "left"] = "right",
    phase: float = 0.0,
    origin: ArrayLike = (0, 0, 0),
    direction: ArrayLike = (0, 0, 1),
) -> Centerline:
    """Return a helix, (R cos kz, R sin kz, z) with k = 2 pi / pitch for direction z (K 8.2).

    Parameters
    ----------
    radius, pitch, length : float
        Of the helix; `length` is along its axis.
    nodes : int
        Ends included.
    grading : {"uniform", "cosine"} or callable, optional
        Where the nodes are, as for `straight`.
    handedness : {"right", "left"}, optional
    phase : float, optional
        Angle of the first node about the axis, radians.
    origin : (3,) array_like, optional
        Where the axis begins.
    direction : (3,) array_like, optional
        Of the axis.

    Examples
    --------
    >>> import mrs
    >>> import numpy as np
    >>> line = mrs.geometry.helix(radius=0.5, pitch=2.0, length=4.0, nodes=81)
    >>> print(np.linalg.norm(line.nodes[:, :2], axis=1).round(6)[[0, 40, 80]], line.nodes[-1, 2])
    [0.5 0.5 0.5] 4.0
    """
    check.positive("radius", radius)
    check.positive("pitch", pitch)
    check.positive("length", length)
    check.one_of("handedness", handedness, ("right", "left"))
    check.number("phase", phase, -np.inf, np.inf)
    check.vector("origin", origin)
    z = length * _shares(nodes, grading)
    k = (2.0 if handedness == "right" else -2.0) * np.pi / pitch
    angle = k * z + phase
    points = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), z])
    tangents = np.column_stack(
        [-k * radius * np.sin(angle), k * radius * np.cos(angle), np.ones(nodes)]
    )
    # D1 is the inward normal: the strain of the helix is then (0, curvature, torsion).
    inward = np.column_stack([-np.cos(angle), -np.sin(angle), np.zeros(nodes)])
    return Centerline(points, from_directors(inward, tangents)).moved(
        origin, _turn_from_z(direction)
    )


@check.spelling
def ring(
    radius: float, nodes: int, *, twist: float = 0.0, origin: ArrayLike = (0, 0, 0)
) -> Centerline:
    """Return a closed circle in the x-y plane, its triads turned `twist` radians in one round.

    A `twist` that is not a multiple of 2 pi is concentrated in the last segment as it would be by
    gluing the ends of a twisted rod: the shape closes, the triads do not.

    Examples
    --------
    >>> import mrs
    >>> line = mrs.geometry.ring(radius=1.0, nodes=4)
    >>> print(line.nodes.round(6) + 0.0, line.closed)
    [[ 1.  0.  0.]
     [ 0.  1.  0.]
     [-1.  0.  0.]
     [ 0. -1.  0.]] True
    """
    check.positive("radius", radius)
    check.integer("nodes", nodes, 3)
    check.number("twist", twist, -np.inf, np.inf)
    angle = 2.0 * np.pi * np.arange(nodes) / nodes
    outward = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(nodes)])
    tangents = np.column_stack([-np.sin(angle), np.cos(angle), np.zeros(nodes)])
    about = np.zeros((nodes, 3))
    about[:, 2] = twist * np.arange(nodes) / nodes
    triads = rotations.multiply(from_directors(-outward, tangents), rotations.exponential(about))
    return Centerline(radius * outward + check.vector("origin", origin), triads, closed=True)


@check.spelling
def at_rest(
    strain: ArrayLike, spacing: ArrayLike, nodes: int, *, origin: ArrayLike = (0, 0, 0)
) -> Centerline:
    """Return the shape that a rod of constant intrinsic strain takes: exact discrete equilibrium.

    Each segment turns by ``2 asin(|strain| spacing / 2)`` about the strain, and its length is along
    D3 halfway; no internal force or moment is left.

    Parameters
    ----------
    strain : (3,) array_like
        Curvatures about D1, D2 and twist about D3, radians per length.
    spacing : float or (nodes - 1,) array_like
        Length of each segment.
    nodes : int
    origin : (3,) array_like, optional
        Of the first node, whose triad is along the axes.

    Examples
    --------
    >>> import mrs
    >>> arc = mrs.geometry.at_rest(strain=(0.5, 0.0, 0.0), spacing=0.1, nodes=5)  # radius 2
    >>> rod = mrs.Rods(
    ...     arc, bending=1.0, twisting=1.0, shearing=1.0, stretching=1.0,
    ...     intrinsic_curvature=(0.5, 0.0, 0.0),
    ... )
    >>> bool(mrs.Simulation(mrs.Fluid(epsilon=0.1), [rod]).energy() < 1e-28)
    True
    """
    strain = check.vector("strain", strain)
    check.integer("nodes", nodes, 2)
    lengths = check.broadcast("spacing", spacing, (nodes - 1,), 0.0)
    check.vector("origin", origin)
    rate = np.linalg.norm(strain)
    longest = lengths.max()
    if 0.5 * rate * longest >= 1.0:
        raise ValueError(f"spacing: {longest} is too long; at most {2 / rate:.3g} for this strain")
    turns = 2.0 * np.arcsin(0.5 * rate * lengths)
    ends = np.concatenate([[0.0], np.cumsum(turns)])
    about = strain / rate if rate > 0.0 else strain
    triads = rotations.exponential(ends[:, None] * about)
    middle = rotations.exponential((ends[:-1] + 0.5 * turns)[:, None] * about)
    steps = lengths[:, None] * rotations.rotate(middle, np.array([[0.0, 0.0, 1.0]]))
    points = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
    return Centerline(points, triads).moved(origin)


def array(centerline: Centerline, origins: ArrayLike) -> list[Centerline]:
    """Return one copy of `centerline` at each of `origins`, (n, 3).

    Examples
    --------
    >>> import mrs
    >>> cilium = mrs.geometry.straight(1.0, nodes=5)
    >>> carpet = mrs.geometry.array(cilium, mrs.geometry.grid((3, 2), spacing=0.5))
    >>> len(carpet), carpet[0].nodes[0].tolist()
    (6, [-0.5, -0.25, 0.0])
    """
    return [centerline.moved(origin) for origin in check.rows("origins", origins, 3)]


def grid(shape: Iterable[int], spacing: float) -> np.ndarray:
    """Return points of a grid centred at the origin, (n, 3).

    Parameters
    ----------
    shape : (2,) or (3,) of int
        Points along x, y and z; one along z by default.
    spacing : float
        Between neighbours.

    Examples
    --------
    >>> import mrs
    >>> print(mrs.geometry.grid((3, 1), spacing=0.5))
    [[-0.5  0.   0. ]
     [ 0.   0.   0. ]
     [ 0.5  0.   0. ]]
    """
    numbers = [check.integer(f"shape[{i}]", n, 1) for i, n in enumerate(shape)]
    if len(numbers) not in (2, 3):
        raise ValueError(f"shape must be two or three numbers, got {numbers}")
    check.positive("spacing", spacing)
    sides = [spacing * (np.arange(n) - 0.5 * (n - 1)) for n in (*numbers, 1)[:3]]
    return np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 3)


def from_directors(first: np.ndarray, third: np.ndarray) -> np.ndarray:
    """Return triads with D3 along `third` and D1 as near to `first` as that allows, (M, 4).

    Examples
    --------
    >>> import mrs
    >>> import numpy as np
    >>> first, third = np.array([[1.0, 0.0, 0.0]]), np.array([[0.0, 3.0, 4.0]])
    >>> triad = mrs.geometry.from_directors(first, third)
    >>> print(mrs.rotations.axes(triad)[0].round(6) + 0.0)  # D1, D2, D3
    [[ 1.   0.   0. ]
     [ 0.   0.8 -0.6]
     [ 0.   0.6  0.8]]
    """
    d3 = third / np.linalg.norm(third, axis=1)[:, None]
    d1 = first - np.einsum("ni,ni->n", first, d3)[:, None] * d3
    d1 = d1 / np.linalg.norm(d1, axis=1)[:, None]
    return scipy.spatial.transform.Rotation.from_matrix(
        np.stack([d1, rotations.cross(d3, d1), d3], axis=-1)
    ).as_quat()


def one_rotation(rotation: Any) -> scipy.spatial.transform.Rotation:
    """Return a rotation of scipy's, none if it is None.

    Examples
    --------
    >>> import mrs
    >>> mrs.geometry.one_rotation(None).magnitude()
    np.float64(0.0)
    """
    turn = scipy.spatial.transform.Rotation.identity() if rotation is None else rotation
    if not isinstance(turn, scipy.spatial.transform.Rotation) or not turn.single:
        raise TypeError(f"rotation must be one scipy.spatial.transform.Rotation, got {rotation!r}")
    return turn


def _turn_from_z(direction: ArrayLike) -> scipy.spatial.transform.Rotation:
    """Return the shortest rotation that takes z to `direction`."""
    unit = check.direction("direction", direction)
    if unit[2] < -1.0 + 1e-12:
        return scipy.spatial.transform.Rotation.from_rotvec([np.pi, 0.0, 0.0])
    return scipy.spatial.transform.Rotation.from_quat(
        rotations.between(np.array([0.0, 0.0, 1.0]), unit)
    )


def _shares(nodes: int, grading: Grading) -> np.ndarray:
    """Return the places of nodes as shares of a length, (nodes,)."""
    check.integer("nodes", nodes, 2)
    even = np.linspace(0.0, 1.0, nodes)
    if not callable(grading):
        check.one_of("grading", grading, ("uniform", "cosine"))
        return even if grading == "uniform" else 0.5 - 0.5 * np.cos(np.pi * even)
    shares = check.shaped("grading", grading(even), (nodes,))
    ends = np.abs(shares[[0, -1]] - [0.0, 1.0]).max()
    if ends > 1e-12 or (np.diff(shares) <= 0.0).any():
        raise ValueError(f"grading must give numbers that rise from 0 to 1, got {shares}")
    return shares
