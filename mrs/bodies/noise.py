"""Random motion: diffusion of positions and of directions, and tumbles."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from mrs import check, rotations
from mrs.time.state import State

_TURNED = 0.1  # of a direction's memory, and of a tumble, at most in a step (docs/noise.md)
_DISPLACED = 0.25  # of a blob size, along each axis, at most in a step (docs/noise.md)
_TUMBLES = 100.0  # in a step: after so many nothing is left of a direction


@check.spelling
class Noise:
    """Random motion of pieces that have a position, and at most one direction, each.

    Directions are the last axes of triads.

    Parameters
    ----------
    count : int
        Number n of pieces.
    diffusivity : float or array_like, optional
        D, a number or (n,): alone, a piece is displaced by 6 D t in the mean square.
    rotational_diffusivity : float or array_like, optional
        Dr, a number or (n,): alone, the mean of p(0) . p(t) is exp(-2 Dr t).
    tumble_rate : float or array_like, optional
        Mean number of tumbles per time, a number or (n,). They are a Poisson process.
    tumble_angle : float or array_like, optional
        Angle by which a tumble turns a direction, a number or (n,), up to pi. By default the new
        direction is any, uniform over the sphere.
    seed : int, optional
        Of the random numbers.

    Notes
    -----
    The angle of rotational diffusion in a time h is drawn with cos(angle) = 2 U^a - 1, of U uniform
    and a = tanh(Dr h). This is the power spherical distribution (De Cao & Aziz 2020,
    arXiv:2006.04437) with the mean cosine exp(-2 Dr h), which is exact for any h.
    """

    def __init__(
        self,
        count: int,
        *,
        diffusivity: ArrayLike = 0.0,
        rotational_diffusivity: ArrayLike = 0.0,
        tumble_rate: ArrayLike = 0.0,
        tumble_angle: ArrayLike | None = None,
        seed: int = 0,
    ) -> None:
        def each(name: str, value: ArrayLike) -> np.ndarray:
            return check.broadcast(name, value, (count,), 0.0, low_inclusive=True)

        self.diffusivity = each("diffusivity", diffusivity)
        self.rotational_diffusivity = each("rotational_diffusivity", rotational_diffusivity)
        self.tumble_rate = each("tumble_rate", tumble_rate)
        self.tumble_angle = None if tumble_angle is None else each("tumble_angle", tumble_angle)
        if self.tumble_angle is not None and (self.tumble_angle > np.pi).any():
            raise ValueError(f"tumble_angle must be at most pi, got {self.tumble_angle.max()}")
        self.seed = check.integer("seed", seed, 0)

    def __bool__(self) -> bool:
        """Return whether anything moves at random."""
        rates = (self.diffusivity, self.rotational_diffusivity, self.tumble_rate)
        return any(rate.any() for rate in rates)

    def longest_step(self, length: float) -> float:
        """Return the longest step that resolves it in flows that change over a length."""
        once = (
            1.0 if self.tumble_angle is None else np.maximum(1.0, 1.0 - np.cos(self.tumble_angle))
        )
        turning = (2.0 * self.rotational_diffusivity + self.tumble_rate * once).max(initial=0.0)
        spreading = 2.0 * self.diffusivity.max(initial=0.0)
        with np.errstate(divide="ignore"):
            return float(min(_TURNED / turning, (_DISPLACED * length) ** 2 / spreading))

    def kicked(self, state: State, h: float, random: np.random.Generator) -> State:
        """Return the state of the pieces after their random motion in a time h."""
        count = len(state.positions)
        positions, quaternions = state
        if self.diffusivity.any():
            width = np.sqrt(2.0 * self.diffusivity * h)
            positions = positions + width[:, None] * random.standard_normal((count, 3))
        if self.rotational_diffusivity.any():
            power = np.tanh(self.rotational_diffusivity * h)
            quaternions = _turned(quaternions, _angles(power, random), random)
        if self.tumble_rate.any():
            left = random.poisson(np.minimum(self.tumble_rate * h, _TUMBLES))
            while left.any():
                angles = self.tumble_angle
                if angles is None:
                    angles = _angles(np.ones(count), random)
                quaternions = _turned(quaternions, np.where(left > 0, angles, 0.0), random)
                left = np.maximum(left - 1, 0)
        return State(positions, quaternions)


def _angles(power: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """Return angles with cos(angle) = 2 U^power - 1, of U uniform, (n,)."""
    return 2.0 * np.arcsin(np.sqrt(-np.expm1(-power * random.standard_exponential(len(power)))))


def _turned(quaternions: np.ndarray, angles: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """Return triads whose last axes are turned by angles, (n,), towards any side, (n, 4)."""
    side = 2.0 * np.pi * random.random(len(angles))
    axes = np.stack([np.cos(side), np.sin(side), np.zeros(len(angles))], axis=1)
    turns = rotations.exponential(angles[:, None] * axes)
    return rotations.normalize(rotations.multiply(quaternions, turns))
