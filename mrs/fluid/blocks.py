"""Approximate loads of points whose velocities are given: those of each patch of a body alone."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import scipy

from mrs import rotations
from mrs.rigid_motion import GivenMotion, carried, net_loads

_LARGEST = 1000  # points of a patch: its matrix has nine times the square of that
_SINGULAR = 1e-10  # resistance to a turn, against the others, that counts as none


class IllConditionedError(ValueError):
    """The mobility of some points is not positive definite, but for rounding."""


class Batch(NamedTuple):
    """Patches of one size, and as many with the points of each.

    Attributes
    ----------
    inverses : (b, 3 p, 3 p) ndarray
        Of mobilities.
    rows : (b, c, p) int ndarray
        Of the points of c patches with each mobility.
    """

    inverses: np.ndarray
    rows: np.ndarray


class Blocks:
    """The mobilities of patches of points in free space, factorised in the frames of their bodies.

    Parameters
    ----------
    viscosity : float
    epsilons : (n,) ndarray
        Blob sizes.
    local : (n, 3) ndarray
        Points in the axes of their frames, as in `GivenMotion`.
    frame : (n,) int ndarray

    Attributes
    ----------
    local : (n, 3) ndarray
        Where the points were when the mobilities were factorised.

    Raises
    ------
    IllConditionedError
    """

    def __init__(
        self, viscosity: float, epsilons: np.ndarray, local: np.ndarray, frame: np.ndarray
    ) -> None:
        self.local = local
        alike: dict[bytes, list[np.ndarray]] = {}
        for rows in _patches(local, frame):
            key = local[rows].tobytes() + epsilons[rows].tobytes()
            alike.setdefault(key, []).append(rows)
        batches: dict[tuple[int, int], list[list[np.ndarray]]] = {}
        for group in alike.values():
            batches.setdefault((len(group), len(group[0])), []).append(group)
        self._batches = [
            Batch(
                np.stack([_inverse(viscosity, epsilons[rows], local[rows]) for rows, *_ in groups]),
                np.array(groups),
            )
            for groups in batches.values()
        ]

    def place(self, given: GivenMotion) -> PlacedBlocks:
        """Return the patches where frames have brought them."""
        return PlacedBlocks(self._batches, given)


class PlacedBlocks:
    """Patches in the axes of space, with the free frames that carry them."""

    def __init__(self, batches: list[Batch], given: GivenMotion) -> None:
        self._batches, self._frame = batches, given.frame
        self._turn = given.quaternion[given.frame]
        self._arms, self._count = given.arms, len(given.free)
        self._mobility = np.zeros((self._count, 6, 6))
        self._any_free = bool(given.free.any())
        if self._any_free:
            self._mobility[given.free] = self._mobilities()[given.free]

    def _mobilities(self) -> np.ndarray:
        """Return the mobility of each frame, (k, 6, 6), by the patches alone."""
        length = np.zeros(self._count)
        np.maximum.at(length, self._frame, np.linalg.norm(self._arms, axis=1))
        scale = np.ones((self._count, 6))
        scale[:, 3:] /= np.where(length > 0.0, length, 1.0)[:, None]
        scaled = self._resistances() * scale[:, :, None] * scale[:, None, :]
        inverse = np.linalg.pinv(scaled, rcond=_SINGULAR, hermitian=True)
        return inverse * scale[:, :, None] * scale[:, None, :]

    def _resistances(self) -> np.ndarray:
        """Return the resistance matrix of each frame, (k, 6, 6), by the patches alone."""
        columns = []
        for unit in np.eye(6):
            motion = np.tile(unit, (self._count, 1))
            forces = self._forces(carried(motion, self._arms, self._frame))
            columns.append(self.net_loads(forces))
        return np.stack(columns, axis=2)

    def _forces(self, velocities: np.ndarray) -> np.ndarray:
        """Return the forces that give velocities, (n, 3), to each patch alone."""
        inside = rotations.rotate(rotations.conjugate(self._turn), velocities)
        forces = np.empty_like(inside)
        for inverses, rows in self._batches:
            columns = inside[rows].reshape(*rows.shape[:2], -1).swapaxes(1, 2)
            forces[rows] = (inverses @ columns).swapaxes(1, 2).reshape(*rows.shape, 3)
        return rotations.rotate(self._turn, forces)

    def net_loads(self, forces: np.ndarray) -> np.ndarray:
        """Return the net force and torque of each frame, (k, 6)."""
        return net_loads(forces, self._arms, self._frame, self._count)

    def solve(self, velocities: np.ndarray, loads: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return forces, (n, 3), and motions of the free frames, (k, 6).

        The forces give each patch alone its velocities besides those of the frames, and add up to
        the loads of the free frames.

        Parameters
        ----------
        velocities : (n, 3) ndarray
        loads : (k, 6) ndarray
        """
        forces = self._forces(velocities)
        if not self._any_free:
            return forces, np.zeros_like(loads)
        lacking = loads - self.net_loads(forces)
        motion = np.einsum("kij,kj->ki", self._mobility, lacking)
        forces = forces + self._forces(carried(motion, self._arms, self._frame))
        return forces, motion


def _patches(local: np.ndarray, frame: np.ndarray) -> Iterator[np.ndarray]:
    """Yield the rows of neighbouring points of one frame, not too many together."""
    order = np.argsort(frame, kind="stable")
    for rows in np.split(order, np.cumsum(np.bincount(frame))[:-1]):
        if len(rows):
            yield from _halved(local, rows)


def _halved(local: np.ndarray, rows: np.ndarray) -> Iterator[np.ndarray]:
    if len(rows) <= _LARGEST:
        yield rows
        return
    axis = int(np.argmax(np.ptp(local[rows], axis=0)))
    rows = rows[np.argsort(local[rows, axis], kind="stable")]
    for half in np.array_split(rows, 2):
        yield from _halved(local, half)


def _inverse(viscosity: float, epsilons: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return the inverse of the mobility of some points in free space, (3 p, 3 p) (K eq. 7.2).

    The square of the blob size of a pair is the mean of both squares.
    """
    count = len(points)
    apart = points[:, None] - points
    square = np.einsum("ijk,ijk->ij", apart, apart)
    epsilon = 0.5 * (epsilons[:, None] ** 2 + epsilons**2)
    cube = (square + epsilon) ** 1.5
    matrix = apart[:, :, :, None] * apart[:, :, None, :]
    matrix += (square + 2.0 * epsilon)[:, :, None, None] * np.eye(3)
    matrix /= (8.0 * np.pi * viscosity) * cube[:, :, None, None]
    matrix = matrix.transpose(0, 2, 1, 3).reshape(3 * count, 3 * count)
    factor, failed = scipy.linalg.lapack.dpotrf(matrix, lower=1, overwrite_a=1)
    if failed:
        raise IllConditionedError
    inverse, _ = scipy.linalg.lapack.dpotri(factor, lower=1, overwrite_c=1)
    lower = np.tril(inverse)  # the other half is not set
    return lower + np.tril(lower, -1).T
