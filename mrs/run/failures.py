"""Steps after which a run cannot go on, and the errors that tell the user."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mrs import check
from mrs.time.state import State
from mrs.time.stepper import NotFiniteError, StepSizeError

if TYPE_CHECKING:
    from mrs.run.simulation import Simulation


class SimulationError(RuntimeError):
    """A run that cannot go on; the message says where and why."""


def require_whole(sim: Simulation, state: State) -> None:
    """Refuse a step that tears a body apart: frames of it would show nothing but the tearing.

    A node is compared with the mean motion of its piece, since a whole rod may be carried far.
    """
    for part in sim.scene.layout.parts:
        if not part.body.has_force:
            continue
        own = state.positions[part.positions] - sim.state.positions[part.positions]
        length = part.body.length_scale
        if np.abs(own).max(initial=0.0) <= 0.5 * length:
            continue
        pieces = part.body.pieces()
        count = np.bincount(pieces)[:, None]
        mean = np.column_stack([np.bincount(pieces, column) for column in own.T]) / count
        distance = np.linalg.norm(own - mean[pieces], axis=1)
        node = int(np.argmax(distance))
        if distance[node] > length:
            raise SimulationError(
                f"node {node} of {part.body.name!r} would move by "
                f"{distance[node] / length:.3g} lengths of its body in the step {_place(sim)}"
            )


def explained(sim: Simulation, error: BaseException) -> BaseException:
    """Return the error for the user, in place of one that a step has raised."""
    if isinstance(error, NotFiniteError):
        name = sim.scene.layout.coordinate_name(error.row)
        return SimulationError(f"{name} is not finite {_place(sim)}")
    if isinstance(error, StepSizeError):
        return SimulationError(
            f"at time {sim.time:g} no step is small enough for tolerance "
            f"{sim.integrator.tolerance:g}; allow a larger one, or look for forces, "
            "lengths or times out of scale"
        )
    if isinstance(error, (FloatingPointError, check.FunctionError)):
        return SimulationError(f"at time {sim.time:g}: {error}")
    return error


def _place(sim: Simulation) -> str:
    """Return the moment of the run, and advice about steps that are too long."""
    return (
        f"after time {sim.time:g} (step {sim.stepper.steps}, dt {sim.stepper.taken:g}, "
        f"dt x lambda_max {sim.stepper.h_lambda:.3g}); use a smaller dt, dt='auto' or "
        "the integrator 'rkc2'"
    )
