"""Ewald's method for periodic sums: pairs for a short part of the kernel, waves for the rest."""

from treecode.methods.ewald.method import METHOD, NAME, exact_seconds, exact_sum

__all__ = ["METHOD", "NAME", "exact_seconds", "exact_sum"]
