"""Short-range repulsion, so that bodies do not pass through each other."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import scipy

from mrs import check
from mrs.bodies.layout import Layout
from mrs.forces.base import Force


@check.spelling
@dataclass(frozen=True)
class Steric(Force):
    """Pairwise repulsion of points nearer than ``2 chi a``, of zero net force and torque.

    F_ij = (strength / 2a) [(4 chi^2 a^2 - r^2) / (4 chi^2 a^2 - 4 a^2)]^4 r_ij, which is `strength`
    at contact, r = 2a. Points of one rod nearer than that along the rod do not repel each other,
    nor do the two particles of one swimmer.

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

    def forces(self, time: float, points: np.ndarray, layout: Layout) -> np.ndarray:
        """Return the force on each point, (F, 3)."""
        return self.between(points, *layout.contact_labels)

    def between(
        self, points: np.ndarray, pieces: np.ndarray, places: np.ndarray, rounds: np.ndarray
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
        """
        reach = 2.0 * self.chi * self.radius
        i, j = scipy.spatial.cKDTree(points).query_pairs(reach, output_type="ndarray").T
        along = np.abs(places[i] - places[j])
        along = np.minimum(along, rounds[i] - along)
        apart = (pieces[i] != pieces[j]) | (along > reach)
        i, j = i[apart], j[apart]
        between = points[i] - points[j]
        distance2 = np.einsum("ni,ni->n", between, between)
        nearness = (reach**2 - distance2) / (reach**2 - 4.0 * self.radius**2)
        push = (self.strength / (2.0 * self.radius) * nearness**4)[:, None] * between
        forces = np.zeros_like(points)
        np.add.at(forces, i, push)
        np.subtract.at(forces, j, push)
        return forces
