"""Methods of summation, each in one place, and the registry that knows them by name."""

from treecode.methods import direct, ewald, fmm, kitc, taylor
from treecode.methods.registry import get, names, parameters, register

__all__ = ["get", "names", "parameters", "register"]

for _method in (direct.METHOD, kitc.METHOD, taylor.METHOD, fmm.METHOD, ewald.METHOD):
    register(_method)
