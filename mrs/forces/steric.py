"""Short-range repulsion, so that bodies do not pass through each other."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import ClassVar

import numpy as np
import scipy

from mrs import check
from mrs.bodies.layout import Layout
from mrs.fluid import Fluid, Periodic, Wall
from mrs.forces.base import Force


@check.spelling
@dataclass(frozen=True)
class Steric(Force):
    """Pairwise repulsion of points nearer than ``2 chi a``, of zero net force and torque.

    F_ij = (strength / 2a) [(4 chi^2 a^2 - r^2) / (4 chi^2 a^2 - 4 a^2)]^4 r_ij, which is `strength`
    at contact, r = 2a. Points of one rod nearer than that along the rod do not repel each other,
    nor do the two particles of one swimmer. A wall repels each point as its mirror image would. In
    a periodic box a body may touch its own image.

    Parameters
    ----------
    strength : float
        Force at contact.
    radius : float
        a, of every point.
    chi : float, optional
        How far the repulsion reaches, in contact distances; above 1.
    """

    kind: ClassVar[str] = "steric"
    __pydantic_config__: ClassVar[dict[str, str]] = {"extra": "forbid"}

    strength: float
    radius: float
    chi: float = 1.1

    def __post_init__(self) -> None:
        check.positive("strength", self.strength)
        check.positive("radius", self.radius)
        check.number("chi", self.chi, 1.0, 1e3)

    def forces(self, time: float, points: np.ndarray, layout: Layout, fluid: Fluid) -> np.ndarray:
        """Return the force on each point, (F, 3)."""
        box = fluid.boundary if isinstance(fluid.boundary, Periodic) else None
        forces = self.between(points, *layout.contact_labels, box=box)
        if isinstance(fluid.boundary, Wall):
            forces += self.from_wall(points, fluid.boundary)
        return forces

    def from_wall(self, points: np.ndarray, wall: Wall) -> np.ndarray:
        """Return the repulsion of points, (N, 3), by their mirror images in a wall."""
        distance = 2.0 * wall.heights(points)
        return self._push(np.abs(distance))[:, None] * np.outer(distance, wall.normal)

    def _push(self, distance: np.ndarray) -> np.ndarray:
        """Return the repulsion of points at some distances over the distance, (n,)."""
        reach = 2.0 * self.chi * self.radius
        nearness = np.maximum(reach**2 - distance**2, 0.0) / (reach**2 - 4.0 * self.radius**2)
        return np.asarray(self.strength / (2.0 * self.radius) * nearness**4)

    def between(
        self,
        points: np.ndarray,
        pieces: np.ndarray,
        places: np.ndarray,
        rounds: np.ndarray,
        box: Periodic | None = None,
    ) -> np.ndarray:
        """Return the force on each point, (N, 3).

        Parameters
        ----------
        points : (N, 3) ndarray
        pieces : (N,) ndarray
            Number of the rod or swimmer that a point belongs to.
        places : (N,) ndarray
            Arclength along it.
        rounds : (N,) ndarray
            Length of a closed piece, infinite for an open one.
        box : Periodic, optional
            Whose images repel each other as well.
        """
        reach = 2.0 * self.chi * self.radius
        i, j, between = _near_pairs(points, reach, box)
        along = np.abs(places[i] - places[j])
        along = np.minimum(along, rounds[i] - along)
        by_image = np.linalg.norm(between - (points[i] - points[j]), axis=1) > reach
        apart = (pieces[i] != pieces[j]) | (along > reach) | by_image
        i, j, between = i[apart], j[apart], between[apart]
        push = self._push(np.linalg.norm(between, axis=1))[:, None] * between
        forces = np.zeros_like(points)
        np.add.at(forces, i, push)
        np.subtract.at(forces, j, push)
        return forces


def _near_pairs(
    points: np.ndarray, reach: float, box: Periodic | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return pairs i, j of points nearer than `reach`, and the way from j to i, each pair once.

    In a box the nearest images of points count: copies of those near a face are put beyond the
    opposite one, which serves cells of any shape.
    """
    count = len(points)
    owners = np.arange(count)
    if box is not None:
        margin = reach / box.heights
        if margin.max() > 0.5:
            raise ValueError(
                f"radius must be small beside the box: points repel each other up to {reach:g}, "
                f"and the box is only {box.heights.min():g} high"
            )
        inside = points @ np.linalg.inv(box.vectors)
        inside -= np.floor(inside)
        copies, of = [inside], [owners]
        for shift in product((0.0, -1.0, 1.0), repeat=3):
            moved = inside + shift
            near = np.all((moved > -margin) & (moved < 1.0 + margin), axis=1) & any(shift)
            copies.append(moved[near])
            of.append(np.flatnonzero(near))
        points, owners = np.concatenate(copies) @ box.vectors, np.concatenate(of)
    i, j = scipy.spatial.cKDTree(points).query_pairs(reach, output_type="ndarray").T
    # A pair across a face is found on both sides of the box, once from each point.
    once = (i < count) & ((j < count) | (owners[i] < owners[j]))
    i, j = i[once], j[once]
    return i, owners[j], points[i] - points[j]
