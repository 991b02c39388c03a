"""What moves the first nodes of rods, and rigid bodies: a given motion, or another body."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from mrs import check


@check.spelling
@dataclass(frozen=True)
class Drive:
    """How the first node of each rod, or each rigid body, is moved: by constants, or in time.

    Constants are (3,), or (rods, 3). A function takes the rods' own times, (rods,), and returns
    one of these.

    Examples
    --------
    >>> import mrs
    >>> import numpy as np
    >>> drive = mrs.Drive(velocity=(1.0, 0.0, 0.0))
    >>> ball = mrs.Rigid(mrs.surfaces.sphere(radius=1.0, count=100), motion=drive)
    >>> sim = mrs.Simulation(mrs.Fluid(), [ball])
    >>> drag = sim.now.loads[:, 0].sum()
    >>> print(round(drag / (6.0 * np.pi), 2))  # of Stokes's
    1.01
    """

    __pydantic_config__: ClassVar[dict[str, str]] = {"extra": "forbid"}

    velocity: Any = (0.0, 0.0, 0.0)
    angular_velocity: Any = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        for name, motion in vars(self).items():
            if not callable(motion):
                array = check.real(name, motion)
                if array.ndim not in (1, 2) or array.shape[-1] != 3:
                    raise ValueError(
                        f"{name} must be a function of time, or have shape (3,) or (rods, 3), "
                        f"got shape {array.shape}"
                    )
                check.shaped(name, array, array.shape)  # finite

    @property
    def depends_on_time(self) -> bool:
        """Whether one of the two is a function."""
        return callable(self.velocity) or callable(self.angular_velocity)

    def at(self, what: str, times: np.ndarray, argument: str, name: str) -> np.ndarray:
        """Return the "velocity" or the "angular_velocity" of each thing, (n, 3).

        Parameters
        ----------
        what : str
        times : (n,) ndarray
            The own times of the things.
        argument, name : str
            For messages: of this object as the user typed it, and of a thing, by its number.
        """
        motion = getattr(self, what)
        value = motion(times) if callable(motion) else motion

        def where(row: int) -> str:
            return f"for {name.format(row)} at its own time {times[row]:g}"

        return check.vectors(f"{argument}: {what}", value, len(times), where)


@check.spelling
@dataclass(frozen=True)
class Mount:
    """Where rods are fixed to rigid bodies, which get their loads.

    The first node of each rod and its triad move with the axes of a body. The triad may turn
    against them, as a motor makes a flagellum turn: the body gets the opposite torque. The rod
    turns about its first node, wherever this is on the body.

    Parameters
    ----------
    body : str
        Name of the `Rigid` or `Prescribed` body.
    number : int or array_like of int, optional
        Which of its bodies each rod is fixed to, a number or (rods,); the first one by default.
    turning : (3,) array_like or callable, optional
        Angular velocity relative to the body, in the axes of the body; or a function, as for
        `Drive`.

    Examples
    --------
    >>> import mrs
    >>> import numpy as np
    >>> head = mrs.Rigid(mrs.surfaces.sphere(radius=0.5, count=60), name="head")
    >>> tail = mrs.Rods(
    ...     mrs.geometry.helix(0.2, 1.0, 1.0, nodes=21, origin=(-0.2, 0, 0.5)),
    ...     bending=1.0, twisting=1.0, shearing=50.0, stretching=50.0,
    ...     base=mrs.Mount("head", turning=(0.0, 0.0, 6.28)), epsilon=0.1,
    ... )
    >>> sim = mrs.Simulation(mrs.Fluid(), [head, tail])
    >>> force = sim.now.loads[:, :3].sum(axis=0)  # of head and tail together
    >>> bool(np.abs(force).max() < 1e-10)
    True
    """

    __pydantic_config__: ClassVar[dict[str, str]] = {"extra": "forbid"}

    body: str
    number: Any = 0
    turning: Any = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        check.file_name("body", self.body)
        Drive(angular_velocity=self.turning)

    def numbers(self, count: int) -> np.ndarray:
        """Return the number of the body of each rod, (count,)."""
        numbers = check.broadcast("number", self.number, (count,))
        if (numbers < 0).any() or (numbers != np.floor(numbers)).any():
            raise ValueError(f"number must be integers of at least 0, got {self.number!r}")
        return numbers.astype(int)
