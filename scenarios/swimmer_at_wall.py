"""A swimmer comes down to a wall, and swims along it.

The picture: far away the swimmer is a force dipole, and is moved by the flow of its mirror image
(Berke et al. 2008). A pusher that is nearly parallel to the wall is attracted, and turned parallel.
A puller is driven away, and turned steeper. At the wall steric repulsion holds the swimmer, and
turns both kinds along it.

    mrs run swimmer_at_wall --set stroke=puller
"""

from __future__ import annotations

from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import Field

import mrs


class SwimmerAtWall(mrs.Scenario):
    """Options of the swimmer; the unit of length is its length, the wall is at z = 0."""

    quick: ClassVar[dict[str, Any]] = {"t_end": 10.0, "interval": 0.5}

    stroke: Literal["pusher", "puller"] = Field("pusher", description="flagellum behind or before")
    height: float = Field(5.0, gt=0, description="of the swimmer's middle at the start")
    angle: float = Field(-0.2, description="from the wall to its direction at the start, radians")
    force: float = Field(1.0, gt=0, description="thrust")
    epsilon: float = Field(0.1, gt=0, description="blob size of both particles")
    repulsion: float = Field(4.0, gt=0, description="steric force of the wall at contact")
    t_end: float = Field(60.0, gt=0, description="simulated time")
    interval: float = Field(0.5, gt=0, description="simulated time between frames")

    def build(self, **common: Any) -> mrs.Simulation:
        """Return the swimmer."""
        along = np.array([np.cos(self.angle), 0.0, np.sin(self.angle)])
        reach = 0.5 if self.stroke == "pusher" else -0.5
        swimmer = mrs.Swimmers(
            [reach * along + [0.0, 0.0, self.height]],
            [along],
            length=1.0,
            force=self.force,
            stroke=self.stroke,
            name="swimmer",
        )
        fluid = mrs.Fluid(epsilon=self.epsilon, boundary=mrs.Wall())
        steric = mrs.Steric(self.repulsion, self.epsilon)
        return mrs.Simulation(fluid, [swimmer], forces=[steric], **common)

    def check(self, sim: mrs.Simulation) -> mrs.Check:
        """Return how fast the wall attracts the swimmer's middle at the start.

        Expected is the speed of a force dipole, 3 p (1 - 3 sin^2 angle) / (64 pi mu h^2), with
        p = f l for a pusher and -f l for a puller (Berke et al. 2008, Phys. Rev. Lett. 101,
        038102). The next term is of the order (l / h)^2. Without the wall the middle would stay:
        the two forces move it by equal and opposite velocities. So do their own drags.
        """
        (swimmer,) = sim.bodies
        start = mrs.State(swimmer.positions, swimmer.quaternions)
        motion = sim.scene.evaluate(0.0, start).motion
        dipole = self.force if self.stroke == "pusher" else -self.force
        attraction = 3.0 * dipole * (1.0 - 3.0 * np.sin(self.angle) ** 2)
        return mrs.Check(
            "speed towards the wall at the start",
            -float(motion[:, 2].mean()),
            attraction / (64.0 * np.pi * sim.fluid.viscosity * self.height**2),
            0.05,
        )
