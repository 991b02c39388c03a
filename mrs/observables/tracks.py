"""What observables are computed from, read from the files of a run."""

from __future__ import annotations

import os
from typing import NamedTuple

import numpy as np

from mrs import check
from mrs.output.frames import trajectory_paths
from mrs.output.stored import StoredFrame, stored_lattices
from mrs.output.trajectory import Trajectory

_DIRECTIONS = ("orientation", "d3")  # of swimmers, of nodes of rods
_FLAGELLUM = 1  # in the array "bead"


class Tracks(NamedTuple):
    """Positions and directions of one body in all frames.

    Examples
    --------
    >>> import mrs
    >>> fluid, dust = mrs.Fluid(background=mrs.flows.shear(1.0)), mrs.Tracers([[0, 0, 1]])
    >>> output = mrs.Output("outputs/sheared", interval=0.5)
    >>> sim = mrs.Simulation(fluid, [dust], output=output).run(1.0)
    >>> times, positions, directions, cell = mrs.observables.tracks("outputs/sheared", "tracers")
    >>> positions.shape, directions is None, cell is None
    ((3, 1, 3), True, True)
    """

    times: np.ndarray
    """(T,)."""
    positions: np.ndarray
    """(T, n, 3); of swimmers, those of their bodies. Not wrapped into a periodic cell."""
    directions: np.ndarray | None
    """(T, n, 3): of swimmers, or D3 of the nodes of rods; None for tracers."""
    cell: np.ndarray | None
    """(3, 3), lattice vectors in rows, of a periodic run; (T, 3, 3) if they are not always those
    of the first frame."""


def tracks(directory: str | os.PathLike[str], body: str) -> Tracks:
    """Return positions and directions of a body in all frames of a run.

    Parameters
    ----------
    directory : path or Run
        Of the run, which may still go on.
    body : str
        Its name.

    Raises
    ------
    FileNotFoundError
        If there are no trajectories.
    ValueError
        If there is no body of that name, or no frame yet.

    Examples
    --------
    >>> import mrs
    >>> pusher = mrs.Swimmers([[0, 0, 0]], [[0, 0, 1]], length=1.0, force=1.0, epsilon=0.1)
    >>> output = mrs.Output("outputs/pusher", interval=0.5)
    >>> sim = mrs.Simulation(mrs.Fluid(), [pusher], output=output).run(1.0)
    >>> times, positions, directions, _ = mrs.observables.tracks("outputs/pusher", "swimmers")
    >>> print(positions[:, 0, 2].round(3), directions[-1])
    [0.    0.358 0.717] [[0. 0. 1.]]
    """
    paths = {path.stem: path for path in trajectory_paths(directory)}
    with Trajectory(paths[check.one_of("body", body, paths)]) as file:
        if not len(file):
            raise ValueError(f"{file.path} has no frame yet")
        times = file.times
        lattices = stored_lattices(file.meta, times)
        cells = [None] * len(times) if lattices is None else lattices
        frames = [_frame(file, i, cell) for i, cell in enumerate(cells)]
    positions, directions = zip(*frames, strict=True)
    known = directions[0] is not None
    return Tracks(
        times, np.stack(positions), np.stack(directions) if known else None, _common(lattices)
    )


def _common(lattices: np.ndarray | None) -> np.ndarray | None:
    """Return the lattices of all frames, or one if they are equal; None if there are none."""
    if lattices is None:
        return None
    return lattices[0] if np.ptp(lattices, axis=0).max() == 0.0 else lattices


def frame_loads(
    directory: str | os.PathLike[str], frame: int = -1
) -> tuple[np.ndarray, np.ndarray]:
    """Return the points that put loads on the fluid in a frame, (n, 3), and the loads, (n, 6).

    Parameters
    ----------
    directory : path or Run
    frame : int, optional
        Its number; the last by default.

    Raises
    ------
    FileNotFoundError, IndexError, ValueError
        As for `mrs.frame_velocity`.

    Notes
    -----
    Forces and torques are stored in single precision.

    Examples
    --------
    >>> import mrs
    >>> pusher = mrs.Swimmers([[0, 0, 0]], [[0, 0, 1]], length=1.0, force=1.0, epsilon=0.1)
    >>> output = mrs.Output("outputs/pusher", interval=0.5)
    >>> sim = mrs.Simulation(mrs.Fluid(), [pusher], output=output).run(0.5)
    >>> points, loads = mrs.observables.frame_loads("outputs/pusher", frame=0)
    >>> print(loads[:, :3])
    [[ 0.  0.  1.]
     [-0. -0. -1.]]
    """
    return StoredFrame(directory, frame).loads


def _frame(
    file: Trajectory, i: int, lattice: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray | None]:
    """Return positions and directions in a frame."""
    points, data = file.points(i), file.point_data(i)
    if lattice is not None and "image" in data:
        points = points + data["image"] @ lattice
    own = data.get("bead", np.zeros(len(points))) != _FLAGELLUM
    along = next((data[name] for name in _DIRECTIONS if name in data), None)
    return points[own], None if along is None else along[own].astype(np.float64)
