"""Fast summation of the kernels of Stokes flow: direct, kernel-independent and Taylor treecodes."""

from treecode._elements import erf, exp, log
from treecode._lanes import inverse_sqrt, where
from treecode.auto import CancellationError, Choice, ToleranceError
from treecode.kernels import (
    RegularizedStokeslet,
    RegularizedStokesletRotlet,
    Stokeslet,
    StokesletStresslet,
)
from treecode.kernels.base import Kernel
from treecode.locks import Lock
from treecode.plan import Plan, evaluate, relative_error

__all__ = [
    "CancellationError",
    "Choice",
    "Kernel",
    "Lock",
    "Plan",
    "RegularizedStokeslet",
    "RegularizedStokesletRotlet",
    "Stokeslet",
    "StokesletStresslet",
    "ToleranceError",
    "erf",
    "evaluate",
    "exp",
    "inverse_sqrt",
    "log",
    "relative_error",
    "where",
]
