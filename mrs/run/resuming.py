"""Resuming runs from their last checkpoint."""

from __future__ import annotations

import os
from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import Any

from mrs.output import checkpoint, run_directory
from mrs.output.trackers import Tracker
from mrs.run.scenario import Scenario, ScenarioError
from mrs.run.scenario_files import make, read_input
from mrs.run.simulation import Simulation


def scenario_of(directory: str | os.PathLike[str]) -> Scenario:
    """Return the scenario of a run.

    Raises
    ------
    ScenarioError
        If the run was made by a script.
    """
    if "scenario" not in run_directory.read(directory):
        raise ScenarioError(
            f"{directory}: made by a script; build the same simulation there, and go on with "
            "mrs.restart(sim).run(t_end)"
        )
    return make(*read_input(Path(directory) / run_directory.CONFIG))


def resume(
    directory: str | os.PathLike[str],
    t_end: float | None = None,
    trackers: Iterable[Tracker] = (),
    *,
    changes: bool = False,
    comm: Any = None,
    **options: Any,
) -> Simulation:
    """Go on with a run from its last checkpoint.

    Parameters
    ----------
    directory : path
    t_end : float, optional
        A new end; the end of the run by default.
    trackers : sequence of Tracker, optional
        Besides the trackers that write the run.
    changes : bool, optional
        Whether options in config.toml that change the physics may differ from the checkpoint.
    comm : mpi4py.MPI.Comm, optional
        Ranks that share the sums, in any number.
    **options
        As for `Simulation.run`: `max_walltime`, `renew_files`.

    Returns
    -------
    Simulation
        At its end.

    Raises
    ------
    FileNotFoundError
        If there is no run in the directory.
    ScenarioError
        If the run was made by a script and not from a scenario: build the same simulation there,
        and go on with ``restart(sim).run(t_end)``.

    Examples
    --------
    >>> import mrs
    >>> from mrs.scenarios.fibre_in_shear import FibreInShear
    >>> fibre = FibreInShear(nodes=11, tracers=10)
    >>> stopped = fibre.simulation("outputs/fibre").run(0.1)
    >>> mrs.resume("outputs/fibre", t_end=0.2).time
    0.2
    """
    sim = restart(scenario_of(directory).simulation(Path(directory), comm=comm), changes=changes)
    sim.trackers.extend(trackers)
    noted = run_directory.read(directory)["run"]["t_end"]
    return sim.run(noted if t_end is None else t_end, **options)


def restart(sim: Simulation, *, changes: bool = False) -> Simulation:
    """Return `sim` in the state of the last checkpoint in its run directory, ready for `run`.

    Parameters
    ----------
    sim : Simulation
        Built as for the run, with its output directory.
    changes : bool, optional
        Whether fluid, bodies and forces may differ from the run. Each difference is told in any
        case; another backend, integrator or output is always accepted.

    Raises
    ------
    FileNotFoundError
        If there is no checkpoint.
    ValueError
        If `sim` has no output directory, or is another scene; see `Simulation.restore`.

    Examples
    --------
    >>> import mrs
    >>> def scene():
    ...     fluid, dust = mrs.Fluid(background=mrs.flows.shear(1.0)), mrs.Tracers([[0, 0, 1]])
    ...     output = mrs.Output("outputs/sheared", interval=0.5)
    ...     return mrs.Simulation(fluid, [dust], output=output)
    >>> stopped = scene().run(1.0)
    >>> sim = mrs.restart(scene()).run(2.0)  # perhaps in another process
    >>> mrs.open_run("outputs/sheared").times.tolist()
    [0.0, 0.5, 1.0, 1.5, 2.0]
    """
    if sim.output is None:
        raise ValueError("sim must have an output directory to go on from")
    path = Path(sim.output.directory) / run_directory.CHECKPOINT
    with sim.ranks.together():
        content = sim.ranks.lead(sim.scene, partial(checkpoint.load, path))
        sim.restore(*content, changes=changes)
    return sim
