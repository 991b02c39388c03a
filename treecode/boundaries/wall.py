"""A plane at which the fluid does not slip."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, ClassVar

import numpy as np

from treecode import check
from treecode.boundaries.base import Boundary, Term
from treecode.kernels import RegularizedStokeslet, RegularizedStokesletRotlet, Stokeslet
from treecode.kernels.base import Kernel
from treecode.kernels.wall_correction import (
    ForceWallCorrection,
    StokesletWallCorrection,
    WallCorrection,
)

_ROUNDING = 8.0 * np.finfo(float).eps


@dataclass(frozen=True)
class Wall(Boundary):
    """A plane wall at rest, at which the velocity is zero; the fluid is on one side.

    Images of Blake (1971) and, for regularized forces, of Ainley et al. (2008). docs/physics.md
    has those of torques, the angular velocities, and the form as sums over translation-invariant
    kernels. The kernels are `RegularizedStokeslet`, `RegularizedStokesletRotlet` and `Stokeslet`.

    Parameters
    ----------
    point : (3,) array_like, optional
        Any point of the wall.
    normal : (3,) array_like, optional
        From the wall into the fluid, of any length.

    Raises
    ------
    ValueError, TypeError
        If they are not three finite numbers, or the normal is zero.

    Examples
    --------
    >>> import treecode as tc
    >>> kernel, targets = tc.RegularizedStokeslet(epsilon=0.01), [[0, 0, 1], [0.5, 0, 0]]
    >>> u = tc.evaluate(kernel, [[0, 0, 1]], [[1, 0, 0]], targets, boundary=tc.Wall())
    >>> print(u[:, 0].round(3) + 0.0)  # 1 / (4 pi epsilon) - 3 / (32 pi); 0 at the wall
    [7.928 0.   ]
    """

    kind: ClassVar[str] = "wall"

    point: Any = (0.0, 0.0, 0.0)
    normal: Any = (0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        for name, array in (
            ("point", check.vector("point", self.point)),
            ("normal", check.direction("normal", self.normal)),
        ):
            object.__setattr__(self, name, tuple(array.tolist()))

    def terms(self, kernel: Kernel) -> Sequence[Term]:
        """Return the sum of the loads and their mirror images, and the correction."""
        correction: Any
        if isinstance(kernel, RegularizedStokesletRotlet):
            correction, from_load, to_flow = WallCorrection(*kernel), _load_strengths, _motion
        elif isinstance(kernel, RegularizedStokeslet):
            correction, from_load, to_flow = ForceWallCorrection(*kernel), _strengths, _velocity
        elif isinstance(kernel, Stokeslet):
            correction, from_load, to_flow = StokesletWallCorrection(), _strengths, _velocity
        else:
            raise ValueError(
                "kernel must be RegularizedStokeslet, RegularizedStokesletRotlet or Stokeslet over "
                f"a wall, since the images of others are not known here; got {kernel!r}"
            )
        return (
            Term(kernel, self._with_images, self._strengths_with_images),
            Term(
                correction,
                self._images_in_frame,
                partial(self._in_frame, from_load),
                self._to_frame,
                partial(self._from_frame, to_flow),
            ),
        )

    def outside(self, points: np.ndarray) -> np.ndarray:
        """Return the rows of points, (N, 3), that are behind the wall."""
        return np.flatnonzero(self.heights(points) < 0.0)

    def heights(self, points: np.ndarray) -> np.ndarray:
        """Return the distances of points, (N, 3), from the wall, (N,); negative behind it.

        Points on the wall but for rounding are on it. A singular source would else be next to an
        image that is not quite where it is.
        """
        away = points - np.array(self.point)
        heights = away @ np.array(self.normal)
        heights[np.abs(heights) <= _ROUNDING * np.abs(away).sum(axis=1)] = 0.0
        return np.asarray(heights)

    @cached_property
    def frame(self) -> np.ndarray:
        """Three orthonormal rows, (3, 3), of which the last is the normal."""
        normal = np.array(self.normal)
        first = np.eye(3)[int(np.argmin(np.abs(normal)))]
        first = first - (first @ normal) * normal
        first /= np.linalg.norm(first)
        return np.stack([first, np.cross(normal, first), normal])

    def _mirrored(self, vectors: np.ndarray) -> np.ndarray:
        """Return mirror images of directions, (N, 3)."""
        normal = np.array(self.normal)
        return vectors - 2.0 * np.outer(vectors @ normal, normal)

    def _with_images(self, points: np.ndarray) -> np.ndarray:
        images = points - 2.0 * np.outer(self.heights(points), self.normal)
        return np.concatenate([points, images])

    def _strengths_with_images(self, points: np.ndarray, strengths: np.ndarray) -> np.ndarray:
        """Return forces and torques with those of the images: a torque is an axial vector."""
        images = [-self._mirrored(strengths[:, :3])]
        if strengths.shape[1] == 6:
            images.append(self._mirrored(strengths[:, 3:]))
        return np.concatenate([strengths, np.concatenate(images, axis=1)])

    def _to_frame(self, points: np.ndarray) -> np.ndarray:
        along = (points - np.array(self.point)) @ self.frame[:2].T
        return np.column_stack([along, self.heights(points)])

    def _images_in_frame(self, points: np.ndarray) -> np.ndarray:
        return self._to_frame(points) * [1.0, 1.0, -1.0]

    def _in_frame(self, from_load: Any, points: np.ndarray, strengths: np.ndarray) -> np.ndarray:
        """Return what the correction takes, of loads whose mirror images are in the frame."""
        loads = strengths.reshape(len(strengths), -1, 3) @ self.frame.T
        loads[:, :, 2] *= -1.0
        return np.asarray(from_load(self.heights(points)[:, None], *loads.transpose(1, 0, 2)))

    def _from_frame(self, to_flow: Any, targets: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Return the flow that the correction gives, with directions out of the frame."""
        flow = to_flow(self.heights(targets)[:, None], values)
        return np.asarray((flow.reshape(len(flow), -1, 3) @ self.frame).reshape(flow.shape))


def _strengths(h: np.ndarray, g: np.ndarray) -> np.ndarray:
    """Return the strengths of `ForceWallCorrection`, (N, 4)."""
    return np.concatenate([-g[:, 2:], h * g], axis=1)


def _load_strengths(h: np.ndarray, g: np.ndarray, m: np.ndarray) -> np.ndarray:
    """Return the strengths of `WallCorrection`, (N, 9)."""
    p = np.stack([-m[:, 1], m[:, 0]], axis=1)
    return np.concatenate([-g[:, 2:], p, h * g, h * m], axis=1)


def _velocity(x3: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return the velocity that `ForceWallCorrection` gives at heights x3, (M, 3)."""
    velocity = x3 * values[:, 1:4]
    velocity[:, 2] -= 2.0 * values[:, 0]
    return velocity


def _motion(x3: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return the velocity and angular velocity that `WallCorrection` gives, (M, 6)."""
    spin = x3 * values[:, 6:9]
    spin[:, :2] += values[:, 4:6]
    return np.concatenate([_velocity(x3, values), spin], axis=1)
