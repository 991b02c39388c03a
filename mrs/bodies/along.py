"""Arguments that may differ along rods: numbers, arrays, functions of the arclength s."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from mrs import check

FunctionOfS = Callable[[np.ndarray], Any]


@check.spelling
@dataclass(frozen=True)
class Taper:
    """A function of s that is linear from `root` at s = 0 to `tip` at s = `length`.

    Beyond `length` it keeps its value at the tip.

    Parameters
    ----------
    root, tip : array_like
        Numbers; or vectors of one size, which are rows where the function is called.
    length : float
    steps : int, optional
        Of equal length, in each of which the function has one value, that of the middle. Blob sizes
        then have as many values, and not one for each node.

    Examples
    --------
    >>> import mrs
    >>> import numpy as np
    >>> radius = mrs.Taper(root=0.2, tip=0.1, length=4.0)
    >>> print(radius(np.array([0.0, 2.0, 4.0])))
    [0.2  0.15 0.1 ]
    """

    __pydantic_config__: ClassVar[dict[str, str]] = {"extra": "forbid"}

    root: Any
    tip: Any
    length: float
    steps: int | None = None

    def __post_init__(self) -> None:
        root = check.real("root", self.root)
        if root.ndim > 1:
            raise ValueError(f"root must be a number or a vector, got shape {root.shape}")
        check.shaped("root", root, root.shape)  # finite
        check.shaped("tip", self.tip, root.shape)
        check.positive("length", self.length)
        if self.steps is not None:
            check.integer("steps", self.steps, 1)

    def __call__(self, s: np.ndarray) -> np.ndarray:
        share = np.clip(s / self.length, 0.0, 1.0)
        if self.steps is not None:
            share = (np.minimum(np.floor(self.steps * share), self.steps - 1) + 0.5) / self.steps
        root, tip = np.asarray(self.root, float), np.asarray(self.tip, float)
        return root + np.multiply.outer(share, tip - root)


@check.spelling
@dataclass(frozen=True)
class TravellingWave:
    """A wave of preferred curvature, ``amplitude sin(2 pi (s / wavelength - t / period))``.

    `amplitude` holds the components about D1, D2 and D3, radians per length; or it is a function
    of s that returns them, (3,) or a row for each s, for example a `Taper`. With a negative
    `period` the wave runs towards s = 0.

    Examples
    --------
    >>> import mrs
    >>> import numpy as np
    >>> wave = mrs.TravellingWave(amplitude=(2.0, 0.0, 0.0), wavelength=4.0, period=1.0)
    >>> print(wave(np.array([1.0, 2.0]), np.array([0.0, 0.25])))  # at two s, each at its time
    [[2. 0. 0.]
     [2. 0. 0.]]
    """

    __pydantic_config__: ClassVar[dict[str, str]] = {"extra": "forbid"}

    amplitude: Sequence[float] | Taper | FunctionOfS
    wavelength: float
    period: float

    def __post_init__(self) -> None:
        if not callable(self.amplitude):
            check.vector("amplitude", self.amplitude)
        check.positive("wavelength", self.wavelength)
        if check.number("period", self.period, -np.inf, np.inf) == 0.0:
            raise ValueError("period must not be zero")

    def __call__(self, s: np.ndarray, t: np.ndarray) -> np.ndarray:
        amplitude = self.amplitude(s) if callable(self.amplitude) else self.amplitude
        vectors = check.vectors("amplitude", amplitude, len(s), lambda row: f"at s = {s[row]:g}")
        phase = 2.0 * np.pi * (s / self.wavelength - t / self.period)
        return np.sin(phase)[:, None] * vectors


class Along(NamedTuple):
    """The segments, or the nodes, of some rods, at which arguments have values."""

    what: str
    """Either "segment" or "node"."""
    rods: np.ndarray
    """The rod of each, (n,). Each rod has at least one."""
    s: np.ndarray
    """Arclength of each from the first node of its rod, (n,)."""

    def numbers(self, name: str, value: ArrayLike | FunctionOfS) -> np.ndarray:
        """Return positive numbers, (n,).

        Parameters
        ----------
        name : str
        value : float, array_like or callable
            A number; one for each rod, (rods,); one for each segment or node, (n,); or a function
            of s, (n,), that returns a number or (n,).

        Raises
        ------
        ValueError, TypeError
        """
        return self._spread(self._given(name, value))

    def pairs(self, name: str, value: ArrayLike | FunctionOfS) -> np.ndarray:
        """Return positive numbers for D1 and D2, (n, 2).

        Parameters
        ----------
        name : str
        value : float, array_like or callable
            As for `numbers`, for both directions; or rows [D1, D2]: one for all, (1, 2), one for
            each rod, (rods, 2), or one for each segment or node, (n, 2). Columns (rods, 1) and
            (n, 1) are as (rods,) and (n,). A function of s may return (n, 2) as well.

        Raises
        ------
        ValueError, TypeError
            Also for an array of shape (2,), which could be meant either way.
        """
        if not callable(value) and (array := check.real(name, value)).shape == (2,):
            a, b = array.tolist()
            raise ValueError(
                f"{name}: [{a}, {b}] could be meant for two rods, two {self.what}s or two "
                f"directions; write [[{a}, {b}]] for D1 and D2 everywhere, or [[{a}], [{b}]] for "
                f"one number a rod or {self.what}"
            )
        array = self._given(name, value, 1, 2)
        spread = self._spread(array)
        return np.broadcast_to(spread[:, None] if array.ndim < 2 else spread, (len(self.s), 2))

    def _given(self, name: str, value: Any, *widths: int) -> np.ndarray:
        """Return what is given, or what a function gives: one number, or some rows or columns."""
        n, rods = len(self.s), int(self.rods[-1]) + 1
        array = np.asarray(check.real(name, value(self.s) if callable(value) else value), float)
        counts = (n,) if callable(value) else (rods, n)
        one_each, rows = [(m,) for m in counts], [(m, w) for m in (1, *counts) for w in widths]
        if array.shape not in [(), *one_each, *rows]:
            wide = ", or rows [D1, D2] of shape (1, 2), ({0}, 2) or ({1}, 2)" if widths else ""
            raise ValueError(
                f"{name} must be a number, one for each rod, shape ({rods},), one for each "
                f"{self.what}, ({n},){wide.format(rods, n)}; or a function of s that returns a "
                f"number or one for each {self.what}, got shape {array.shape}"
            )
        return check.within(name, array, 0.0)

    def _spread(self, array: np.ndarray) -> np.ndarray:
        """Return values where they belong, (n, ...), from one, or one for each or for each rod."""
        if array.ndim == 0 or len(array) == 1:
            return np.broadcast_to(array, (len(self.s), *array.shape[1:]))
        return array if len(array) == len(self.s) else array[self.rods]
