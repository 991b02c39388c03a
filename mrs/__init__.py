"""Elastic rods and swimmers in very viscous fluid, by the method of regularized Stokeslets."""

from mrs import observables, rotations
from mrs.bodies import (
    BODIES,
    Beat,
    Body,
    Drive,
    Mount,
    Moving,
    Prescribed,
    Rigid,
    Rods,
    Surface,
    Swimmers,
    Taper,
    Tracers,
    TravellingWave,
    Turning,
    geometry,
    lattice_suspension,
    random_suspension,
    surfaces,
)
from mrs.bodies.geometry import Centerline
from mrs.bodies.layout import Layout
from mrs.fluid import BOUNDARIES, Backend, Flow, Fluid, Periodic, Wall, flows
from mrs.forces import FORCES, Force, Gravity, Springs, Steric, UserForce
from mrs.observables import OBSERVABLES
from mrs.output.formats import FORMATS
from mrs.output.frame_files import BodyFile
from mrs.output.options import Output
from mrs.output.trackers import Tracker
from mrs.profile import Profile
from mrs.resistance_matrix import resistance
from mrs.run.failures import SimulationError
from mrs.run.info import info
from mrs.run.opened import Run, open_run
from mrs.run.resuming import restart, resume
from mrs.run.scenario import Check, Scenario, ScenarioError
from mrs.run.simulation import Simulation
from mrs.run.velocity import frame_velocity, write_field, write_line
from mrs.scene import Evaluation, Scene
from mrs.time.integrators import METHODS as INTEGRATORS
from mrs.time.interrupts import Interrupt, Interval, Moment, Never, Steps, WallTime
from mrs.time.state import State
from mrs.time.stepper import Integrator
from treecode.version import __version__

__all__ = [
    "BODIES",
    "BOUNDARIES",
    "FORCES",
    "FORMATS",
    "INTEGRATORS",
    "OBSERVABLES",
    "Backend",
    "Beat",
    "Body",
    "BodyFile",
    "Centerline",
    "Check",
    "Drive",
    "Evaluation",
    "Flow",
    "Fluid",
    "Force",
    "Gravity",
    "Integrator",
    "Interrupt",
    "Interval",
    "Layout",
    "Moment",
    "Mount",
    "Moving",
    "Never",
    "Output",
    "Periodic",
    "Prescribed",
    "Profile",
    "Rigid",
    "Rods",
    "Run",
    "Scenario",
    "ScenarioError",
    "Scene",
    "Simulation",
    "SimulationError",
    "Springs",
    "State",
    "Steps",
    "Steric",
    "Surface",
    "Swimmers",
    "Taper",
    "Tracers",
    "Tracker",
    "TravellingWave",
    "Turning",
    "UserForce",
    "Wall",
    "WallTime",
    "__version__",
    "flows",
    "frame_velocity",
    "geometry",
    "info",
    "lattice_suspension",
    "observables",
    "open_run",
    "random_suspension",
    "resistance",
    "restart",
    "resume",
    "rotations",
    "surfaces",
    "write_field",
    "write_line",
]
