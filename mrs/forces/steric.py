"""Short-range repulsion, so that bodies do not pass through each other."""

from __future__ import annotations

from dataclasses import dataclass
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

    Examples
    --------
    >>> import mrs
    >>> import numpy as np
    >>> repulsion = mrs.Steric(strength=4.0, radius=0.5)
    >>> pair = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])  # in contact
    >>> pieces, ends, open_lines = np.array([0, 1]), np.zeros(2), np.full(2, np.inf)
    >>> print(repulsion.between(pair, pieces, ends, open_lines).round(6))
    [[-4.  0.  0.]
     [ 4.  0.  0.]]
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
        boundary = fluid.boundary_at(time)
        box = boundary if isinstance(boundary, Periodic) else None
        if isinstance(fluid.narrowest_boundary, Periodic):
            self._require_room(fluid.narrowest_boundary)
        forces = self.between(points, *layout.contact_labels, box=box)
        if isinstance(boundary, Wall):
            forces += self.from_wall(points, boundary)
        return forces

    @property
    def reach(self) -> float:
        """Distance from which points repel each other."""
        return 2.0 * self.chi * self.radius

    def from_wall(self, points: np.ndarray, wall: Wall) -> np.ndarray:
        """Return the repulsion of points, (N, 3), by their mirror images in a wall."""
        distance = 2.0 * wall.heights(points)
        return self._push(distance**2)[:, None] * np.outer(distance, wall.normal)

    def _push(self, distance2: np.ndarray) -> np.ndarray:
        """Return the repulsion over the distance, (n,), at squares of distances."""
        nearness = np.maximum(self.reach**2 - distance2, 0.0)
        nearness /= self.reach**2 - 4.0 * self.radius**2
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
        spots, owners = points, np.arange(len(points))
        if box is not None:
            spots, owners = box.with_images(points, self.reach)
        pairs = scipy.spatial.cKDTree(spots).query_pairs(self.reach, output_type="ndarray")
        i, j = owners[pairs].T
        along = np.abs(places[i] - places[j])
        along = np.minimum(along, rounds[i] - along)
        apart = (pieces[i] != pieces[j]) | (along > self.reach)
        if box is not None:
            first, second = pairs.T
            shift = spots[first] - spots[second] - (points[i] - points[j])
            apart |= np.linalg.norm(shift, axis=1) > self.reach  # a piece meets its own image
            # A pair across a face is found on both sides of the box, once from each point.
            apart &= (first < len(points)) & ((second < len(points)) | (i < j))
        i, j, (first, second) = i[apart], j[apart], pairs[apart].T
        between = spots[first] - spots[second]
        push = self._push(np.einsum("ni,ni->n", between, between))[:, None] * between
        forces = np.zeros_like(points)
        np.add.at(forces, i, push)
        np.subtract.at(forces, j, push)
        return forces

    def _require_room(self, box: Periodic) -> None:
        """Refuse a box in which a point could touch two images of another."""
        if self.reach > 0.5 * box.heights.min():
            raise ValueError(
                f"radius must be small beside the box: points repel each other up to "
                f"{self.reach:g}, and the box is only {box.heights.min():g} high"
            )
