"""Periodic sums where points crowd: near images in free space, and waves for all others."""

from treecode.methods.images.method import METHOD, NAME

__all__ = ["METHOD", "NAME"]
