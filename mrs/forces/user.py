"""A force of one's own, from functions."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from mrs import check
from mrs.bodies.layout import Layout
from mrs.fluid import Fluid
from mrs.forces.base import Force
from mrs.time.state import State

Function = Callable[[float, np.ndarray, State], Any]


@check.spelling
class UserForce(Force):
    """A force, a torque, or both, on one body.

    The functions take the time, the body's points, (p, 3), and its state, an `mrs.State` of
    positions and quaternions. Each returns (p, 3), or (3,) for all points alike.

    Parameters
    ----------
    body : str
        Its name.
    force, torque : callable, optional
        On the fluid, at each point. Only points that have triads take torques: those of rods.

    Raises
    ------
    ValueError, TypeError
        If neither is given; in a scene, if the body is not there, or takes no torque.

    Examples
    --------
    >>> import mrs
    >>> import numpy as np
    >>> ball = mrs.Rigid(mrs.surfaces.sphere(radius=1.0, count=100), name="ball")
    >>> def trap(time, points, state):  # a spring to the plane x = 1
    ...     return 6.0 * np.pi / len(points) * np.array([1.0 - state.positions[0, 0], 0.0, 0.0])
    >>> sim = mrs.Simulation(mrs.Fluid(), [ball], forces=[mrs.UserForce("ball", trap)])
    >>> print(round(sim.now.rates[0, 0], 2))
    0.99
    """

    kind = "user"

    def __init__(
        self, body: str, force: Function | None = None, torque: Function | None = None
    ) -> None:
        self.body = body
        if force is None and torque is None:
            raise ValueError("force or torque must be given")
        self.functions = [
            None if function is None else check.function(name, function, "time, points and state")
            for name, function in (("force", force), ("torque", torque))
        ]

    def require(self, layout: Layout, fluid: Fluid) -> None:
        """Refuse the name of no body, and a torque on a body that takes none."""
        part, _ = layout.forced_part("body", self.body)
        if self.functions[1] is not None and not part.body.has_torque:
            raise ValueError(
                f"torque must be None for {self.body!r}, which puts no torques on the fluid"
            )

    def loads(
        self, time: float, state: State, points: np.ndarray, layout: Layout, fluid: Fluid
    ) -> tuple[np.ndarray, np.ndarray | None]:
        """Return what the functions give, at the points of the body; zero at the others."""
        part, rows = layout.forced_part("body", self.body)

        def where(row: int) -> str:
            return f"at node {row} of {self.body!r} and time {time:g}"

        def spread(name: str, function: Function | None) -> np.ndarray:
            values = np.zeros_like(points)
            if function is not None:
                given = function(time, points[rows], part.state(state))
                count = rows.stop - rows.start
                values[rows] = check.vectors(f"{name} on {self.body!r}", given, count, where)
            return values

        force, torque = self.functions
        return spread("force", force), None if torque is None else spread("torque", torque)
