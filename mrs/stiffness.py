"""How the loads of a body change with its coordinates: what makes its motion stiff."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import scipy


class Stiffness(NamedTuple):
    """The derivative of the loads of a body with a triad at each of its n points.

    Attributes
    ----------
    matrix : (6 n, 6 n) scipy.sparse.csr_array
        Row 6 k + i is the force of point k on the fluid for i < 3, else its torque; column 6 k + i
        its position, else its rotation vector.
    held : int ndarray
        Points whose motion does not follow from that of the fluid.
    pieces : (n,) int ndarray
        The piece of each point: loads of one piece do not depend on the others.
    """

    matrix: Any
    held: np.ndarray
    pieces: np.ndarray


class Nodes(NamedTuple):
    """The nodes of all stiff bodies: where they are in the flat arrays.

    Attributes
    ----------
    points, positions, triads : (n,) int ndarray
        Rows.
    held : (n,) bool ndarray
        Whether the motion of a node does not follow from that of the fluid.
    piece : (n,) int ndarray
        Numbered through all bodies.
    """

    points: np.ndarray
    positions: np.ndarray
    triads: np.ndarray
    held: np.ndarray
    piece: np.ndarray


def gathered(numbers: np.ndarray) -> list[np.ndarray]:
    """Return the places of each number from 0, in their order."""
    return np.split(np.argsort(numbers, kind="stable"), np.cumsum(np.bincount(numbers))[:-1])


def assembled(rows: np.ndarray, columns: np.ndarray, blocks: np.ndarray, count: int) -> Any:
    """Return a matrix of blocks, those of one place added up.

    Parameters
    ----------
    rows, columns : (b,) int ndarray
        Points of each block.
    blocks : (b, 6, 6) ndarray
    count : int
        Number n of points.

    Returns
    -------
    (6 n, 6 n) scipy.sparse.csr_array
    """
    places = rows * count + columns
    order = np.argsort(places, kind="stable")
    place, first = np.unique(places[order], return_index=True)
    data = np.add.reduceat(blocks[order], first)
    starts = np.searchsorted(place // count, np.arange(count + 1))
    shape = 6 * count, 6 * count
    return scipy.sparse.bsr_array((data, place % count, starts), shape=shape).tocsr()
