"""A constant force on bodies: their weight, less their buoyancy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from mrs import check
from mrs.bodies.layout import Layout
from mrs.fluid import Fluid
from mrs.forces.base import Force

Vector = tuple[float, float, float]


@check.spelling
@dataclass(frozen=True)
class Gravity(Force):
    """The same force on each point, or on each length, of some bodies.

    Parameters
    ----------
    per_point : (3,) array_like, optional
        Force on each point. A swimmer has two points, a rod its nodes.
    per_length : (3,) array_like, optional
        Force on each length of rods: on a node, half of that on the segments that meet there.
    bodies : sequence of str, optional
        Names of the bodies; all that put forces on the fluid by default.

    Raises
    ------
    ValueError, TypeError
        If not exactly one of the two forces is given; in a scene, if a body is not there, or has
        no length.

    Examples
    --------
    >>> import mrs
    >>> import numpy as np
    >>> ball = mrs.Rigid(mrs.surfaces.sphere(radius=1.0, count=100))
    >>> weight = mrs.Gravity(per_point=(0.0, 0.0, -6.0 * np.pi / 100))
    >>> sim = mrs.Simulation(mrs.Fluid(viscosity=2.0), [ball], forces=[weight])
    >>> print(round(sim.now.rates[0, 2], 2))  # Stokes: -1 / viscosity
    -0.49
    """

    kind: ClassVar[str] = "gravity"
    __pydantic_config__: ClassVar[dict[str, str]] = {"extra": "forbid"}

    per_point: Vector | None = None
    per_length: Vector | None = None
    bodies: list[str] | None = None

    def __post_init__(self) -> None:
        given = {k: v for k in ("per_point", "per_length") if (v := getattr(self, k)) is not None}
        if len(given) != 1:
            raise ValueError(
                f"per_point or per_length must be given, not both, got per_point={self.per_point} "
                f"and per_length={self.per_length}"
            )
        for name, force in given.items():
            check.vector(name, force)
        if isinstance(self.bodies, str):
            raise TypeError(f"bodies must be a list of names, got {self.bodies!r}")

    def require(self, layout: Layout, fluid: Fluid) -> None:
        """Refuse names of no body, and bodies without length."""
        self._weights(layout)

    def forces(self, time: float, points: np.ndarray, layout: Layout, fluid: Fluid) -> np.ndarray:
        """Return the force on each point, (F, 3)."""
        force = self.per_point if self.per_length is None else self.per_length
        return np.outer(self._weights(layout), np.asarray(force, float))

    def _weights(self, layout: Layout) -> np.ndarray:
        """Return what the force is multiplied with at each point, (F,)."""
        weights = np.zeros(len(layout.forced))
        names = layout.forced_names if self.bodies is None else self.bodies
        for name in names:
            part, rows = layout.forced_part("bodies", name)
            if self.per_length is None:
                weights[rows] = 1.0
                continue
            lengths = part.body.lengths_of_points()
            if lengths is None:
                raise ValueError(
                    f"per_length must be for bodies that have a length, as rods do, got {name!r}; "
                    "give per_point, or the names of others in bodies"
                )
            weights[rows] = lengths
        return weights
