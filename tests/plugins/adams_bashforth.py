"""An integrator with a memory: Adams and Bashforth's method of second order (HNW III.1)."""

import numpy as np

import mrs
from mrs.time.integrators import Step


class AdamsBashforth:
    """Remembers the rates of the step before, and its size; Heun's method takes the first step."""

    name = "ab2"
    order = 2
    error_order = None

    def stability_interval(self):
        return 1.0

    def init(self, z):
        return {}

    def step(self, problem, t, z, h, memory):
        now = problem.rates
        if memory:
            mean = now + 0.5 * h / memory["h"] * (now - memory["rates"])
        else:
            mean = 0.5 * (now + problem.f(t + h, z + h * now))
        return Step(z + h * mean, memory={"rates": now, "h": np.array(h)})


mrs.INTEGRATORS.register(AdamsBashforth())
