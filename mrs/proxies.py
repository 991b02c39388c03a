"""A few points along rods, through which an approximate mobility couples them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import scipy

from mrs import rotations
from mrs.fluid.mobility import Boundary, Mobility
from mrs.stiffness import Nodes, gathered

_PROXIES = 6  # of a piece


class Proxies:
    """A few points along each piece, through which blocks feel the forces of each other.

    Loads and velocities of proxies turn with the nodes next to them.

    Parameters
    ----------
    nodes : Nodes
    places : (n, 3) ndarray
        Of the nodes.
    epsilons : (n,) ndarray
        Blob sizes.
    block : (n,) int ndarray
        Of each node.
    stiffness : (6 n, 6 n) scipy.sparse.csr_array
    made : callable
        Makes the mobility of the proxies from their blob sizes.
    boundary : Boundary

    Attributes
    ----------
    forces : (3 P, 6 n) scipy.sparse.csr_array
        Of P proxies, by changes of the coordinates of nodes.
    rates : (6 n, 3 P) scipy.sparse.csr_array
        Of the coordinates of nodes, by the velocities of the proxies.
    nearest : (P,) int ndarray
        The node next to each.
    """

    def __init__(
        self,
        nodes: Nodes,
        places: np.ndarray,
        epsilons: np.ndarray,
        block: np.ndarray,
        stiffness: Any,
        made: Callable[[np.ndarray], Mobility],
        boundary: Boundary,
    ) -> None:
        weights, axes = _weights(nodes.piece), np.eye(3, 6)
        self.forces = (scipy.sparse.kron(weights.T, axes) @ stiffness).tocsr()
        free = scipy.sparse.diags_array(1.0 - nodes.held)
        self.rates = scipy.sparse.kron(free @ weights, axes.T).tocsr()
        self.nearest = _nearest(nodes.piece)
        first = np.unique(nodes.piece, return_index=True)[1]
        self._places, self._boundary = _smoothed(nodes.piece, places), boundary
        self._mobility = made(np.repeat(self._blobs(epsilons[first]), _PROXIES))
        self._within = self._of_blocks(np.repeat(block[first], _PROXIES))

    def _blobs(self, epsilons: np.ndarray) -> np.ndarray:
        """Return the blob size of the proxies of each piece, for those of its nodes.

        About the distance between proxies, if that is larger: smaller blobs made the approximate
        mobility of rods close to each other indefinite. They are powers of two apart, since each
        size costs a sum.
        """
        lines = self._places.reshape(-1, _PROXIES, 3)
        steps = np.linalg.norm(np.diff(lines, axis=1), axis=2).max(axis=1)
        sizes = np.maximum(epsilons, steps)
        return np.asarray(sizes.max() * 2.0 ** np.round(np.log2(sizes / sizes.max())))

    def _of_blocks(self, block: np.ndarray) -> Any:
        """Return the mobility of the proxies of each block alone, a sparse matrix of all."""
        groups = gathered(block)
        matrices = [self._mobility.matrix(g, self._places[g], self._boundary) for g in groups]
        order = (3 * np.concatenate(groups)[:, None] + np.arange(3)).ravel()
        own = scipy.sparse.block_diag(matrices, format="coo")
        places = order[own.coords[0]], order[own.coords[1]]
        return scipy.sparse.csr_array((own.data, places), shape=own.shape)

    def velocities(self, turn: np.ndarray, forces: np.ndarray) -> np.ndarray:
        """Return the velocities of proxies, (P, 3), by forces, (P, 3), of other blocks."""
        there = turn[self.nearest]
        fixed = rotations.rotate(there, forces)
        flow = self._mobility(self._places, fixed, self._boundary)
        flow -= (self._within @ fixed.ravel()).reshape(flow.shape)
        return rotations.rotate(rotations.conjugate(there), flow)


def _weights(piece: np.ndarray) -> Any:
    """Return the interpolation from proxies to nodes, (n, proxies), by their order in a piece."""
    rows, columns, values = [], [], []
    for number, own in enumerate(gathered(piece)):
        along = np.linspace(-1.0, 1.0, len(own)) if len(own) > 1 else np.zeros(1)
        rows.append(np.repeat(own, _PROXIES))
        columns.append(np.tile(np.arange(_PROXIES) + _PROXIES * number, len(own)))
        values.append(_lagrange(along).ravel())
    places = np.concatenate(rows), np.concatenate(columns)
    return scipy.sparse.csr_array((np.concatenate(values), places))


def _smoothed(piece: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Return the places of proxies on the lines through the nodes of each piece."""
    out = []
    for own in gathered(piece):
        along = np.linspace(-1.0, 1.0, len(own)) if len(own) > 1 else np.zeros(1)
        out.append([np.interp(_chebyshev(), along, axis) for axis in places[own].T])
    return np.ascontiguousarray(np.transpose(out, (0, 2, 1)).reshape(-1, 3))


def _nearest(piece: np.ndarray) -> np.ndarray:
    """Return the node next to each proxy, by their order in a piece."""
    share = 0.5 * (1.0 + _chebyshev())
    return np.concatenate(
        [own[np.round(share * (len(own) - 1)).astype(int)] for own in gathered(piece)]
    )


def _chebyshev() -> np.ndarray:
    """Return the points of Gauss and Chebyshev in increasing order."""
    return -np.cos(np.pi * (np.arange(_PROXIES) + 0.5) / _PROXIES)


def _lagrange(along: np.ndarray) -> np.ndarray:
    """Return the polynomials that are 1 at one Chebyshev point each, (n, proxies)."""
    points = _chebyshev()
    values = np.ones((len(along), _PROXIES))
    for j, point in enumerate(points):
        for other in np.delete(points, j):
            values[:, j] *= (along - other) / (point - other)
    return values
