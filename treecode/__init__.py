"""Fast summation of the kernels of Stokes flow: direct, kernel-independent and Taylor treecodes."""

from treecode import cache
from treecode._elements import erf, exp, log
from treecode._lanes import inverse_sqrt, where
from treecode.accuracy import relative_error
from treecode.boundaries import Boundary, FreeSpace, Periodic, Term, Wall
from treecode.choice.refusals import CancellationError, ToleranceError
from treecode.dense import matrix
from treecode.evaluation import evaluate
from treecode.kernels import (
    RegularizedPressure,
    RegularizedStokeslet,
    RegularizedStokesletRotlet,
    Stokeslet,
    StokesletStresslet,
)
from treecode.kernels.base import Kernel
from treecode.kernels.periodic import PeriodicKernel
from treecode.locks import Lock
from treecode.methods.base import Method
from treecode.methods.direct import EXACT
from treecode.methods.registry import Choice, backends
from treecode.plan import Plan
from treecode.version import __version__

__all__ = [
    "EXACT",
    "Boundary",
    "CancellationError",
    "Choice",
    "FreeSpace",
    "Kernel",
    "Lock",
    "Method",
    "Periodic",
    "PeriodicKernel",
    "Plan",
    "RegularizedPressure",
    "RegularizedStokeslet",
    "RegularizedStokesletRotlet",
    "Stokeslet",
    "StokesletStresslet",
    "Term",
    "ToleranceError",
    "Wall",
    "__version__",
    "backends",
    "cache",
    "erf",
    "evaluate",
    "exp",
    "inverse_sqrt",
    "log",
    "matrix",
    "relative_error",
    "where",
]
