"""How far points go, and how long directions are kept."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from mrs import check

Origins = Literal["all", "first"]

_UNEQUAL = 1e-6  # of an interval, by which others may differ from it


def mean_square_displacement(
    times: ArrayLike, positions: ArrayLike, origins: Origins = "all"
) -> np.ndarray:
    """Return the mean square of x(t + lag) - x(t), over points and origins t, (T,).

    The lags are ``times - times[0]``.

    Parameters
    ----------
    times : (T,) array_like
    positions : (T, n, 3) array_like
        Not wrapped into a periodic box, as `tracks` returns them.
    origins : {"all", "first"}, optional
        Whether t is each of the times, which must then be equally spaced, or the first only.

    Raises
    ------
    ValueError, TypeError
        If an argument has another shape, or times are not equally spaced.

    Examples
    --------
    >>> import mrs
    >>> import numpy as np
    >>> times = np.arange(4.0)
    >>> positions = times[:, None, None] * np.array([[3.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    >>> print(mrs.observables.mean_square_displacement(times, positions))
    [ 0.  5. 20. 45.]
    """

    def square(start: np.ndarray, end: np.ndarray) -> float:
        return float(np.mean(np.sum((end - start) ** 2, axis=-1)))

    return _over_lags(times, _frames("positions", positions), square, origins)


def orientation_memory(
    times: ArrayLike, directions: ArrayLike, origins: Origins = "all"
) -> np.ndarray:
    """Return the mean of p(t) . p(t + lag) over swimmers and origins t, (T,).

    The lags are ``times - times[0]``.

    Parameters
    ----------
    times : (T,) array_like
    directions : (T, n, 3) array_like
        Scaled to unit length.
    origins : {"all", "first"}, optional
        As for `mean_square_displacement`.

    Raises
    ------
    ValueError, TypeError
        If an argument has another shape, times are not equally spaced, or a direction is zero.

    Examples
    --------
    >>> import mrs
    >>> import numpy as np
    >>> angle = 2.0 * np.pi * np.arange(5) / 8  # a swimmer that turns
    >>> directions = np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])[:, None]
    >>> print(mrs.observables.orientation_memory(np.arange(5.0), directions).round(4) + 0.0)
    [ 1.      0.7071  0.     -0.7071 -1.    ]
    """

    def product(start: np.ndarray, end: np.ndarray) -> float:
        return float(np.mean(np.sum(start * end, axis=-1)))

    unit = unit_vectors("directions", _frames("directions", directions))
    return _over_lags(times, unit, product, origins)


def growth_exponent(lags: ArrayLike, values: ArrayLike) -> float:
    """Return the exponent a of values ~ lags^a, by least squares of the logarithms.

    It is 1 for diffusion and 2 for motion at constant velocity. Lags of zero are left out.

    Parameters
    ----------
    lags : (k,) array_like
    values : (k,) array_like
        For example the mean square displacement; a slice of it is fitted over a part of the lags.

    Raises
    ------
    ValueError
        If values are not positive, or if there are less than two different lags.

    Examples
    --------
    >>> import mrs
    >>> import numpy as np
    >>> lags = np.arange(1.0, 6.0)
    >>> print(round(mrs.observables.growth_exponent(lags, 4.0 * lags**2), 6))
    2.0
    """
    lags, values = _curve(lags, values)
    lags, values = lags[lags > 0.0], values[lags > 0.0]
    if (values <= 0.0).any():
        raise ValueError(f"values must be positive where lags are, got {values.min():g}")
    return _slope(np.log(lags), np.log(values))


def diffusivity(lags: ArrayLike, values: ArrayLike, dimensions: int = 3) -> float:
    """Return D of a mean square displacement 2 d D t + constant, by least squares.

    Parameters
    ----------
    lags : (k,) array_like
        Long enough for diffusion: leave out the lags before.
    values : (k,) array_like
        The mean square displacement.
    dimensions : int, optional
        d, in which points move freely.

    Raises
    ------
    ValueError
        If there are less than two different lags.

    Examples
    --------
    >>> import mrs
    >>> import numpy as np
    >>> lags = np.arange(1.0, 6.0)
    >>> print(round(mrs.observables.diffusivity(lags, 6 * 0.5 * lags + 1.0), 6))
    0.5
    """
    check.integer("dimensions", dimensions, 1, 3)
    return _slope(*_curve(lags, values)) / (2 * dimensions)


def unit_vectors(name: str, vectors: np.ndarray) -> np.ndarray:
    """Return vectors, (..., 3), scaled to unit length.

    Raises
    ------
    ValueError
        If one is zero.
    """
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
    if not lengths.all():
        raise ValueError(f"{name} must not be zero, got {np.sum(lengths == 0.0)} that are")
    return vectors / lengths


def _over_lags(
    times: ArrayLike,
    frames: np.ndarray,
    measure: Callable[[np.ndarray, np.ndarray], float],
    origins: Origins,
) -> np.ndarray:
    """Return the mean measure of frames that are each lag apart, (T,)."""
    count = len(frames)
    times = check.shaped("times", times, (count,))
    gaps = np.diff(times)
    if (gaps <= 0.0).any():
        raise ValueError("times must increase")
    if check.one_of("origins", origins, ("all", "first")) == "first":
        return np.array([measure(frames[0], frame) for frame in frames])
    if count > 1 and np.ptp(gaps) > _UNEQUAL * gaps[0]:
        raise ValueError(
            "times must be equally spaced for origins='all', got intervals from "
            f"{gaps.min():g} to {gaps.max():g}: leave frames out, such as that of the end of the "
            "run, or choose origins='first'"
        )
    return np.array([measure(frames[: count - lag], frames[lag:]) for lag in range(count)])


def _frames(name: str, value: ArrayLike) -> np.ndarray:
    array = check.real(name, value)
    if array.ndim != 3 or array.shape[2] != 3 or not array.size:
        raise ValueError(
            f"{name} must have shape (T, n, 3), none of them 0, as those of tracks(run, body); got "
            f"{array.shape}"
        )
    return check.shaped(name, array, array.shape)


def _curve(lags: ArrayLike, values: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    count = np.size(lags)
    return check.shaped("lags", lags, (count,)), check.shaped("values", values, (count,))


def _slope(x: np.ndarray, y: np.ndarray) -> float:
    if len(set(x)) < 2:
        raise ValueError(f"lags must be at least two different ones, got {len(set(x))}")
    x = x - x.mean()
    return float(x @ y / (x @ x))
