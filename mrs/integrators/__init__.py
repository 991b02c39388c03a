"""Methods that take one step of dz/dt = f(t, z); what they have in common is `base.Method`."""

from mrs.integrators.base import Method
from mrs.integrators.chebyshev import Chebyshev
from mrs.integrators.runge_kutta import BOGACKI_SHAMPINE, EULER, HEUN, RK4, Tableau

METHODS: dict[str, Method] = {
    method.name: method for method in (EULER, HEUN, RK4, BOGACKI_SHAMPINE, Chebyshev())
}

__all__ = ["METHODS", "Chebyshev", "Method", "Tableau"]
