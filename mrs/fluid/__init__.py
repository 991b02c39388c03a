"""The fluid: its viscosity, boundary and background flow, and the mobility of points in it."""

from mrs.fluid.flows import Flow
from mrs.fluid.fluid import BOUNDARIES, Fluid, Periodic, Wall
from mrs.fluid.mobility import Backend, Mobility
from mrs.fluid.resistance import Resistance, ResistanceError

__all__ = [
    "BOUNDARIES",
    "Backend",
    "Flow",
    "Fluid",
    "Mobility",
    "Periodic",
    "Resistance",
    "ResistanceError",
    "Wall",
]
