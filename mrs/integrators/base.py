"""What the stepper asks of a method."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np

RightHandSide = Callable[[float, np.ndarray], np.ndarray]


class Method(Protocol):
    """A one-step method for dz/dt = f(t, z)."""

    @property
    def name(self) -> str:
        """What users call it by."""

    @property
    def order(self) -> int:
        """Of the method."""

    @property
    def error_order(self) -> int | None:
        """Order of the solution that the error estimate belongs to; None without an estimate."""

    def stages(self, h_lambda: float) -> int:
        """Return how many stages a step with h times the spectral radius `h_lambda` takes."""

    def stability_interval(self) -> float:
        """Return the largest h times lambda that is stable, for real negative eigenvalues."""

    def step(
        self, f: RightHandSide, t: float, z: np.ndarray, k0: np.ndarray, h: float, stages: int
    ) -> tuple[np.ndarray, np.ndarray | None]:
        """Return z at t + h, and an estimate of its error if there is one; `k0` is f(t, z)."""
