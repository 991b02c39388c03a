"""A method that is not part of the package: sources in one cell of a grid are taken for one."""

from functools import partial
from typing import ClassVar

import numpy as np

import treecode as tc
from treecode import check
from treecode.methods.base import Method, Offer, Parameter

SECONDS = 1e-9  # for a pair, about


class Grid(Method):
    """Sums far away from the sources, where it hardly counts where in a cell they are."""

    name = "grid"
    parameters: ClassVar = {"degree": Parameter(partial(check.integer, low=1, high=100), 8, True)}

    def make(self, kernel, parameters, progress=False):
        return MergedSum(kernel, parameters, progress)

    def offers(self, case, given):
        low, size = box(case.sources)
        outside = np.maximum(low - case.targets, case.targets - low - size).max(axis=0)
        for cells in (2, 4, 8, 16):
            if outside.min() > size.max():
                error = size.max() / cells / outside.min()
                yield Offer({"degree": cells}, error, SECONDS * cells**3 * case.targets.shape[1])

    def describe(self, parameters):
        return f"grid({parameters['degree']})"


class MergedSum:
    """A sum over the centres of cells, with the strengths in them added up."""

    def __init__(self, kernel, parameters, progress):
        self.parameters, self.seconds = parameters, {}
        self._merged = tc.EXACT.sum(kernel, progress)

    def set_points(self, sources, targets):
        self.sources, self.targets = sources, sources if targets is None else targets
        self.source_order = np.arange(self.sources.shape[1])
        self.target_order = np.arange(self.targets.shape[1])
        low, size = box(sources)
        cells = self.parameters["degree"]
        place = np.minimum((sources - low) / size * cells, cells - 1).astype(int)
        filled, self._cell = np.unique(place, axis=1, return_inverse=True)
        self._count = filled.shape[1]
        self._merged.set_points(low + (filled + 0.5) / cells * size, self.targets.copy())

    def execute(self, strengths):
        merged = np.zeros((self._count, strengths.shape[1]))
        np.add.at(merged, self._cell.ravel(), strengths)
        return self._merged.execute(merged)

    @property
    def effort(self):
        return self._merged.effort

    def info(self):
        return {**self._merged.info(), **self.parameters}


def box(points):
    """Return the lowest corner of the box around points, (3, N), and its sides."""
    low = points.min(axis=1, keepdims=True)
    size = points.max(axis=1, keepdims=True) - low
    return low, np.where(size > 0.0, size, 1.0)
