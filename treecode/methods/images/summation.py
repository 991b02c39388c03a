"""A periodic sum: near images in free space, and by waves what else all images do.

Ewald's split of the kernel tells what that is. Images that are not near have a smooth part only.
So the smooth part of all images is added, by waves of the cell, and that of the near ones is taken
off, by waves of a box around them.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from treecode.kernels.periodic import PeriodicKernel
from treecode.methods.ewald.long_part import Transforms, make_waves, precision_for
from treecode.methods.ewald.slab import PlaneFlow
from treecode.methods.ewald.summation import scaled_weights
from treecode.methods.fmm.summation import FastMultipole
from treecode.methods.images.arrangement import arrange
from treecode.methods.images.window import free_waves
from treecode.threads import Threads
from treecode.timing import Seconds


class NearImages:
    """A sum over all images of the sources.

    Parameters
    ----------
    kernel : PeriodicKernel
    parameters : mapping
        Of `method.ImagesMethod`. Without `xi` the split that should be the fastest is taken for the
        first points, and kept.
    progress : bool
    """

    def __init__(
        self, kernel: PeriodicKernel, parameters: Mapping[str, Any], progress: bool
    ) -> None:
        self.kernel, self._given, self._progress = kernel, parameters, progress
        self.tol: float = parameters["tol"]
        self.xi: float = parameters.get("xi", 0.0)
        of_free = {name: parameters[name] for name in ("tol", "width") if name in parameters}
        self._made_for: tuple[Any, ...] = ()
        self._free = FastMultipole(kernel.free, of_free, progress)

    @property
    def parameters(self) -> dict[str, Any]:
        """Those that were given, and those that depend on points set before."""
        return {**self._given, "xi": self.xi, "width": self._free.width}

    def set_points(self, sources: np.ndarray, targets: np.ndarray | None) -> None:
        """Find the images near the targets, and give them to the free sum; the arrays are kept."""
        self.seconds = Seconds()
        self.sources, self.targets = sources, sources if targets is None else targets
        self.source_order = np.arange(self.sources.shape[1])
        self.target_order = np.arange(self.targets.shape[1])
        if not (self.sources.size and self.targets.size):
            self._free.set_points(sources, targets)
            return
        with self.seconds.stage("images"):
            self._parts = arrange(self.kernel, self.sources, self.targets, self.tol, self.xi)
            self.xi = self._parts.split.xi / self._parts.unit
            self._make_waves()
        self._free.set_points(*self._parts.free_points())
        self.seconds |= self._free.seconds

    def _make_waves(self) -> None:
        """Make what serves as long as the cell and the size of the box stay."""
        _, task, span, split, box = self._parts[:5]
        made_for = task.vectors.tobytes(), task.epsilon, split, box.lengths.tobytes(), span
        if made_for != self._made_for:
            ends = split.xi, split.wave_number
            self._waves = make_waves(task.vectors, task.epsilon, *ends)
            self._free_waves, self._uniform = free_waves(box, task.epsilon, *ends)
            self._plane = PlaneFlow(task.vectors, span, task.epsilon) if span else None
            self._made_for = made_for

    def execute(self, strengths: np.ndarray) -> np.ndarray:
        """Return the sum, (M, value_size), of strengths (N, strength_size)."""
        if not (self.sources.size and self.targets.size):
            return self._free.execute(strengths)
        near = np.ascontiguousarray(strengths[self._parts.numbers])
        values = self._free.execute(near)
        self.seconds |= self._free.seconds
        with self.seconds.stage("waves"), Threads(self._progress) as threads:
            values += self._smooth(strengths, threads)
        return values

    def _smooth(self, strengths: np.ndarray, threads: Threads) -> np.ndarray:
        """Return the smooth part of all images, less that of those near, (M, value_size)."""
        parts, precision = self._parts, precision_for(self.tol)
        weights, unit = scaled_weights(
            self.kernel, strengths, self.source_order, parts.unit, threads
        )
        less = -weights[:, parts.numbers]
        corner, lengths = parts.box.corner[:, None], parts.box.lengths[:, None]
        within = [(points - corner) / lengths for points in (parts.sources, parts.targets)]
        places = parts.places.sources, parts.places.targets
        of_all = Transforms(self._waves, precision, weights, *places)
        of_near = Transforms(self._free_waves, precision, less, *within)
        both = [of_all, of_near] if less.size else [of_all]
        calls = [(waves, t) for waves in both for t in range(waves.count)]

        def forward(some: slice) -> None:
            waves, t = calls[some.start]
            waves.forward(t)

        def backward(some: slice) -> None:
            waves, t = calls[some.start]
            waves.backward(t)

        threads(forward, len(calls), 1)
        for waves in both:
            threads(waves.apply, waves.rows)
        threads(backward, len(calls), 1)
        smooth = np.zeros((self.targets.shape[1], self.kernel.value_size))
        for waves in both:
            waves.add_to(smooth, slice(None))
        smooth[:, :3] += self._uniform * less[:3].sum(axis=1)
        if self._plane:
            heights = self.sources[2] / parts.unit, self.targets[2] / parts.unit
            smooth += self._plane(weights, *heights)
        return smooth * (unit * parts.unit ** -np.array(self.kernel.value_lengths, float))

    @property
    def effort(self) -> float:
        """What the free sum took last, in pairs."""
        return self._free.effort

    def info(self) -> dict[str, Any]:
        """Return what the free sum tells, and besides the waves, and bytes of all."""
        info = self._free.info()
        if not (self.sources.size and self.targets.size):
            return {**info, "xi": self.xi}
        parts = self._parts
        arrays = [self.sources, self.targets, parts.places.sources, parts.places.targets]
        arrays += [parts.numbers, parts.sources, parts.targets, *self._waves, *self._free_waves]
        return {
            **info,
            "xi": self.xi,
            "cut_off": parts.unit * parts.split.distance,
            "images": len(parts.numbers),
            "waves": self._waves.shape,
            "bytes": info["bytes"] + sum({id(a): a.nbytes for a in arrays}.values()),
        }
