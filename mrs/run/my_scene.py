"""A rod falls among tracers, which show the flow that it makes.

mrs run my_scene.py --quick --picture       a small version, ends within seconds
mrs run my_scene.py --options               lists the options
mrs run my_scene.py --set bending=0.02      a softer rod
"""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from pydantic import Field

import mrs


class MyScene(mrs.Scenario):
    """Options: fields with a default, limits and a description. Any consistent units will do."""

    # What is different in the small version, mrs run my_scene.py --quick
    quick: ClassVar[dict[str, Any]] = {"nodes": 11, "tracers": 200, "t_end": 1.0}

    length: float = Field(2.0, gt=0, description="of the rod")
    nodes: int = Field(41, ge=5, description="of the rod")
    weight: float = Field(10.0, gt=0, description="of the rod less its buoyancy, along -z")
    bending: float = Field(0.2, gt=0, description="bending and twisting moduli: force x length^2")
    shearing: float = Field(100.0, gt=0, description="shearing and stretching moduli: a force")
    tracers: int = Field(2000, ge=1, description="points that follow the flow")
    t_end: float = Field(4.0, gt=0, description="simulated time")
    interval: float = Field(0.1, gt=0, description="simulated time between frames")

    def build(self, **common: Any) -> mrs.Simulation:
        """Return the simulation; `common` has the files, the sums and the steps, as they are."""
        # A rod is given by its centreline with triads (mrs.geometry), and by its moduli.
        level = mrs.geometry.straight(
            self.length, self.nodes, origin=(-0.5 * self.length, 0, 0), direction=(1, 0, 0)
        )
        rod = mrs.Rods(
            level,
            bending=self.bending,
            twisting=self.bending,
            shearing=self.shearing,
            stretching=self.shearing,
            name="rod",
        )
        # Tracers put no force on the fluid. The same seed gives the same points.
        rng = np.random.default_rng(seed=0)
        tracers = mrs.Tracers(rng.uniform(-3.0, 3.0, (self.tracers, 3)) * self.length)
        # The forces of a node are spread over a blob of the size epsilon, here two segments long.
        fluid = mrs.Fluid(viscosity=1.0, epsilon=2.0 * self.length / (self.nodes - 1))
        gravity = mrs.Gravity(per_length=(0.0, 0.0, -self.weight / self.length), bodies=["rod"])
        return mrs.Simulation(fluid, [rod, tracers], forces=[gravity], **common)

    def check(self, sim: mrs.Simulation) -> mrs.Check:
        """Return one number of the finished run, beside the number that it should be.

        Far from the rod the flow is that of one point force, its weight F: a Stokeslet,
        u = (F / r + (F . r) r / r^3) / (8 pi mu). At two lengths away they differ by a few percent.
        """
        rod, tracers = np.split(sim.now.points, [self.nodes])
        velocity = sim.now.motion[self.nodes :, :3]
        r = tracers - rod.mean(axis=0)
        distance = np.linalg.norm(r, axis=1, keepdims=True)
        force = np.array([0.0, 0.0, -self.weight])
        stokeslet = (force / distance + (r @ force)[:, None] * r / distance**3) / (8.0 * np.pi)
        far = distance[:, 0] > 2.0 * self.length
        return mrs.Check(
            "flow of the far tracers along that of a point force",
            float((velocity[far] * stokeslet[far]).sum() / (stokeslet[far] ** 2).sum()),
            expected=1.0,
            tolerance=0.05,
        )
