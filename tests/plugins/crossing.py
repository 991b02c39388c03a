"""An interrupt: a point of the first body has come to the other side of a plane x = const."""

from dataclasses import dataclass

import mrs


@dataclass(frozen=True)
class Crossing(mrs.Interrupt):
    """When the first point of the first body passes x.

    Parameters
    ----------
    x : float
    """

    x: float

    def due(self, before, sim):
        rate = sim.now.rates[0, 0]
        place = sim.state.positions[0, 0]
        step = sim.moment.time - before.time
        return (place - self.x) * (place - rate * step - self.x) <= 0.0
