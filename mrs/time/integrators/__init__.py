"""Methods of time stepping; `base.Method` is their contract."""

from mrs.registry import Registry
from mrs.time.integrators.base import Method, Problem, Step
from mrs.time.integrators.bdf import BackwardDifferentiation
from mrs.time.integrators.chebyshev import Chebyshev
from mrs.time.integrators.runge_kutta import BOGACKI_SHAMPINE, EULER, HEUN, RK4, Tableau

METHODS: Registry[Method] = Registry("integrator", "name")
for _method in (EULER, HEUN, RK4, BOGACKI_SHAMPINE, Chebyshev(), BackwardDifferentiation()):
    METHODS.register(_method)

__all__ = ["METHODS", "Chebyshev", "Method", "Problem", "Step", "Tableau"]
