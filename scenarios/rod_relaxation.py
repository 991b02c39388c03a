"""A straight rod with intrinsic curvature and twist coils into its helix.

The picture: the open rod of Olson, Lim & Cortez (2013), straight but for a tilt of 1e-4 of its
triads, writhes for a moment and settles in a helix of radius k / (k^2 + t^2) and pitch 2 pi t /
(k^2 + t^2).

    mrs run rod_relaxation
"""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from pydantic import Field
from scipy.spatial.transform import Rotation

import mrs


class RodRelaxation(mrs.Scenario):
    """Options of the rod; grams, micrometres, seconds. The defaults are the published ones."""

    quick: ClassVar[dict[str, Any]] = {
        "nodes": 26,
        "epsilon": 0.25,
        "t_end": 0.2,
        "interval": 0.01,
    }

    nodes: int = Field(76, ge=5, description="of the rod")
    length: float = Field(75 * float(np.pi) / 40, gt=0, description="of the rod")
    epsilon: float | None = Field(
        None, gt=0, description="blob size; by default six spacings of the nodes, as published"
    )
    curvature: float = Field(1.3, ge=0, description="intrinsic, k")
    twist: float = Field(float(np.pi) / 2, description="intrinsic, t")
    bending: float = Field(3.5e-3, gt=0, description="moduli a1 = a2 = a3")
    shearing: float = Field(0.8, gt=0, description="moduli b1 = b2 = b3")
    viscosity: float = Field(1e-6, gt=0, description="of the fluid")
    t_end: float = Field(1.0, gt=0, description="simulated time")
    interval: float = Field(0.01, gt=0, description="simulated time between frames")

    def build(self, **common: Any) -> mrs.Simulation:
        """Return the rod."""
        straight = mrs.geometry.straight(self.length, self.nodes)
        tilt = Rotation.from_rotvec([1e-4, 0.0, 0.0]).as_quat()
        tilted = straight._replace(quaternions=mrs.rotations.multiply(tilt, straight.quaternions))
        rod = mrs.Rods(
            tilted,
            bending=self.bending,
            twisting=self.bending,
            shearing=self.shearing,
            stretching=self.shearing,
            intrinsic_curvature=(self.curvature, 0.0, self.twist),
            name="rod",
        )
        epsilon = self.epsilon or 6.0 * self.length / (self.nodes - 1)
        fluid = mrs.Fluid(viscosity=self.viscosity, epsilon=epsilon)
        return mrs.Simulation(fluid, [rod], **common)

    def check(self, sim: mrs.Simulation) -> mrs.Check:
        """Return the mean speed of the nodes at the start, beside the speed due to two torques.

        The straight rod has the moment a1 (k, 0, t) everywhere. It turns the fluid at one end by
        this torque and at the other by the opposite one, and both move the rod sideways (K eq.
        7.2). Shear forces due to the tilt cancel in the mean. Nodes that feel only their own drag
        turn at the ends, and do not move.
        """
        (rod,) = sim.bodies
        rates = sim.scene.rates(0.0, mrs.State(rod.positions, rod.quaternions))
        speed = np.linalg.norm(rates[: self.nodes].mean(axis=0))
        epsilon, s = sim.fluid.epsilon, np.linspace(0.0, self.length, self.nodes)
        assert epsilon is not None
        swirl = s * (2.0 * s**2 + 5.0 * epsilon**2) / (s**2 + epsilon**2) ** 2.5
        torque = self.bending * self.curvature
        expected = 2.0 * torque * swirl.mean() / (16.0 * np.pi * self.viscosity)
        return mrs.Check("mean speed at the start", float(speed), float(expected), 0.01)
