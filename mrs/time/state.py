"""The state of a scene, and the coordinates in which one step is an ordinary differential equation.

Triads live on the sphere of unit quaternions. During a step they are written D = exp(phi) D_n with
rotation vectors phi, zero at its start: then (X, phi) is a plain vector for any method, and triads
stay orthonormal whatever it does.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mrs import rotations

Arrays = dict[str, np.ndarray]
"""Arrays by name."""


def below(arrays: Arrays, prefix: str) -> Arrays:
    """Return the arrays whose names begin with a prefix, by the rest of their names."""
    return {k.removeprefix(prefix): v for k, v in arrays.items() if k.startswith(prefix)}


class State(NamedTuple):
    """Positions, (P, 3), and quaternions, (Q, 4), of all bodies one after the other.

    Examples
    --------
    >>> import mrs
    >>> pusher = mrs.Swimmers([[0, 0, 0]], [[0, 0, 1]], length=1.0, force=1.0, epsilon=0.1)
    >>> state = mrs.Simulation(mrs.Fluid(), [pusher]).state
    >>> turned = state.moved([[0, 0, 0], [3.14159265, 0, 0]])  # a place, and a rotation vector
    >>> print(pusher.orientations(turned.quaternions).round(6) + 0.0)
    [[ 0.  0. -1.]]
    """

    positions: np.ndarray
    quaternions: np.ndarray

    def coordinates(self) -> np.ndarray:
        """Return (X, 0), the local coordinates of this state itself, (P + Q, 3)."""
        return np.concatenate([self.positions, np.zeros((len(self.quaternions), 3))])

    def moved(self, z: np.ndarray) -> State:
        """Return the state with local coordinates z about this one."""
        count = len(self.positions)
        turned = rotations.multiply(rotations.exponential(z[count:]), self.quaternions)
        return State(z[:count], rotations.normalize(turned))

    def coordinates_of(self, other: State) -> np.ndarray:
        """Return the local coordinates about this state of another one, (P + Q, 3)."""
        turn = rotations.multiply(other.quaternions, rotations.conjugate(self.quaternions))
        return np.concatenate([other.positions, rotations.logarithm(turn)])

    def local_rates(self, z: np.ndarray, rates: np.ndarray) -> np.ndarray:
        """Return dz/dt for velocities and angular velocities `rates`, (P + Q, 3)."""
        count = len(self.positions)
        turning = rotations.local_rate(z[count:], rates[count:])
        return np.concatenate([rates[:count], turning])

    def equals(self, other: State) -> bool:
        """Return whether both are bitwise equal."""
        return np.array_equal(self.positions, other.positions) and np.array_equal(
            self.quaternions, other.quaternions
        )
