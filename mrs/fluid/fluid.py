"""The fluid that bodies move in."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from mrs import check
from mrs.fluid.flows import Flow
from mrs.fluid.mobility import Boundary, FreeSpace


@check.spelling
@dataclass(frozen=True)
class Fluid:
    """The fluid.

    Parameters
    ----------
    viscosity : float
    epsilon : float, optional
        Blob size of bodies that do not set their own.
    background : Flow, optional
        Its motion without bodies: one of `mrs.flows`, or an object with their methods `velocity`
        and, for rods, `vorticity`.
    boundary : treecode.Boundary, optional
        Walls; the fluid is everywhere by default.
    """

    viscosity: float = 1.0
    epsilon: float | None = None
    background: Flow | None = None
    boundary: Boundary = field(default_factory=FreeSpace)

    def __post_init__(self) -> None:
        check.positive("viscosity", self.viscosity)
        if self.epsilon is not None:
            check.positive("epsilon", self.epsilon)
        flow = self.background
        if flow is not None and not callable(getattr(flow, "velocity", None)):
            raise TypeError(
                "background must be a flow such as mrs.flows.shear(rate=1.0), or "
                f"mrs.flows.UserFlow(function), got {flow!r}"
            )

        if not isinstance(self.boundary, Boundary):
            raise TypeError(f"boundary must be a treecode.Boundary, got {self.boundary!r}")

    def flow(
        self,
        what: str,
        points: np.ndarray,
        time: float,
        name: Callable[[int], str] = "row {}".format,
    ) -> np.ndarray:
        """Return the background's "velocity" or "vorticity" at points, (N, 3); `name` names one."""

        def where(row: int) -> str:
            return f"at {name(row)}, {points[row]}, and time {time:g}"

        value = getattr(self.background, what)(points, time)
        return check.vectors(f"background {what}", value, len(points), where)
