"""The operators of all levels of a tree, which are kept as long as they serve."""

from __future__ import annotations

from typing import Any

import numpy as np

from treecode.blas import blas_of_one_thread
from treecode.kernels.base import Kernel
from treecode.methods.fmm import loops
from treecode.methods.fmm.level import OFFSETS, Level
from treecode.methods.fmm.lists import Lists
from treecode.methods.fmm.octree import Octree
from treecode.methods.fmm.sizing import FIRST_LEVEL, SAFETY, precision_for, require_memory
from treecode.methods.fmm.store import get_level
from treecode.methods.fmm.symmetry import scale_powers
from treecode.methods.fmm.transfer import Transfer, make_transfer
from treecode.threads import Threads

ALL_OFFSETS = np.array(OFFSETS)


def first_level(tree: Octree, lists: Lists) -> int:
    """Return the first level that has anything far from anything; one beyond the last if none."""
    between_sizes = np.append(lists.coarse_boxes, lists.proxy_boxes)
    first = int(min(tree.level[between_sizes], default=tree.depth + 1))
    for level in range(FIRST_LEVEL, first):
        if loops.has_far_sources(tree, lists.boxes_with_targets(tree, level), ALL_OFFSETS):
            return level
    return first


class Hierarchy:
    """Operators of the levels from the first on that has anything far from anything.

    Attributes
    ----------
    first : int
        This level.
    levels : dict of int to Level
    transfers : dict of int to Transfer
        Between a level and the one above.
    dtype : type
        float32 or float64, of all operators.
    """

    def __init__(self, kernel: Kernel, tol: float, degree: int | None) -> None:
        self._kernel, self._tol, self._degree = kernel, tol, degree
        self.first = 0
        self.levels: dict[int, Level] = {}
        self.transfers: dict[int, Transfer] = {}
        self.dtype: Any = np.float64
        self._served: tuple[int, list[float]] = 0, []

    def serve(self, first: int, halves: list[float]) -> None:
        """Get the operators for the levels of a tree from `first` on, with half sides of cubes.

        Raises
        ------
        ValueError
            If they do not fit in memory, or the kernel has not the symmetries that they ask for.
        """
        self.first = first
        if (first, halves) != self._served:
            self._served = 0, []  # nothing is, if building fails
            self._get_levels(halves)
            self._served = first, halves

    def _get_levels(self, halves: list[float]) -> None:
        """Get the operators for cubes of some sizes, each half the one before."""
        single = precision_for(self._tol) == "float32" and bool(halves)
        single = single and loops.single_serves(self._kernel, halves[-1], self._tol)
        self.dtype = np.float32 if single else np.float64
        powers = scale_powers(self._kernel, halves) if halves else None
        sizes = halves if powers is None else [1.0]  # one serves all
        if sizes:
            require_memory(self._kernel, self._tol, len(sizes), self.dtype)
        levels: dict[float, Level] = {}

        def get(chunk: slice) -> None:
            half = sizes[chunk.start]
            levels[half] = get_level(
                self._kernel, half, SAFETY * self._tol, self._degree, self.dtype
            )

        with blas_of_one_thread, Threads() as threads:
            threads(get, len(sizes), 1)
        if powers is not None:
            levels = {half: levels[1.0].resized(half, powers) for half in halves}
        self.levels = {self.first + i: levels[half] for i, half in enumerate(halves)}
        self.transfers = {}
        for level in range(self.first + 1, self.first + len(halves)):
            if powers is not None and self.transfers:  # that between any two is the same
                self.transfers[level] = self.transfers[level - 1]
            else:
                self.transfers[level] = make_transfer(self.levels[level], self.levels[level - 1])

    def arrays(self) -> list[np.ndarray]:
        """Return all arrays that are in memory; levels may share some."""
        out: list[np.ndarray] = []
        for level in self.levels.values():
            out += [a for a in level if isinstance(a, np.ndarray)]
            out += [a for item in level if isinstance(item, tuple) for a in item]
        return out + [array for transfer in self.transfers.values() for array in transfer]
