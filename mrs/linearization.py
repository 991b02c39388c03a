"""An approximate Jacobian of the rates of a scene, and solutions of linear equations with it.

The rates of stiff bodies are u = M f(z): loads f by their stiffness K, motion by the mobility M.
The approximation leaves out how M changes, and takes M in blocks: pieces of bodies alone, those
closer than a blob together. Blocks feel each other through a few points of each, proxies.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import chain
from typing import Any, TypeAlias

import numpy as np
import scipy

from mrs import krylov, rotations
from mrs.bodies.layout import Layout
from mrs.fluid.mobility import Boundary, Mobility
from mrs.proxies import Proxies
from mrs.stiffness import Nodes, Stiffness, gathered
from mrs.time.state import State
from treecode.threads import Threads, shared

_LONGEST = 500  # nodes of a piece: factors of longer ones cost more than the sums they save
_MEMORY = 4 * 2**30  # bytes of all matrices
_LARGEST = 400  # nodes of pieces in one block: its matrix has 36 times the square of that
_PRECISION = np.float32  # of factors
_ROUNDING = 1e-6  # of the largest entry, below which entries couple nothing
_KEPT = 2  # factorisations
_SHARE = 8  # blocks at least that a thread takes, of which it solves the equations
_RIGHT = 1e-2  # relative residual of solutions
_MOST = 12  # iterations

_Factors: TypeAlias = tuple[np.ndarray, ...]


def is_worthwhile(lengths: np.ndarray) -> bool:
    """Return whether matrices of pieces of so many nodes are worth their time and memory."""
    elements = 36.0 * np.square(lengths, dtype=float).sum() * (1 + _KEPT)
    needed = elements * np.dtype(_PRECISION).itemsize
    return bool(lengths.max(initial=0) <= _LONGEST and needed <= _MEMORY)


class Block:
    """Coordinates that feel each other wholly: their part of the Jacobian.

    Parameters
    ----------
    rows : (k,) int ndarray
        Among the coordinates of all nodes, six a node.
    mobility : (k, k) ndarray
    stiffness : (k, k) scipy.sparse.csr_array
    unit : (k,) ndarray
        Of coordinates: with others factors would depend on the user's unit of length.
    """

    def __init__(
        self, rows: np.ndarray, mobility: np.ndarray, stiffness: Any, unit: np.ndarray
    ) -> None:
        self._rows, self._unit = rows, unit
        transposed = (stiffness * unit).T.tocsr() @ mobility.T
        self._transposed = np.asarray(transposed / unit, _PRECISION)

    def factors(self, g: float) -> _Factors:
        """Return the LU factors of 1 - g J, and their pivots."""
        matrix = self._transposed * _PRECISION(-g)
        matrix.flat[:: len(matrix) + 1] += 1.0
        # LAPACK has matrices by columns: its matrix is the transpose of this one.
        lu, pivots, _ = scipy.linalg.lapack.sgetrf(matrix.T, overwrite_a=1)
        return lu, pivots

    def solve(self, factors: _Factors, right: np.ndarray, out: np.ndarray) -> None:
        """Write the solution of (1 - g J) x = right, both of all coordinates."""
        out[self._rows] = self._solved(factors, right[self._rows])

    def responses(self, factors: _Factors, rates: Any) -> tuple[np.ndarray, ...]:
        """Return the solutions for all columns of a sparse matrix: rows, columns and values."""
        own = rates[self._rows].tocoo()
        columns, place = np.unique(own.coords[1], return_inverse=True)
        right = np.zeros((len(self._rows), len(columns)))
        right[own.coords[0], place] = own.data
        solved = self._solved(factors, right)
        rows = np.repeat(self._rows, len(columns))
        return rows, np.tile(columns, len(self._rows)), solved.ravel()

    def _solved(self, factors: _Factors, right: np.ndarray) -> np.ndarray:
        unit = self._unit.reshape(-1, *(1,) * (right.ndim - 1))
        solution, _ = scipy.linalg.lapack.sgetrs(*factors, np.asarray(right / unit, _PRECISION))
        return np.asarray(unit * solution)


def _independent(places: np.ndarray, mobility: np.ndarray, stiffness: Any) -> list[Any]:
    """Return sets of coordinates of nodes that do not feel each other.

    Nodes in a plane across an axis move in it and turn about that axis as if that were all. Then
    there are two, and their factors take a quarter of the time.
    """
    extents = np.ptp(places, axis=0)
    across = np.flatnonzero(extents <= _ROUNDING * extents.max())
    if len(across):
        component = np.tile(np.arange(6), len(places))
        inside = (component < 3) != (component % 3 == across[0])
        halves = np.flatnonzero(inside), np.flatnonzero(~inside)
        pairs = [(m[:, halves[1]][halves[0]], m) for m in (mobility, stiffness)]
        if all(abs(p).max() <= _ROUNDING * abs(m.diagonal()).max() for p, m in pairs):
            return list(halves)
    return [slice(None)]


class Equations:
    """The equations (1 - g A) x = r for one g.

    Parameters
    ----------
    g : float
    blocks : list of Block
    proxies : Proxies or None
    unit : (n, 2, 3) ndarray
        Of errors of the coordinates of nodes.
    """

    def __init__(
        self, g: float, blocks: list[Block], proxies: Proxies | None, unit: np.ndarray
    ) -> None:
        self._g, self._blocks, self._proxies = g, blocks, proxies
        self._factors = shared(lambda block: block.factors(g), blocks)
        if proxies is not None:

            def response(number: int) -> tuple[np.ndarray, ...]:
                return blocks[number].responses(self._factors[number], proxies.rates)

            found = zip(*shared(response, range(len(blocks))), strict=True)
            rows, columns, values = map(np.concatenate, found)
            self._responses = scipy.sparse.csr_array((values, (rows, columns)), proxies.rates.shape)
            self._fed_back = proxies.forces @ self._responses
            self._unit = unit[proxies.nearest, 0]

    def solve(self, turn: np.ndarray, right: np.ndarray) -> np.ndarray:
        """Return the solution in the frames of the nodes, (n, 2, 3), which have turned.

        The unknowns are the velocities of the proxies by other blocks. The rest follows from them,
        by responses: a few solutions of each block, made once.
        """
        alone, proxies = self._alone(right), self._proxies
        if proxies is None:
            return alone

        def flow(forces: np.ndarray) -> np.ndarray:
            return proxies.velocities(turn, forces.reshape(-1, 3))

        def applied(v: np.ndarray) -> np.ndarray:
            return v - flow(self._g * (self._fed_back @ v.ravel()))

        given = flow(proxies.forces @ alone.ravel())
        v = krylov.solved(applied, given, self._unit, _RIGHT, _MOST)
        return alone + self._g * (self._responses @ v.ravel()).reshape(alone.shape)

    def _alone(self, right: np.ndarray) -> np.ndarray:
        """Return the solution if blocks did not feel each other."""
        flat, out = right.reshape(-1), np.empty(right.size)

        def some(pieces: slice) -> None:
            for block, own in zip(self._blocks[pieces], self._factors[pieces], strict=True):
                block.solve(own, flat, out)

        with Threads() as threads:
            threads(some, len(self._blocks), least=_SHARE)
        return out.reshape(right.shape)


class Linearization:
    """The approximate Jacobian in a state; its parts turn with the nodes.

    Parameters
    ----------
    time : float
    state : State
    nodes : Nodes
    blocks : list of Block
    stiffness : scipy.sparse.csr_array
        Of all nodes.
    proxies : Proxies or None
    unit : (n, 2, 3) ndarray
        Of errors of the coordinates of nodes.
    motion : callable
        Of points and their loads, (n, 2, 3): returns their motion, (n, 2, 3), by a sum.
    """

    def __init__(
        self,
        time: float,
        state: State,
        nodes: Nodes,
        blocks: list[Block],
        stiffness: Any,
        proxies: Proxies | None,
        unit: np.ndarray,
        motion: Callable[[np.ndarray, np.ndarray], np.ndarray],
    ) -> None:
        self.time, self.state, self._motion = time, state, motion
        self._nodes, self._blocks, self._proxies = nodes, blocks, proxies
        self._stiffness = stiffness
        rows = nodes.positions, nodes.triads
        self._rows = rows[0], rows[1] + len(state.positions)
        self._unit = unit
        self._equations: dict[float, Equations] = {}

    def at(self, state: State) -> Placed:
        """Return it in the frames that nodes have in a state."""
        before = rotations.conjugate(self.state.quaternions[self._nodes.triads])
        return Placed(self, rotations.multiply(state.quaternions[self._nodes.triads], before))

    def solve(self, g: float, turn: np.ndarray, right: np.ndarray) -> np.ndarray:
        """Return x with (1 - g A) x = right, (P + Q, 3), where nodes have turned."""
        if not np.isfinite(right).all():  # the step will be rejected
            return np.full_like(right, np.nan)
        if g not in self._equations:
            while len(self._equations) >= _KEPT:
                del self._equations[next(iter(self._equations))]
            self._equations[g] = Equations(g, self._blocks, self._proxies, self._unit)
        solved = self._equations[g].solve(turn, self._inside(turn, right))
        return self._written(right.copy(), rotations.rotate(turn[:, None], solved))

    def product(self, turn: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Return the rates that changes x of coordinates cause, where nodes have turned."""
        loads = (self._stiffness @ self._inside(turn, x).reshape(-1)).reshape(-1, 2, 3)
        motion = self._motion(self._nodes.points, rotations.rotate(turn[:, None], loads))
        motion[self._nodes.held] = 0.0
        return self._written(np.zeros_like(x), motion)

    def _inside(self, turn: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Return the rows of nodes of x, (P + Q, 3), in the frames of the nodes, (n, 2, 3)."""
        own = np.stack([x[rows] for rows in self._rows], axis=1)
        return rotations.rotate(rotations.conjugate(turn)[:, None], own)

    def _written(self, out: np.ndarray, own: np.ndarray) -> np.ndarray:
        """Return `out`, (P + Q, 3), with the rows of nodes, (n, 2, 3), written to it."""
        for rows, part in zip(self._rows, own.swapaxes(0, 1), strict=True):
            out[rows] = part
        return out


class Placed:
    """A linearization in the frames that nodes have now."""

    def __init__(self, linearization: Linearization, turn: np.ndarray) -> None:
        self._linearization, self._turn = linearization, turn

    def solve(self, g: float, right: np.ndarray) -> np.ndarray:
        """Return x with (1 - g A) x = right, (P + Q, 3)."""
        return self._linearization.solve(g, self._turn, right)

    def product(self, x: np.ndarray) -> np.ndarray:
        """Return the motion that changes x of the coordinates cause, (P + Q, 3), by a sum."""
        return self._linearization.product(self._turn, x)


def linearized(
    layout: Layout,
    mobility: Mobility,
    made: Callable[[np.ndarray], Mobility] | None,
    epsilons: np.ndarray,
    unit: np.ndarray,
    motion: Callable[[np.ndarray, np.ndarray], np.ndarray],
    boundary: Boundary,
    time: float,
    state: State,
) -> Linearization | None:
    """Return the approximate Jacobian in a state; None if no body is stiff.

    Parameters
    ----------
    layout : Layout
    mobility : Mobility
        Of all points.
    made : callable or None
        Makes the mobility of proxies from their blob sizes, if there are to be any.
    epsilons : (N,) ndarray
        Blob sizes of all points.
    unit : (P + Q, 1) ndarray
        Of errors of coordinates.
    motion : callable
        See `Linearization`.
    boundary : Boundary
    time : float
    state : State
    """
    found = _stiff(layout, time, state)
    if found is None:
        return None
    nodes, stiffness = found
    points = layout.points(time, state)[nodes.points]
    sizes = epsilons[nodes.points]
    places = nodes.positions, nodes.triads + len(state.positions)
    units = np.stack([np.tile(unit[rows], 3) for rows in places], axis=1)
    block = _grouped(nodes.piece, points, sizes)
    groups = gathered(block)

    def made_of(own: np.ndarray) -> list[Block]:
        matrix = mobility.matrix(nodes.points[own], points[own], boundary)
        return _blocks_of(own, nodes, points, matrix, stiffness, units.ravel())

    blocks = list(chain.from_iterable(shared(made_of, groups)))
    proxies = None
    if made is not None and len(groups) > 1:
        proxies = Proxies(nodes, points, sizes, block, stiffness, made, boundary)
    return Linearization(time, state, nodes, blocks, stiffness, proxies, units, motion)


def _blocks_of(
    own: np.ndarray,
    nodes: Nodes,
    points: np.ndarray,
    mobility: np.ndarray,
    stiffness: Any,
    unit: np.ndarray,
) -> list[Block]:
    """Return the blocks of some nodes, which feel none of the others in them."""
    held = np.repeat(nodes.held[own], 6)
    mobility[held], mobility[:, held] = 0.0, 0.0
    rows = (6 * own[:, None] + np.arange(6)).ravel()
    stiffness = stiffness[rows][:, rows]
    return [
        Block(rows[part], mobility[:, part][part], stiffness[part][:, part], unit[rows[part]])
        for part in _independent(points[own], mobility, stiffness)
    ]


def _stiff(layout: Layout, time: float, state: State) -> tuple[Nodes, Any] | None:
    """Return the nodes of the stiff bodies, and the derivative of their loads."""
    parts, matrices, pieces = [], [], 0
    for part in layout.parts:
        found: Stiffness | None = part.body.stiffness(time, part.state(state))
        if found is None:
            continue
        held = np.zeros(len(found.pieces), bool)
        held[found.held] = True
        where = [
            np.arange(s.start, s.stop) for s in (part.points, part.positions, part.quaternions)
        ]
        parts.append((*where, held, found.pieces + pieces))
        pieces += int(found.pieces.max()) + 1
        matrices.append(found.matrix)
    if not parts:
        return None
    nodes = Nodes(*(np.concatenate(column) for column in zip(*parts, strict=True)))
    return nodes, scipy.sparse.block_diag(matrices, format="csr")


def _grouped(piece: np.ndarray, places: np.ndarray, epsilons: np.ndarray) -> np.ndarray:
    """Return the block of each node: pieces with nodes closer than a blob are in one."""
    tree = scipy.spatial.cKDTree(places)
    first, second = tree.query_pairs(float(epsilons.max()), output_type="ndarray").T
    near = np.linalg.norm(places[first] - places[second], axis=1)
    touching = (near < np.maximum(epsilons[first], epsilons[second])) & (
        piece[first] != piece[second]
    )
    pairs = piece[first[touching]], piece[second[touching]]
    count = int(piece.max()) + 1
    graph = scipy.sparse.coo_array((np.ones(len(pairs[0])), pairs), shape=(count, count))
    _, group = scipy.sparse.csgraph.connected_components(graph, directed=False)
    alone = np.bincount(group[piece])[group] > _LARGEST
    group[alone] = group.max() + 1 + np.flatnonzero(alone)
    _, block = np.unique(group[piece], return_inverse=True)
    return np.asarray(block)
