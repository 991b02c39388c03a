"""Which frames the trajectories of a run have in common."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

from mrs.output import run_directory
from mrs.output.trajectory import Trajectory


def trajectory_paths(directory: str | os.PathLike[str]) -> list[Path]:
    """Return the trajectories of a run; all of them if the directory has no list of files.

    Parameters
    ----------
    directory : path

    Raises
    ------
    FileNotFoundError
        If there are none.
    """
    own = set(run_directory.noted(directory))
    paths = sorted(Path(directory).glob("[!.]*.vtkhdf"))
    paths = [path for path in paths if path in own or not own]
    if not paths:
        raise FileNotFoundError(f"no trajectories (*.vtkhdf) in {directory}")
    return paths


@contextmanager
def trajectories(directory: str | os.PathLike[str]) -> Iterator[list[Trajectory]]:
    """Open the trajectories of a run together.

    Parameters
    ----------
    directory : path

    Raises
    ------
    FileNotFoundError
        If there are none.
    """
    with ExitStack() as stack:
        yield [stack.enter_context(Trajectory(path)) for path in trajectory_paths(directory)]


class Frames:
    """Frames that all bodies have, each at one time.

    They are numbered as in the longest file. All files have the same numbers, unless a run goes on
    meanwhile, or one of them was begun later.

    Parameters
    ----------
    bodies : sequence of Trajectory

    Attributes
    ----------
    numbers : list of int
        Of the frames that all bodies have.
    times : list of float
        Of the frames of the longest file.
    """

    def __init__(self, bodies: Sequence[Trajectory]) -> None:
        self._bodies = bodies
        self._places = [{time: i for i, time in enumerate(body.times.tolist())} for body in bodies]
        self.times = max((body.times.tolist() for body in bodies), key=len)
        self.numbers = [
            number
            for number, time in enumerate(self.times)
            if all(time in places for places in self._places)
        ]

    def number(self, frame: int) -> int:
        """Return the number of a frame that all bodies have.

        Parameters
        ----------
        frame : int
            Negative ones count from the end.

        Raises
        ------
        IndexError
            If there is no such frame; the message names the files without it.
        """
        if frame < 0 and -frame <= len(self.numbers):
            return self.numbers[frame]
        if frame in self.numbers:
            return frame
        if 0 <= frame < len(self.times):
            time = self.times[frame]
            pairs = zip(self._bodies, self._places, strict=True)
            without = ", ".join(str(body.path) for body, places in pairs if time not in places)
            raise IndexError(f"frame: number {frame}, at t = {time:g}, is not in {without}")
        folder = self._bodies[0].path.parent
        raise IndexError(f"frame: {folder} has {len(self.numbers)} frames, none number {frame}")

    def places(self, number: int) -> list[int]:
        """Return the place of a frame in the file of each body.

        Parameters
        ----------
        number : int
            One of `numbers`.
        """
        return [places[self.times[number]] for places in self._places]
