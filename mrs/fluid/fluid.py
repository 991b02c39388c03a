"""The fluid that bodies move in."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from mrs import check
from mrs.fluid.flows import Flow
from mrs.fluid.mobility import Boundary, FreeSpace
from mrs.fluid.sheared import carried, is_linear, narrowest, require_carried
from mrs.registry import Registry
from treecode import Periodic, Wall

BOUNDARIES: Registry[type[Boundary]] = Registry("boundary", "kind")
BOUNDARIES.register(Wall)
BOUNDARIES.register(Periodic)

_STILL = 1e-9  # part of the background's speed near a wall that it may have at the wall


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
        For example `mrs.Wall`, `mrs.Periodic`; the fluid is everywhere by default. A shear flow
        carries a periodic box along: the box that is given is that of time 0.

    Raises
    ------
    ValueError, TypeError
        For an argument that is out of its range; if the background flows at a wall, or differs
        from box to box.

    Examples
    --------
    >>> import mrs
    >>> water = mrs.Fluid(viscosity=1e-3, background=mrs.flows.poiseuille(speed=1.0, radius=2.0))
    >>> dust = mrs.Tracers([[0.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    >>> print(mrs.Simulation(water, [dust]).now.rates)
    [[1.   0.   0.  ]
     [0.75 0.   0.  ]]
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
        if flow is not None and isinstance(self.boundary, Wall):
            _require_still(flow, self.boundary)
        if flow is not None and isinstance(self.boundary, Periodic):
            if is_linear(flow):
                require_carried(flow, self.boundary)
            else:
                _require_periodic(flow, self.boundary)

    def boundary_at(self, time: float) -> Boundary:
        """Return the boundary where it is at a time; only boxes in a shear flow move."""
        return carried(self.boundary, self.background, time)

    def carried(self, vectors: np.ndarray, time: float) -> np.ndarray:
        """Return vectors of the lattice, (N, 3), of time 0, where they are at a time."""
        flow = self.background
        return vectors + time * vectors @ flow.gradient.T if is_linear(flow) else vectors

    @property
    def narrowest_boundary(self) -> Boundary:
        """The boundary when the cell of a box is the lowest: a shear flow inclines it."""
        return narrowest(self.boundary, self.background)

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


def _require_still(flow: Flow, wall: Wall) -> None:
    """Refuse a background that is not zero at some points of a wall."""
    places = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [-0.7, 0.4], [30.0, -20.0]])
    along, normal = wall.frame[:2], wall.frame[2]
    points = np.array(wall.point) + places @ along
    at_wall = check.vectors("background velocity", flow.velocity(points, 0.0), len(points), str)
    above = check.vectors(
        "background velocity", flow.velocity(points + normal, 0.0), len(points), str
    )
    speeds = np.linalg.norm(at_wall, axis=1)
    row = int(np.argmax(speeds))
    if speeds[row] > _STILL * np.linalg.norm(above, axis=1).max():
        raise ValueError(
            f"background must be zero at the wall, as mrs.flows.shear is at its origin, got "
            f"velocity {at_wall[row]} at {points[row]}"
        )


def _require_periodic(flow: Flow, box: Periodic) -> None:
    """Refuse a background that is not the same in the next images of a box, at some points."""
    vectors = box.vectors
    points = np.array([[0.0, 0.0, 0.0], [0.31, 0.53, 0.78], [0.9, 0.2, 0.4]])
    points *= np.abs(vectors).max()
    moved = (points[:, None] + vectors).reshape(-1, 3)
    here, there = (
        check.vectors("background velocity", flow.velocity(some, 0.0), len(some), str)
        for some in (points, moved)
    )
    count = len(vectors)
    if np.abs(there - np.repeat(here, count, axis=0)).max() > _STILL * np.abs(there).max():
        raise ValueError(
            f"background must be the same in each box of {box}, got one with velocity {here[0]} at "
            f"{points[0]} and {', '.join(map(str, there[:count]))} in the next boxes"
        )
