"""A free elastic flagellum that swims by a wave of twisted curvature running along it.

The picture: the preferred curvature turns about the rod as it travels, so the rod is a rotating
corkscrew without a motor. Nothing holds it: it swims against the wave, and spins.

    mrs run helical_swimmer --set curvature=0.5
"""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from pydantic import Field

import mrs


class HelicalSwimmer(mrs.Scenario):
    """Options of the flagellum; micrometres, grams times 1e-6 and seconds, say; viscosity 1."""

    quick: ClassVar[dict[str, Any]] = {"nodes": 41, "epsilon": 0.25, "t_end": 1.0}

    length: float = Field(10.0, gt=0, description="of the rod")
    nodes: int = Field(101, ge=5, description="of the rod")
    epsilon: float | None = Field(
        None, gt=0, description="blob size; by default two spacings of the nodes"
    )
    curvature: float = Field(0.5, gt=0, description="preferred, radians per length")
    wavelength: float = Field(5.0, gt=0, description="of the wave")
    period: float = Field(1.0, gt=0, description="of the wave")
    bending: float = Field(10.0, gt=0, description="moduli a1 = a2 = a3")
    shearing: float = Field(400.0, gt=0, description="moduli b1 = b2 = b3")
    t_end: float = Field(5.0, gt=0, description="simulated time")
    interval: float = Field(0.05, gt=0, description="simulated time between frames")

    def build(self, **common: Any) -> mrs.Simulation:
        """Return the flagellum."""
        k, omega, curvature = 2 * np.pi / self.wavelength, 2 * np.pi / self.period, self.curvature

        def corkscrew(s: np.ndarray, t: np.ndarray) -> np.ndarray:
            phase = k * s - omega * t
            return curvature * np.column_stack([np.cos(phase), np.sin(phase), np.zeros_like(s)])

        rod = mrs.Rods(
            mrs.geometry.straight(self.length, self.nodes),
            bending=self.bending,
            twisting=self.bending,
            shearing=self.shearing,
            stretching=self.shearing,
            intrinsic_curvature=corkscrew,
            name="flagellum",
        )
        epsilon = self.epsilon or 2.0 * self.length / (self.nodes - 1)
        return mrs.Simulation(mrs.Fluid(epsilon=epsilon), [rod], **common)

    def check(self, sim: mrs.Simulation) -> mrs.Check:
        """Return the swimming speed, beside the sum of K eq. (7.2) written out.

        It is due to hydrodynamic interaction alone. The forces on the fluid sum to zero, so that
        nodes that feel only their own drag do not swim.
        """
        now = sim.now
        return swimming_speed(now.motion, flow(now.points, now.points, now.loads, sim.fluid))


def swimming_speed(motion: np.ndarray, velocity: np.ndarray) -> mrs.Check:
    """Return the speed of the middle of points by their motion, and by velocities, (N, 3)."""
    speed = np.linalg.norm(motion[:, :3].mean(axis=0))
    expected = np.linalg.norm(velocity.mean(axis=0))
    return mrs.Check("swimming speed", float(speed), float(expected), 0.01)


def flow(
    targets: np.ndarray,
    points: np.ndarray,
    loads: np.ndarray,
    fluid: mrs.Fluid,
    epsilons: np.ndarray | None = None,
) -> np.ndarray:
    """Return the velocity at targets, (M, 3), of forces and torques at points, K eq. (7.2).

    Parameters
    ----------
    targets, points : (M, 3), (N, 3) ndarray
    loads : (N, 6) ndarray
        Forces, then torques.
    fluid : mrs.Fluid
    epsilons : (N,) ndarray, optional
        Blob sizes of the points; by default that of the fluid.
    """
    sizes = np.full(len(points), fluid.epsilon) if epsilons is None else epsilons
    force, torque = loads[:, :3], loads[:, 3:]
    r = targets[:, None] - points
    square = sizes[:, None] ** 2
    psi = 1.0 / np.sqrt((r**2).sum(axis=2, keepdims=True) + square)
    along = (r * force).sum(axis=2, keepdims=True) * r
    stokeslets = force * (psi + square * psi**3) + along * psi**3
    rotlets = np.cross(torque, r) * (psi**3 + 1.5 * square * psi**5)
    return (stokeslets + rotlets).sum(axis=1) / (8.0 * np.pi * fluid.viscosity)
