"""Methods of summation, each in one place, and the registry that knows them by name."""

from treecode.methods import direct, ewald, fmm, images, kitc, taylor
from treecode.methods.registry import get, names, parameters, register

__all__ = ["get", "names", "parameters", "register"]

for _module in (direct, kitc, taylor, fmm, ewald, images):
    register(_module.METHOD)
