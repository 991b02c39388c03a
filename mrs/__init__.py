"""Elastic rods and swimmers in very viscous fluid, by the method of regularized Stokeslets."""

from mrs import flows, geometry, rotations
from mrs.bodies import Body
from mrs.mobility import Backend
from mrs.rods import Drive, Rods, TravellingWave
from mrs.runs import restart, resume
from mrs.scenario import Check, Scenario, ScenarioError
from mrs.simulation import Fluid, Simulation, SimulationError
from mrs.stepper import Integrator
from mrs.steric import Steric
from mrs.swimmers import Swimmers, lattice_suspension, random_suspension
from mrs.tracers import Tracers
from mrs.trackers import Output, Tracker

__all__ = [
    "Backend",
    "Body",
    "Check",
    "Drive",
    "Fluid",
    "Integrator",
    "Output",
    "Rods",
    "Scenario",
    "ScenarioError",
    "Simulation",
    "SimulationError",
    "Steric",
    "Swimmers",
    "Tracers",
    "Tracker",
    "TravellingWave",
    "flows",
    "geometry",
    "lattice_suspension",
    "random_suspension",
    "restart",
    "resume",
    "rotations",
]
