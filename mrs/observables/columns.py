"""Observables of a run that goes on, as columns of its log.

Each is a function of the simulation. If it has `labels`, it gives one number for each of them. Its
method `require` refuses a simulation in which it cannot be measured.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from mrs import check, rotations
from mrs.fluid import Periodic, Wall
from mrs.observables import flow, motion, structure
from mrs.registry import Registry
from mrs.time.state import State

if TYPE_CHECKING:
    from mrs.run.simulation import Simulation

OBSERVABLES: Registry[type[Any]] = Registry("observable", "kind")
"""Classes of functions of a simulation, by the names with which a TOML file asks for them."""


def from_tables(tables: Mapping[str, Mapping[str, Any]]) -> dict[str, Callable[[Simulation], Any]]:
    """Return columns of the log by name, from their kinds and arguments.

    Parameters
    ----------
    tables : dict of dict
        Of each column: "kind", and the arguments of that class.

    Raises
    ------
    ValueError
        The message names the column, the argument and the allowed values.
    """
    return {name: _from_table(name, dict(table)) for name, table in tables.items()}


def _from_table(name: str, options: dict[str, Any]) -> Callable[[Simulation], Any]:
    try:
        kind = check.one_of("kind", options.pop("kind", None), OBSERVABLES)
        return OBSERVABLES[kind](**options)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name}: {error}") from None


@OBSERVABLES.register
@check.spelling
class Flux:
    """Volume of fluid per time through a rectangle: `flux`.

    Parameters
    ----------
    corner, sides, order
        As for `Rectangle`.

    Examples
    --------
    >>> import mrs
    >>> section = mrs.observables.Flux(corner=(0, -1, -1), sides=[(0, 2, 0), (0, 0, 2)])
    >>> fluid = mrs.Fluid(background=mrs.flows.poiseuille(speed=1.0, radius=2.0))
    >>> output = mrs.Output("outputs/tube", interval=1.0, columns={"Q": section})
    >>> sim = mrs.Simulation(fluid, [mrs.Tracers([[0, 0, 0]])], output=output).run(1.0)
    >>> print(mrs.open_run("outputs/tube").log["Q"].round(6))  # 4 (1 - 1/6)
    [3.333333 3.333333]
    """

    kind = "flux"

    def __init__(self, corner: ArrayLike, sides: ArrayLike, order: int = 16) -> None:
        self.rectangle = flow.Rectangle(corner, sides, order)

    def __call__(self, sim: Simulation) -> float:
        """Return the flux now."""
        return flow.flux(sim.velocity, self.rectangle)


@OBSERVABLES.register
@check.spelling
class VelocityProfile:
    """Mean velocity, along a direction, over rectangles at some heights: `velocity_profile`.

    Parameters
    ----------
    heights : (k,) array_like
        Along the normal of the rectangle, from it.
    corner, sides, order
        As for `Rectangle`.
    direction : (3,) array_like, optional

    Examples
    --------
    >>> import mrs
    >>> profile = mrs.observables.VelocityProfile([0, 1, 2], (0, 0, 0), [(1, 0, 0), (0, 1, 0)])
    >>> fluid, dust = mrs.Fluid(background=mrs.flows.shear(1.0)), mrs.Tracers([[0, 0, 1]])
    >>> print(profile(mrs.Simulation(fluid, [dust])).round(6))
    [0. 1. 2.]
    """

    kind = "velocity_profile"

    def __init__(
        self,
        heights: ArrayLike,
        corner: ArrayLike,
        sides: ArrayLike,
        order: int = 16,
        direction: ArrayLike = (1.0, 0.0, 0.0),
    ) -> None:
        self.heights = check.shaped("heights", heights, (np.size(heights),))
        self.rectangle = flow.Rectangle(corner, sides, order)
        self.direction = check.direction("direction", direction)
        self.labels = _labels(self.heights)

    def __call__(self, sim: Simulation) -> np.ndarray:
        """Return the mean velocity at each height now, (k,)."""
        return flow.velocity_profile(sim.velocity, self.rectangle, self.heights) @ self.direction


@OBSERVABLES.register
@check.spelling
class PumpedFlux:
    """Volume per time that all loads pump along the wall of the fluid: `pumped_flux`.

    Parameters
    ----------
    direction : (3,) array_like, optional
        Along the wall.

    Examples
    --------
    >>> import mrs
    >>> import numpy as np
    >>> pusher = mrs.Swimmers([[0, 0, 2]], [[0.6, 0, 0.8]], length=1.0, force=1.0, epsilon=0.1)
    >>> sim = mrs.Simulation(mrs.Fluid(boundary=mrs.Wall()), [pusher])
    >>> print(round(np.pi * mrs.observables.PumpedFlux()(sim), 4))  # 0.6 (2 - 1.2)
    0.48
    """

    kind = "pumped_flux"

    def __init__(self, direction: ArrayLike = (1.0, 0.0, 0.0)) -> None:
        self.direction = direction
        check.direction("direction", direction)

    def require(self, sim: Simulation) -> None:
        """Refuse a fluid without a wall, and a direction that is not along it."""
        wall = sim.fluid.boundary
        if not isinstance(wall, Wall):
            raise ValueError(f"the fluid must have a wall (mrs.Wall), got {wall}")
        flow.along_wall(wall, self.direction)

    def __call__(self, sim: Simulation) -> float:
        """Return the pumped flux now."""
        now, fluid, wall = sim.now, sim.fluid, sim.fluid.boundary
        assert isinstance(wall, Wall)
        return flow.pumped_flux(now.points, now.loads, fluid.viscosity, self.direction, wall)


class _OfBody:
    """Something of one body.

    Parameters
    ----------
    body : str
        Its name.
    """

    of_directions = False

    def __init__(self, body: str) -> None:
        self.body = check.file_name("body", body)

    def require(self, sim: Simulation) -> None:
        """Refuse a simulation without the body, or a body without directions if it needs them."""
        bodies = {body.name: body for body in sim.bodies}
        body = bodies[check.one_of("body", self.body, bodies)]
        if self.of_directions and not len(body.quaternions):
            raise ValueError(f"body must have directions, {self.body!r} has none")

    def states(self, sim: Simulation) -> tuple[State, State]:
        """Return the state at time zero, and now."""
        body = next(body for body in sim.bodies if body.name == self.body)
        return State(body.positions, body.quaternions), sim.body_state(body)


def _directions(state: State) -> np.ndarray:
    """Return D3, (n, 3): the directions of swimmers, and of rods at their nodes."""
    return rotations.rotate(state.quaternions, np.array([[0.0, 0.0, 1.0]]))


@OBSERVABLES.register
@check.spelling
class MeanSquareDisplacement(_OfBody):
    """Mean square of the ways of a body's positions since time zero: `mean_square_displacement`.

    Parameters
    ----------
    body : str
        Its name.

    Examples
    --------
    >>> import mrs
    >>> fluid, dust = mrs.Fluid(background=mrs.flows.shear(1.0)), mrs.Tracers([[0, 0, 2]])
    >>> sim = mrs.Simulation(fluid, [dust]).run(1.0)
    >>> print(round(mrs.observables.MeanSquareDisplacement("tracers")(sim), 6))
    4.0
    """

    kind = "mean_square_displacement"

    def __call__(self, sim: Simulation) -> float:
        """Return the mean square displacement now."""
        positions = [state.positions for state in self.states(sim)]
        return motion.mean_square_displacement([0.0, 1.0], positions, "first")[1]


@OBSERVABLES.register
@check.spelling
class OrientationMemory(_OfBody):
    """Mean of p(0) . p(t): `orientation_memory`.

    Parameters
    ----------
    body : str
        Name of swimmers, or of rods, of which p is D3 of each node.

    Examples
    --------
    >>> import mrs
    >>> pusher = mrs.Swimmers([[0, 0, 0]], [[0, 0, 1]], length=1.0, force=1.0, epsilon=0.1)
    >>> sim = mrs.Simulation(mrs.Fluid(), [pusher]).run(1.0)
    >>> print(round(mrs.observables.OrientationMemory("swimmers")(sim), 6))
    1.0
    """

    kind = "orientation_memory"
    of_directions = True

    def __call__(self, sim: Simulation) -> float:
        """Return the mean now."""
        directions = [_directions(state) for state in self.states(sim)]
        return motion.orientation_memory([0.0, 1.0], directions, "first")[1]


class _ByDistance(_OfBody):
    """Something of one body by distance.

    Parameters
    ----------
    body : str
        Its name.
    bins : (k + 1,) array_like
        Edges of the bins.
    cell : (3,) or (3, 3) array_like, optional
        Of a periodic box; by default that of the fluid, if it is in one.
    """

    def __init__(self, body: str, bins: ArrayLike, cell: ArrayLike | None = None) -> None:
        super().__init__(body)
        self.bins, self.cell = structure.bin_edges(bins), cell
        if cell is not None:
            Periodic(cell)  # refuse it now
        self.labels = _labels(0.5 * (self.bins[1:] + self.bins[:-1]))

    def require(self, sim: Simulation) -> None:
        """Refuse a simulation as others do, or one in a cell that is too small for the bins."""
        super().require(sim)
        box = sim.fluid.narrowest_boundary if self.cell is None else Periodic(self.cell)
        if isinstance(box, Periodic):
            structure.require_within(self.bins[-1], box)

    def cell_of(self, sim: Simulation) -> ArrayLike | None:
        """Return the cell of a periodic box now, or None."""
        box = sim.fluid.boundary_at(sim.time)
        return box.vectors if self.cell is None and isinstance(box, Periodic) else self.cell


@OBSERVABLES.register
@check.spelling
class PairDistribution(_ByDistance):
    """g(r), with the middles of the bins as labels: `pair_distribution`.

    Parameters
    ----------
    body : str
        Its name.
    bins, cell
        As for `pair_distribution`.

    Examples
    --------
    >>> import mrs
    >>> positions, directions = mrs.lattice_suspension((4, 4, 4), 1.0)
    >>> swimmers = mrs.Swimmers(positions, directions, length=0.5, force=1.0, epsilon=0.1)
    >>> g = mrs.observables.PairDistribution("swimmers", bins=[0.0, 0.9, 1.1], cell=(4, 4, 4))
    >>> g(mrs.Simulation(mrs.Fluid(), [swimmers]))
    array([0.        , 2.41716098])
    """

    kind = "pair_distribution"

    def __call__(self, sim: Simulation) -> np.ndarray:
        """Return g in each bin now, (k,)."""
        _, now = self.states(sim)
        return structure.pair_distribution(now.positions, self.bins, self.cell_of(sim))


@OBSERVABLES.register
@check.spelling
class OrientationCorrelation(_ByDistance):
    """Mean of p_i . p_j by distance, with the middles of the bins as labels.

    Parameters
    ----------
    body : str
        Name of swimmers, or of rods, of which p is D3 of each node.
    bins, cell
        As for `orientation_correlation`.

    Examples
    --------
    >>> import mrs
    >>> positions, directions = mrs.lattice_suspension((3, 3, 3), 1.0, direction=(1, 0, 0))
    >>> swimmers = mrs.Swimmers(positions, directions, length=0.5, force=1.0, epsilon=0.1)
    >>> sim = mrs.Simulation(mrs.Fluid(), [swimmers])
    >>> mrs.observables.OrientationCorrelation("swimmers", bins=[0.5, 1.2, 2.0])(sim)
    array([1., 1.])
    """

    kind = "orientation_correlation"
    of_directions = True

    def __call__(self, sim: Simulation) -> np.ndarray:
        """Return the mean in each bin now, (k,)."""
        _, now = self.states(sim)
        along, cell = _directions(now), self.cell_of(sim)
        return structure.orientation_correlation(now.positions, along, self.bins, cell)


def _labels(values: np.ndarray) -> tuple[str, ...]:
    """Return what numbers are called in the log, without the rounding of their last digits."""
    return tuple(f"{value:.12g}" for value in values)
