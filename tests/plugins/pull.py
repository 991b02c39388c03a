"""A kind of force: the same at all points."""

import numpy as np

import mrs


@mrs.FORCES.register
class Pull(mrs.Force):
    """A constant force.

    Parameters
    ----------
    force : (3,) array_like
        On the fluid, of each point.
    """

    kind = "pull"

    def __init__(self, force: tuple[float, float, float]) -> None:
        self.force = np.array(force, float)

    def forces(self, time, points, layout, fluid):
        return np.tile(self.force, (len(points), 1))
