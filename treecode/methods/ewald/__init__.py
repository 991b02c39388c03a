"""Ewald's method for periodic sums: pairs for a short part of the kernel, waves for the rest."""

from treecode.methods.ewald.method import METHOD, NAME, ExactSum, exact_seconds

__all__ = ["METHOD", "NAME", "ExactSum", "exact_seconds"]
