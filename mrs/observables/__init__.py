"""Numbers that are measured in a run: fluxes, profiles, displacements, correlations."""

from mrs.observables.columns import (
    OBSERVABLES,
    Flux,
    MeanSquareDisplacement,
    OrientationCorrelation,
    OrientationMemory,
    PairDistribution,
    PumpedFlux,
    VelocityProfile,
)
from mrs.observables.flow import Rectangle, flux, pumped_flux, velocity_profile
from mrs.observables.motion import (
    diffusivity,
    growth_exponent,
    mean_square_displacement,
    orientation_memory,
)
from mrs.observables.structure import number_density, orientation_correlation, pair_distribution
from mrs.observables.tracks import Tracks, frame_loads, tracks

__all__ = [
    "OBSERVABLES",
    "Flux",
    "MeanSquareDisplacement",
    "OrientationCorrelation",
    "OrientationMemory",
    "PairDistribution",
    "PumpedFlux",
    "Rectangle",
    "Tracks",
    "VelocityProfile",
    "diffusivity",
    "flux",
    "frame_loads",
    "growth_exponent",
    "mean_square_displacement",
    "number_density",
    "orientation_correlation",
    "orientation_memory",
    "pair_distribution",
    "pumped_flux",
    "tracks",
    "velocity_profile",
]
