"""Bodies: points in the fluid that put loads on it, and move with it."""

from mrs.bodies.along import Taper, TravellingWave
from mrs.bodies.base import Body
from mrs.bodies.beats import Beat
from mrs.bodies.drive import Drive, Mount
from mrs.bodies.noise import Noise
from mrs.bodies.rigid import Prescribed, Rigid
from mrs.bodies.rods import Rods
from mrs.bodies.shapes import Moving, Turning
from mrs.bodies.surfaces import Surface
from mrs.bodies.swimmers import Swimmers, lattice_suspension, random_suspension
from mrs.bodies.tracers import Tracers
from mrs.registry import Registry

BODIES: Registry[type[Body]] = Registry("body", "kind")
for _kind in (Rods, Rigid, Prescribed, Swimmers, Tracers):
    BODIES.register(_kind)

__all__ = [
    "BODIES",
    "Beat",
    "Body",
    "Drive",
    "Mount",
    "Moving",
    "Noise",
    "Prescribed",
    "Rigid",
    "Rods",
    "Surface",
    "Swimmers",
    "Taper",
    "Tracers",
    "TravellingWave",
    "Turning",
    "lattice_suspension",
    "random_suspension",
]
