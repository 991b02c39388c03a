"""A kind of body: points on which a constant force acts."""

import numpy as np

import mrs


@mrs.BODIES.register
class Weights(mrs.Body):
    """Points that are pulled.

    Parameters
    ----------
    positions : (n, 3) array_like
    force : (3,) array_like
        On the fluid, of each point.
    epsilon : float
    """

    kind = "weights"

    def __init__(
        self,
        positions: list[tuple[float, float, float]],
        force: tuple[float, float, float],
        epsilon: float,
        name: str = "weights",
    ) -> None:
        self.positions = np.array(positions, float)
        self.quaternions = np.empty((0, 4))
        self.length_scale = epsilon
        self.force, self.epsilon, self.name = np.array(force, float), epsilon, name

    def epsilons(self, default):
        return np.full(len(self.positions), self.epsilon)

    def loads(self, time, state):
        return np.tile(self.force, (len(state.positions), 1)), None

    def rates(self, time, state, velocity, spin):
        return velocity, np.empty((0, 3))

    def pieces(self):
        return np.arange(len(self.positions))
