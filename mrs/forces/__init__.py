"""Forces between bodies, and on all of them."""

from mrs.forces.base import Force
from mrs.forces.gravity import Gravity
from mrs.forces.springs import Springs
from mrs.forces.steric import Steric
from mrs.forces.user import UserForce
from mrs.registry import Registry

FORCES: Registry[type[Force]] = Registry("force", "kind")
for _kind in (Steric, Gravity, Springs):
    FORCES.register(_kind)

__all__ = ["FORCES", "Force", "Gravity", "Springs", "Steric", "UserForce"]
