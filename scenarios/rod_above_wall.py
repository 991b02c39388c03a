"""A planar wave swims along a wall.

The picture: a wave of preferred curvature runs along a free rod, in a plane across the wall. The
rod swims against the wave, as that of Olson, Lim & Cortez (2013) does, and faster than it would
without the wall.

    mrs run rod_above_wall --set height=5
"""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from pydantic import Field

import mrs
from mrs.scenarios.helical_swimmer import flow, swimming_speed


class RodAboveWall(mrs.Scenario):
    """Options of the rod; grams, micrometres, seconds. The wall is at z = 0."""

    quick: ClassVar[dict[str, Any]] = {
        "nodes": 61,
        "epsilon": 2.0,
        "t_end": 0.05,
        "interval": 0.0025,
    }

    height: float = Field(10.0, gt=0, description="of the rod over the wall at the start")
    nodes: int = Field(301, ge=5, description="of the rod")
    length: float = Field(60.0, gt=0, description="of the rod")
    epsilon: float | None = Field(
        None, gt=0, description="blob size; by default three spacings of the nodes, as published"
    )
    amplitude: float = Field(1.0, gt=0, description="of the wave that the rod prefers, a length")
    wavelength: float = Field(30.0, gt=0, description="of the wave")
    period: float = Field(0.05, gt=0, description="of the wave")
    bending: float = Field(1.0, gt=0, description="moduli a1 = a2 = a3")
    shearing: float = Field(0.6, gt=0, description="moduli b1 = b2 = b3")
    viscosity: float = Field(1e-6, gt=0, description="of the fluid")
    t_end: float = Field(0.2, gt=0, description="simulated time")
    interval: float = Field(0.0025, gt=0, description="simulated time between frames")

    def build(self, **common: Any) -> mrs.Simulation:
        """Return the rod."""
        start = [-0.5 * self.length, 0.0, self.height]
        curvature = (2.0 * np.pi / self.wavelength) ** 2 * self.amplitude
        rod = mrs.Rods(
            mrs.geometry.straight(self.length, self.nodes, origin=start, direction=(1, 0, 0)),
            bending=self.bending,
            twisting=self.bending,
            shearing=self.shearing,
            stretching=self.shearing,
            beat=mrs.TravellingWave((0.0, -curvature, 0.0), self.wavelength, self.period),
            name="rod",
        )
        epsilon = self.epsilon or 3.0 * self.length / (self.nodes - 1)
        fluid = mrs.Fluid(self.viscosity, epsilon, boundary=mrs.Wall())
        return mrs.Simulation(fluid, [rod], **common)

    def check(self, sim: mrs.Simulation) -> mrs.Check:
        """Return the swimming speed, beside the sum of K eq. (7.2) and of the images, written out.

        It is due to hydrodynamic interaction alone. The forces on the fluid sum to zero, so that
        nodes that feel only their own drag do not swim.
        """
        now = sim.now
        velocity = flow(now.points, now.points, now.loads, sim.fluid)
        velocity += flow_of_images(now.points, now.points, now.loads, sim.fluid)
        return swimming_speed(now.motion, velocity)


def flow_of_images(
    targets: np.ndarray, points: np.ndarray, loads: np.ndarray, fluid: mrs.Fluid
) -> np.ndarray:
    """Return what a wall at z = 0 adds to `flow`, (M, 3): docs/physics.md, 3.

    Parameters
    ----------
    targets, points : (M, 3), (N, 3) ndarray
    loads : (N, 6) ndarray
        Forces, then torques.
    fluid : mrs.Fluid
        With the epsilon of all points.
    """
    assert fluid.epsilon is not None
    up, mirror, square = np.array([0.0, 0.0, 1.0]), np.array([1.0, 1.0, -1.0]), fluid.epsilon**2
    f, n = loads[:, :3], loads[:, 3:]
    g, p, h, z = mirror * f, np.cross(up, n), points[:, 2:], targets[:, None, 2:]
    X = targets[:, None] - mirror * points

    def along(vectors: np.ndarray) -> np.ndarray:
        return (vectors * X).sum(axis=2, keepdims=True)

    psi = 1.0 / np.sqrt(along(X) + square)
    dipole = psi**3 - 3.0 * square * psi**5
    force = -f * (psi + square * psi**3) - along(f) * X * psi**3
    force += 2.0 * h * (along(g) * up + f[:, 2:] * X) * psi**3
    force -= 2.0 * h * z * (dipole * g - 3.0 * along(g) * X * psi**5)
    turned = np.cross(n, mirror * X)
    torque = mirror * np.cross(X, n) * psi**3 - turned * (psi**3 + 3.0 * square * psi**5)
    torque -= 2.0 * (along(p) * up + h * p) * psi**3
    torque += 2.0 * z * (dipole * p - 6.0 * along(p) * X * psi**5)
    torque += 30.0 * square * h * z * mirror * turned * psi**7
    return (force + 0.5 * torque).sum(axis=1) / (8.0 * np.pi * fluid.viscosity)
