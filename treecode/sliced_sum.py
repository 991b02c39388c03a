"""A sum by a method that spreads points over ranks: each rank gives a slice of those it has."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from treecode.methods.base import Sum
from treecode.ranks import OneRank
from treecode.timing import Seconds


class SlicedSum:
    """A `methods.base.Sum` over points that all ranks know, or over points of each rank.

    Parameters
    ----------
    across : Sum
        Of `Method.across`.
    ranks : OneRank
        That share out points which all of them know, and get all values; one rank by itself gives
        all that it has, and gets its own.
    """

    def __init__(self, across: Sum, ranks: OneRank) -> None:
        self._across, self._ranks = across, ranks
        self._gathering = Seconds()
        self._bytes = 0

    @property
    def parameters(self) -> Mapping[str, Any]:
        """Those of the sum, the same on all ranks."""
        return self._across.parameters

    @property
    def seconds(self) -> Mapping[str, float]:
        """By stage, on this rank."""
        return {**self._across.seconds, **self._gathering}

    @property
    def effort(self) -> float:
        """Work of all ranks, in pairs."""
        return self._across.effort

    def set_points(self, sources: np.ndarray, targets: np.ndarray | None) -> None:
        """Take points, (3, N) and (3, M)."""
        self._gathering = Seconds()
        self.sources, self.targets = sources, sources if targets is None else targets
        self.source_order = np.arange(sources.shape[1])
        self.target_order = np.arange(self.targets.shape[1])
        self._own = self._ranks.share(sources.shape[1])
        own = None if targets is None else targets[:, self._ranks.share(targets.shape[1])]
        self._across.set_points(sources[:, self._own], own)

    def execute(self, strengths: np.ndarray) -> np.ndarray:
        """Return the sum, (M, value_size), of strengths (N, strength_size)."""
        own = self._across.execute(strengths[self._own])
        with self._gathering.stage("gathering"):
            values = self._ranks.gather(own)
        self._bytes = values.nbytes - own.nbytes
        return values

    def info(self) -> dict[str, Any]:
        """Return that of the sum, with the points in the bytes, and values that were received."""
        info = self._across.info()
        kept = self.sources.nbytes + (0 if self.targets is self.sources else self.targets.nbytes)
        received = info["received_bytes"] + self._bytes
        return {**info, "bytes": info["bytes"] + kept, "received_bytes": received}
