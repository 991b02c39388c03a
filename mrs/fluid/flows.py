"""Background flows: the motion of the fluid without the bodies."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from mrs import check

Field = Callable[[np.ndarray, float], np.ndarray]


class Flow(Protocol):
    """A solution of the Stokes equations without the bodies.

    If it has a method ``pressure(points, time, viscosity)``, returning (N,), the pressure of stored
    frames is known too.

    Examples
    --------
    >>> import mrs
    >>> import numpy as np
    >>> class Vortex:  # a line vortex along z; its vorticity is zero around it
    ...     def velocity(self, points, time):
    ...         x, y = points[:, 0], points[:, 1]
    ...         return np.column_stack([-y, x, 0 * x]) / (x**2 + y**2)[:, None]
    >>> dust = mrs.Tracers([[2.0, 0.0, 0.0]])
    >>> sim = mrs.Simulation(mrs.Fluid(background=Vortex()), [dust])
    >>> print(sim.velocity([[2.0, 0.0, 0.0], [0.0, 4.0, 0.0]]))
    [[ 0.    0.5   0.  ]
     [-0.25  0.    0.  ]]
    """

    def velocity(self, points: np.ndarray, time: float) -> np.ndarray:
        """Return the velocity at points, (N, 3)."""

    def vorticity(self, points: np.ndarray, time: float) -> np.ndarray:
        """Return the curl of the velocity, (N, 3)."""


@check.spelling
class QuadraticFlow:
    """A steady flow U_i = c_i + G_ij x_j + Q_ijk x_j x_k, which covers the next three as well.

    Parameters
    ----------
    gradient : (3, 3) array_like, optional
        G, per time; its trace must vanish.
    quadratic : (3, 3, 3) array_like, optional
        Q, per length and time; sum_i (Q_iik + Q_iki) must vanish for each k.
    constant : (3,) array_like, optional

    Raises
    ------
    ValueError
        If the flow is not free of divergence.

    Examples
    --------
    >>> import mrs
    >>> import numpy as np
    >>> flow = mrs.flows.QuadraticFlow(gradient=[[0, -1, 0], [1, 0, 0], [0, 0, 0]])  # a rotation
    >>> points = np.array([[2.0, 0.0, 0.0]])
    >>> print(flow.velocity(points, 0.0) + 0.0, flow.vorticity(points, 0.0))
    [[0. 2. 0.]] [[0. 0. 2.]]
    """

    def __init__(
        self,
        gradient: ArrayLike | None = None,
        quadratic: ArrayLike | None = None,
        constant: ArrayLike | None = None,
    ) -> None:
        self.constant = _zero_or("constant", constant, (3,))
        self.gradient = _zero_or("gradient", gradient, (3, 3))
        quadratic = _zero_or("quadratic", quadratic, (3, 3, 3))
        self.quadratic = 0.5 * (quadratic + quadratic.transpose(0, 2, 1))
        scale = np.abs(self.gradient).max()
        if abs(np.trace(self.gradient)) > 1e-12 * scale:
            raise ValueError(f"gradient must have trace 0, got {np.trace(self.gradient):g}")
        if np.abs(np.einsum("iik->k", self.quadratic)).max() > 1e-12 * np.abs(quadratic).max():
            raise ValueError("quadratic must give a flow without divergence")

    def velocity(self, points: np.ndarray, time: float) -> np.ndarray:
        """Return the velocity at points, (N, 3)."""
        velocity = points @ self.gradient.T
        velocity += self.constant
        if self.quadratic.any():
            products = (points[:, :, None] * points[:, None, :]).reshape(-1, 9)
            velocity += products @ self.quadratic.reshape(3, 9).T
        return velocity

    def vorticity(self, points: np.ndarray, time: float) -> np.ndarray:
        """Return the curl of the velocity, (N, 3)."""
        return _curl(self.gradient) + points @ (2.0 * _curl(self.quadratic)).T

    def pressure(self, points: np.ndarray, time: float, viscosity: float) -> np.ndarray:
        """Return the pressure at points, (N,), zero at the origin: its gradient is mu lap U."""
        return viscosity * points @ (2.0 * np.einsum("ijj", self.quadratic))


def _zero_or(name: str, value: Any, shape: tuple[int, ...]) -> np.ndarray:
    return np.zeros(shape) if value is None else check.shaped(name, value, shape)


def _curl(gradient: np.ndarray) -> np.ndarray:
    """Return the curl for G_ij, or for G_ij of each component of a vector, G_ijk: (3, ...)."""
    g = gradient
    return np.stack([g[2, 1] - g[1, 2], g[0, 2] - g[2, 0], g[1, 0] - g[0, 1]])


@check.spelling
def shear(
    rate: float,
    direction: ArrayLike = (1.0, 0.0, 0.0),
    gradient: ArrayLike = (0.0, 0.0, 1.0),
    origin: ArrayLike = (0.0, 0.0, 0.0),
) -> QuadraticFlow:
    """Return U = rate ((x - origin) . gradient) direction; by default (rate z, 0, 0).

    Over a `Wall` the gradient is its normal, and the origin one of its points.

    Parameters
    ----------
    rate : float
    direction, gradient : (3,) array_like, optional
        Of any length, at right angles.
    origin : (3,) array_like, optional
        A point where the flow is zero.

    Raises
    ------
    ValueError, TypeError
        If the directions are not at right angles, or for anything that is not finite numbers.

    Examples
    --------
    >>> import mrs
    >>> import numpy as np
    >>> flow = mrs.flows.shear(rate=2.0)
    >>> print(flow.velocity(np.array([[0.0, 0.0, 3.0]]), 0.0))
    [[6. 0. 0.]]
    """
    rate = check.number("rate", rate, -np.inf, np.inf)
    along, across = check.direction("direction", direction), check.direction("gradient", gradient)
    if abs(along @ across) > 1e-12:
        raise ValueError(
            f"direction and gradient must be at right angles, got {direction!r} and {gradient!r}"
        )
    matrix = rate * np.outer(along, across)
    constant = 0.0 - matrix @ check.vector("origin", origin)
    return QuadraticFlow(gradient=matrix, constant=constant)


@check.spelling
def extension(rate: float) -> QuadraticFlow:
    """Return U = rate (x, -y/2, -z/2), uniaxial extension along x.

    Examples
    --------
    >>> import mrs
    >>> import numpy as np
    >>> print(mrs.flows.extension(rate=1.0).velocity(np.array([[1.0, 2.0, 0.0]]), 0.0) + 0.0)
    [[ 1. -1.  0.]]
    """
    rate = check.number("rate", rate, -np.inf, np.inf)
    return QuadraticFlow(gradient=np.diag([rate, -0.5 * rate, -0.5 * rate]))


@check.spelling
def poiseuille(speed: float, radius: float) -> QuadraticFlow:
    """Return U = speed (1 - (y^2 + z^2) / radius^2) along x, as in a tube of that radius.

    Examples
    --------
    >>> import mrs
    >>> import numpy as np
    >>> flow = mrs.flows.poiseuille(speed=1.0, radius=2.0)
    >>> points = np.array([[0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 2.0, 0.0]])
    >>> print(flow.velocity(points, 0.0)[:, 0])
    [1.   0.75 0.  ]
    """
    speed = check.number("speed", speed, -np.inf, np.inf)
    quadratic = np.zeros((3, 3, 3))
    quadratic[0, 1, 1] = quadratic[0, 2, 2] = -speed / check.positive("radius", radius) ** 2
    return QuadraticFlow(quadratic=quadratic, constant=[speed, 0.0, 0.0])


@check.spelling
class UserFlow:
    """A flow of one's own, from two functions of points, (N, 3), and time.

    Parameters
    ----------
    velocity, vorticity : callable
        Each returns (N, 3), or (3,) for all points alike; `vorticity` is the curl of `velocity`.
        Vorticity turns the triads of rods; without rods in the scene it may be left out.

    Examples
    --------
    >>> import mrs
    >>> import numpy as np
    >>> tide = mrs.flows.UserFlow(lambda points, time: (np.cos(time), 0.0, 0.0))
    >>> fluid, dust = mrs.Fluid(background=tide), mrs.Tracers([[0.0, 0.0, 0.0]])
    >>> sim = mrs.Simulation(fluid, [dust], integrator=mrs.Integrator("rk4", dt=0.1))
    >>> print(sim.run(np.pi / 2).state.positions.round(3))
    [[1. 0. 0.]]
    """

    def __init__(self, velocity: Field, vorticity: Field | None = None) -> None:
        self.velocity = check.function("velocity", velocity, "points and time")
        if vorticity is not None:
            self.vorticity = check.function("vorticity", vorticity, "points and time")
