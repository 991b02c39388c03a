"""Fast summation of the kernels of Stokes flow: direct, kernel-independent and Taylor treecodes."""

from treecode._lanes import inverse_sqrt, where
from treecode.kernels import (
    RegularizedStokeslet,
    RegularizedStokesletRotlet,
    Stokeslet,
    StokesletStresslet,
)
from treecode.kernels.base import Kernel
from treecode.plan import Plan, evaluate, relative_error

__all__ = [
    "Kernel",
    "Plan",
    "RegularizedStokeslet",
    "RegularizedStokesletRotlet",
    "Stokeslet",
    "StokesletStresslet",
    "evaluate",
    "inverse_sqrt",
    "relative_error",
    "where",
]
