"""A force that acts at the points of all bodies, besides the loads of each body."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from mrs.bodies.layout import Layout
from mrs.fluid import Fluid


class Force:
    """The contract of a force: repulsion, gravity, springs between bodies.

    Attributes
    ----------
    kind : str
        Its name in TOML files.
    """

    kind: ClassVar[str]

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
