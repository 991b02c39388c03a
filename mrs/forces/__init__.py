"""Forces between bodies, and on all of them."""

from mrs.forces.base import Force
from mrs.forces.steric import Steric
from mrs.registry import Registry

FORCES: Registry[type[Force]] = Registry("force", "kind")
FORCES.register(Steric)

__all__ = ["FORCES", "Force", "Steric"]
