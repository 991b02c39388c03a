"""The contract of a body: rods, swimmers, rigid bodies and tracers are bodies."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from mrs.bodies.noise import Noise
from mrs.describe import described, own_code
from mrs.rigid_motion import GivenMotion, Mounted
from mrs.stiffness import Stiffness
from mrs.time.state import Arrays, State
from treecode.shown import Shown


class Body(Shown):
    """Material points in the fluid, some of which carry a triad.

    A body owns a slice of the state: `positions`, (n, 3), which move with a velocity, and
    `quaternions`, (m, 4), m = n or 0, which turn with an angular velocity. It puts forces, and
    torques if `has_torque`, on the fluid at its *points*, and is given the velocity there, and the
    angular velocity if `has_spin`.

    A body with `has_given_motion` says how its points move, in the place of the forces there: those
    are found so that the fluid moves with the points. Its positions and triads are frames, which
    carry the points: it needs neither `loads` nor `rates`.

    Attributes
    ----------
    kind, name : str
        The kind of body, and the name of this one, also in the names of its files.
    positions, quaternions : ndarray
        The state at time zero.
    length_scale : float
        Errors of positions are judged against it; 0 for points that have no length.
    noise : Noise or None
        Random motion of its pieces, which must have one position each.

    Examples
    --------
    >>> import mrs
    >>> import numpy as np
    >>> class Bead(mrs.Body):
    ...     kind = name = "bead"
    ...     positions, quaternions = np.zeros((1, 3)), np.empty((0, 4))
    ...     length_scale = 0.1
    ...
    ...     def epsilons(self, default):
    ...         return np.array([0.1])
    ...
    ...     def loads(self, time, state):
    ...         return np.array([[0.0, 0.0, -1.0]]), None  # it falls
    ...
    ...     def rates(self, time, state, velocity, spin):
    ...         return velocity, np.empty((0, 3))
    >>> sim = mrs.Simulation(mrs.Fluid(viscosity=1.0), [Bead()])
    >>> print(sim.now.rates.round(4))  # -1 / (4 pi 0.1)
    [[ 0.      0.     -0.7958]]
    """

    kind: str
    name: str
    positions: np.ndarray
    quaternions: np.ndarray
    length_scale: float
    has_force = True
    has_torque = False
    has_spin = False
    has_given_motion = False
    is_stiff = False
    noise: Noise | None = None
    made_with: Mapping[str, Any] = MappingProxyType({})

    def parameters(self) -> dict[str, Any]:
        """Return a description of this body, as plain values.

        A run is resumed only with a body of the same description. Bodies of the package are
        described by the arguments of their making, `made_with`; bodies of a user's class by all
        their attributes, and the code of their methods. A class whose attributes change with time
        returns only the others here.
        """
        said = dict(self.made_with)
        code = own_code(type(self))
        if code:
            said |= {name: value for name, value in vars(self).items() if name != "made_with"}
        return described({"kind": self.kind, **said}) | code

    def epsilons(self, default: float) -> np.ndarray:
        """Return the blob size at each point, (p,); `default` is the fluid's."""
        raise NotImplementedError

    def points(self, time: float, state: State) -> np.ndarray:
        """Return where forces act and velocities are wanted, (p, 3)."""
        return state.positions

    def given_motion(self, time: float, state: State) -> GivenMotion:
        """Return how the points move, of a body with `has_given_motion`."""
        raise NotImplementedError

    def mounted(self, time: float, state: State) -> Mounted | None:
        """Return which points are fixed to another body; none by default."""
        return None

    def loads(self, time: float, state: State) -> tuple[np.ndarray, np.ndarray | None]:
        """Return the forces and torques on the fluid at the points, (p, 3) each."""
        raise NotImplementedError

    def stiffness(self, time: float, state: State) -> Stiffness | None:
        """Return how the loads change with the coordinates, for implicit time steps.

        None, as by default, for a body whose motion is not stiff.
        """
        return None

    def rates(
        self,
        time: float,
        state: State,
        velocity: np.ndarray,
        spin: np.ndarray | None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return velocities of the positions, (n, 3), and angular velocities, (m, 3)."""
        raise NotImplementedError

    def pieces(self) -> np.ndarray:
        """Return for each position the number of its connected piece, (n,); all one by default."""
        return np.zeros(len(self.positions), np.int64)

    def contact_labels(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return for each point the number of its connected piece, its place, the piece's round.

        (p,) each. Points of one piece repel each other only if their places along it are far apart.
        The round is the length of a closed piece, infinite for an open one. By default no points of
        a piece repel each other.
        """
        pieces = self.pieces()
        return pieces, np.zeros(len(pieces)), np.full(len(pieces), np.inf)

    def lengths_of_points(self) -> np.ndarray | None:
        """Return the length that each point stands for, (p,); None where there are no lengths."""
        return None

    def energy(self, time: float, state: State) -> float:
        """Return the elastic energy."""
        return 0.0

    def topology(self) -> tuple[np.ndarray, list[np.ndarray]]:
        """Return the points that are vertices of their own, and the points along each line.

        By default all points are vertices.
        """
        state = State(self.positions, self.quaternions)
        return np.arange(len(self.points(0.0, state))), []

    def constant_fields(self, epsilons: np.ndarray) -> tuple[Arrays, Arrays]:
        """Return arrays at points and at cells that do not change; `epsilons` is (p,)."""
        return {}, {}

    def fields(self, time: float, state: State, **at_points: Any) -> tuple[Arrays, Arrays]:
        """Return arrays at points and at cells for one frame.

        `at_points` has the velocity, and of force, torque and angular_velocity those that the body
        has. They are the fields by default.
        """
        return at_points, {}

    def shown(self) -> dict[str, Any]:
        points = self.points(0.0, State(self.positions, self.quaternions))
        pieces = len(np.unique(self.pieces()))
        return {"name": self.name, "kind": self.kind, "pieces": pieces, "points": len(points)}
