"""A force that acts at the points of all bodies, besides the loads of each body."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from mrs.bodies.layout import Layout
from mrs.fluid import Fluid
from mrs.time.state import State


class Force:
    """The contract of a force: repulsion, gravity, springs between bodies.

    A subclass has `forces`; or `loads`, if it depends on triads, or has torques.

    Attributes
    ----------
    kind : str
        Its name in TOML files.

    Examples
    --------
    >>> import mrs
    >>> import numpy as np
    >>> class Pull(mrs.Force):
    ...     kind = "pull"
    ...
    ...     def forces(self, time, points, layout, fluid):
    ...         return np.tile([0.0, 0.0, -6.0 * np.pi / len(points)], (len(points), 1))
    >>> ball = mrs.Rigid(mrs.surfaces.sphere(radius=1.0, count=100))
    >>> sim = mrs.Simulation(mrs.Fluid(), [ball], forces=[Pull()])
    >>> print(round(sim.now.rates[0, 2], 2))  # Stokes: -1
    -0.99
    """

    kind: ClassVar[str]

    def require(self, layout: Layout, fluid: Fluid) -> None:
        """Refuse a scene in which the force cannot act, by a ValueError.

        It is called once, when the scene is made.
        """

    def forces(self, time: float, points: np.ndarray, layout: Layout, fluid: Fluid) -> np.ndarray:
        """Return the forces on the fluid, (F, 3), at the points that can have some.

        Parameters
        ----------
        time : float
        points : (F, 3) ndarray
            Points of the bodies that put forces on the fluid, ``layout.forced``.
        layout : Layout
            Tells the body of each point.
        fluid : Fluid
            Its boundary may push as well.
        """
        raise NotImplementedError

    def loads(
        self, time: float, state: State, points: np.ndarray, layout: Layout, fluid: Fluid
    ) -> tuple[np.ndarray, np.ndarray | None]:
        """Return the forces and the torques on the fluid, (F, 3) each; None for no torques.

        The arguments are those of `forces`, and the state of all bodies. Torques must be zero at
        points whose bodies have none. By default there are `forces` only.
        """
        return self.forces(time, points, layout, fluid), None

    def energy(self, time: float, points: np.ndarray, layout: Layout, fluid: Fluid) -> float:
        """Return the elastic energy, which is counted with that of the bodies; 0 by default."""
        return 0.0
