"""Boundaries of the fluid, each in one place."""

from treecode.boundaries.base import Boundary, FreeSpace, Term
from treecode.boundaries.periodic import Periodic
from treecode.boundaries.wall import Wall

__all__ = ["Boundary", "FreeSpace", "Periodic", "Term", "Wall"]
