"""Elastic rods and swimmers in very viscous fluid, by the method of regularized Stokeslets."""

from mrs import flows, geometry, rotations
from mrs.bodies import Body
from mrs.flows import Flow
from mrs.geometry import Centerline
from mrs.mobility import Backend
from mrs.profile import Profile
from mrs.rods import Drive, Rods, TravellingWave
from mrs.runs import restart, resume
from mrs.scenario import Check, Scenario, ScenarioError
from mrs.simulation import Evaluation, Fluid, Simulation, SimulationError
from mrs.state import State
from mrs.stepper import Integrator
from mrs.steric import Steric
from mrs.swimmers import Swimmers, lattice_suspension, random_suspension
from mrs.tracers import Tracers
from mrs.trackers import Output, Tracker
from treecode.version import __version__

__all__ = [
    "Backend",
    "Body",
    "Centerline",
    "Check",
    "Drive",
    "Evaluation",
    "Flow",
    "Fluid",
    "Integrator",
    "Output",
    "Profile",
    "Rods",
    "Scenario",
    "ScenarioError",
    "Simulation",
    "SimulationError",
    "State",
    "Steric",
    "Swimmers",
    "Tracers",
    "Tracker",
    "TravellingWave",
    "__version__",
    "flows",
    "geometry",
    "lattice_suspension",
    "random_suspension",
    "restart",
    "resume",
    "rotations",
]
