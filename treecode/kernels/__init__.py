"""The kernels of Stokes flow, one formula a file."""

from treecode.kernels.regularized_pressure import RegularizedPressure
from treecode.kernels.regularized_stokeslet import RegularizedStokeslet
from treecode.kernels.regularized_stokeslet_rotlet import RegularizedStokesletRotlet
from treecode.kernels.stokeslet import Stokeslet
from treecode.kernels.stokeslet_stresslet import StokesletStresslet

__all__ = [
    "RegularizedPressure",
    "RegularizedStokeslet",
    "RegularizedStokesletRotlet",
    "Stokeslet",
    "StokesletStresslet",
]
