"""Boundaries of the fluid, one in each file."""

from treecode.boundaries.periodic import Periodic

__all__ = ["Periodic"]
