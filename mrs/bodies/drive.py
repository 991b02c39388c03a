"""Motion that is given: of the first nodes of rods, and of rigid bodies."""

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
