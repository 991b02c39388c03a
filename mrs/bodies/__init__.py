"""Bodies: points in the fluid that put loads on it, and move with it."""

from mrs.bodies.base import Body
from mrs.bodies.rods import Drive, Rods, TravellingWave
from mrs.bodies.swimmers import Swimmers, lattice_suspension, random_suspension
from mrs.bodies.tracers import Tracers
from mrs.registry import Registry

BODIES: Registry[type[Body]] = Registry("body", "kind")
for _kind in (Rods, Swimmers, Tracers):
    BODIES.register(_kind)

__all__ = [
    "BODIES",
    "Body",
    "Drive",
    "Rods",
    "Swimmers",
    "Tracers",
    "TravellingWave",
    "lattice_suspension",
    "random_suspension",
]
