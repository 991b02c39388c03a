"""The fast multipole method: cubes act on cubes, up and down an octree."""

from treecode.methods.fmm.method import METHOD, NAME, TOLERANCES

__all__ = ["METHOD", "NAME", "TOLERANCES"]
