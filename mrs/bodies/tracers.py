"""Points that follow the flow."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from mrs import check
from mrs.bodies.base import Body
from mrs.bodies.noise import Noise
from mrs.time.state import Arrays, State


@check.spelling
class Tracers(Body):
    """Passive points: targets of the sums, never sources.

    Parameters
    ----------
    positions : (n, 3) array_like
    diffusivity : float or array_like, optional
        D of their random motion besides that with the flow, a number or (n,).
    seed : int, optional
        Of the random motion.
    name : str, optional
        Of the output file.

    Examples
    --------
    >>> import mrs
    >>> dust = mrs.Tracers([[1.0, 1.0, 0.0]])
    >>> fluid = mrs.Fluid(background=mrs.flows.extension(rate=1.0))
    >>> sim = mrs.Simulation(fluid, [dust], integrator=mrs.Integrator("rk4", dt=0.05)).run(1.0)
    >>> print(sim.state.positions.round(4))  # e, 1 / sqrt(e)
    [[2.7183 0.6065 0.    ]]
    """

    kind = "tracers"
    has_force = False

    def __init__(
        self,
        positions: ArrayLike,
        *,
        diffusivity: ArrayLike = 0.0,
        seed: int = 0,
        name: str = "tracers",
    ) -> None:
        self.made_with = {k: v for k, v in locals().items() if k != "self"}
        self.name = check.file_name("name", name)
        self.positions = check.points("positions", positions)
        self.quaternions = np.empty((0, 4))
        self.noise = Noise(len(self.positions), diffusivity=diffusivity, seed=seed)
        self.length_scale = (
            float(np.ptp(self.positions, axis=0).max()) if len(self.positions) else 0.0
        )

    def rates(
        self,
        time: float,
        state: State,
        velocity: np.ndarray,
        spin: np.ndarray | None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the fluid's velocity."""
        return velocity, np.empty((0, 3))

    def pieces(self) -> np.ndarray:
        """Return the tracers' numbers, (n,)."""
        return np.arange(len(self.positions))

    def constant_fields(self, epsilons: np.ndarray) -> tuple[Arrays, Arrays]:
        """Return each tracer's number."""
        return {"tracer_id": np.arange(len(self.positions))}, {}
