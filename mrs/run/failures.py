"""Steps and files after which a run cannot go on, and the errors that tell the user."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mrs import check
from mrs.output import run_directory
from mrs.time.state import State
from mrs.time.system import ConvergenceError, NotFiniteError, StepSizeError

if TYPE_CHECKING:
    from mrs.run.simulation import Simulation


class SimulationError(RuntimeError):
    """A run that cannot go on; the message says where and why.

    Examples
    --------
    >>> import mrs
    >>> import numpy as np
    >>> burst = mrs.flows.UserFlow(lambda points, time: [1.0 if time < 0.5 else np.nan, 0, 0])
    >>> sim = mrs.Simulation(mrs.Fluid(background=burst), [mrs.Tracers([[0, 0, 0]])])
    >>> sim.run(1.0)
    Traceback (most recent call last):
        ...
    mrs.run.failures.SimulationError: at time 0.5: background velocity must ...
    """


def require_whole_files(sim: Simulation, directory: Path, renew_files: bool) -> None:
    """Look at all files of a resumed run before any of them is touched.

    Those that are missing or damaged are refused, or set aside to be begun anew.
    """
    damaged: dict[Path, str] = {}
    for tracker in sim.trackers:
        damaged |= tracker.damaged_files(sim)
    if damaged and not renew_files:
        lines = [f"{path} {fault}" for path, fault in damaged.items()]
        raise SimulationError(
            f"the run cannot go on from t = {sim.time:g}; nothing was changed\n  "
            + "\n  ".join(lines)
            + "\nput back what is missing or wrong, or let it begin anew from here with "
            f"`mrs resume {directory} --renew-files` (run(..., renew_files=True)); damaged "
            "files are then kept beside the new ones"
        )
    for path in damaged:
        run_directory.set_aside(path)
        sim.written.pop(path.name, None)


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
    if isinstance(error, ConvergenceError):
        return SimulationError(f"the equations of the implicit step were not solved {_place(sim)}")
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
