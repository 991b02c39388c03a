"""The contract of a method of time stepping."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, Protocol

import numpy as np

from mrs.time.state import Arrays

RightHandSide = Callable[[float, np.ndarray], np.ndarray]


class Problem(NamedTuple):
    """The equation dz/dt = f(t, z) that a step solves, and values at its start."""

    f: RightHandSide
    rates: np.ndarray
    """f(t, z) at the start."""
    spectral_radius: float
    """Of df/dz at the start, an estimate from below; 0 before the first one."""


class Step(NamedTuple):
    """The result of a step."""

    z: np.ndarray
    """The coordinates at its end."""
    error: np.ndarray | None = None
    """An estimate of their error, from methods that have one."""
    memory: Arrays | None = None
    """Arrays that the method needs in the next step; None if it needs none."""


class Method(Protocol):
    """A method for dz/dt = f(t, z), of which rows are positions and rotation vectors.

    A step starts at rotation vectors of zero, because the triads at its start are the reference.
    A multistep method remembers rates, which are the same in all reference frames, not coordinates.
    """

    @property
    def name(self) -> str:
        """The name in `Integrator` and in TOML files."""

    @property
    def order(self) -> int:
        """Of the method."""

    @property
    def error_order(self) -> int | None:
        """Order of the solution that the error estimate belongs to; None without an estimate."""

    def stability_interval(self) -> float:
        """Return the largest h times lambda that is stable, for real negative eigenvalues."""

    def init(self, z: np.ndarray) -> Arrays:
        """Return the `memory` of the first step: no arrays for a one-step method.

        The arrays are part of a checkpoint.
        """

    def step(self, problem: Problem, t: float, z: np.ndarray, h: float, memory: Arrays) -> Step:
        """Return the step of size `h` from z at t; the arrays of `memory` must not be changed."""
