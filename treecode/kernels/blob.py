"""Parameters of the kernels regularized by the blob ``15 eps^4 / (8 pi (r^2 + eps^2)^(7/2))``."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

from treecode import check


class _Parameters(NamedTuple):
    epsilon: float
    viscosity: float


class Blob(_Parameters):
    """A regularized kernel's parameters, checked."""

    __slots__ = ()

    def __new__(cls, epsilon: float, viscosity: float = 1.0) -> Blob:
        return super().__new__(
            cls, check.positive("epsilon", epsilon), check.positive("viscosity", viscosity)
        )

    @classmethod
    def _make(cls, iterable: Iterable[Any]) -> Any:  # type: ignore[override]  # _replace calls it
        return cls(*iterable)
