"""Points that move with frames: their velocities, and the net loads on the frames."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mrs import rotations


class GivenMotion(NamedTuple):
    """Points whose motion is given, and the frames that carry them.

    A point moves with its frame, and besides with a velocity of its own. A free frame moves so that
    its points put a given net force and torque on the fluid. The motion of the others is given.

    Attributes
    ----------
    local : (n, 3) ndarray
        Points in the axes of their frames, from the centres.
    velocity : (n, 3) ndarray
        Of the points, where their frames rest.
    frame : (n,) int ndarray
        Number of the frame of each point.
    centre : (k, 3) ndarray
        Of the frames.
    quaternion : (k, 4) ndarray
        From the axes of each frame to those of space.
    free : (k,) bool ndarray
    motion : (k, 6) ndarray
        Velocity of the centre and angular velocity of each frame; zero for free ones.
    load : (k, 6) ndarray
        Net force and torque about the centre on the fluid, of free frames.
    """

    local: np.ndarray
    velocity: np.ndarray
    frame: np.ndarray
    centre: np.ndarray
    quaternion: np.ndarray
    free: np.ndarray
    motion: np.ndarray
    load: np.ndarray

    @property
    def arms(self) -> np.ndarray:
        """From the centres to the points, (n, 3)."""
        return rotations.rotate(self.quaternion[self.frame], self.local)


class Mounted(NamedTuple):
    """Points of a body that are fixed to frames of another one.

    Attributes
    ----------
    rows : (m,) int ndarray
        The points.
    body : str
        Name of the other body.
    number : (m,) int ndarray
        Of the frame.
    loads : (m, 6) ndarray
        Forces and torques that the points hand to their frames.
    turning : (m, 3) ndarray
        Angular velocity relative to the frame, in its axes.
    """

    rows: np.ndarray
    body: str
    number: np.ndarray
    loads: np.ndarray
    turning: np.ndarray

    def loads_about(self, arms: np.ndarray) -> np.ndarray:
        """Return the loads with torques about the centres of the frames, (m, 6).

        Parameters
        ----------
        arms : (m, 3) ndarray
            From the centres to the points.
        """
        loads = self.loads.copy()
        loads[:, 3:] += rotations.cross(arms, loads[:, :3])
        return loads

    def motion_with(self, frames: np.ndarray, given: GivenMotion, arms: np.ndarray) -> np.ndarray:
        """Return velocities and angular velocities of the points, (m, 6).

        Parameters
        ----------
        frames : (k, 6) ndarray
            Motion of all frames.
        given : GivenMotion
            Of all frames.
        arms : (m, 3) ndarray
            From the centres to the points.
        """
        turning = rotations.rotate(given.quaternion[self.number], self.turning)
        spin = frames[self.number, 3:] + turning
        return np.hstack([carried(frames, arms, self.number), spin])


def joined(parts: list[GivenMotion]) -> GivenMotion:
    """Return the motions of several bodies as one; their frames are numbered through."""
    before = np.cumsum([0, *(len(part.centre) for part in parts)])
    parts = [
        part._replace(frame=part.frame + first)
        for part, first in zip(parts, before[:-1], strict=True)
    ]
    return GivenMotion(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))


def carried(motion: np.ndarray, arms: np.ndarray, frame: np.ndarray) -> np.ndarray:
    """Return the velocities of points that move with frames, (n, 3).

    Parameters
    ----------
    motion : (k, 6) ndarray
        Velocities of the centres and angular velocities.
    arms : (n, 3) ndarray
        From the centres to the points.
    frame : (n,) int ndarray
    """
    own = motion[frame]
    return own[:, :3] + rotations.cross(own[:, 3:], arms)


def net_loads(forces: np.ndarray, arms: np.ndarray, frame: np.ndarray, count: int) -> np.ndarray:
    """Return the net force and the torque about the centre of each frame, (count, 6).

    Parameters
    ----------
    forces, arms : (n, 3) ndarray
        At the points, and from the centres to the points.
    frame : (n,) int ndarray
    count : int
        Number of frames.
    """
    columns = np.hstack([forces, rotations.cross(arms, forces)]).T
    return np.stack([np.bincount(frame, column, count) for column in columns], axis=1)
