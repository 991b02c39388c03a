"""Where bodies are, seen from each other: pair distribution, correlation by distance, density."""

from __future__ import annotations

import numpy as np
import scipy
from numpy.typing import ArrayLike

from mrs import check
from mrs.fluid import Periodic
from mrs.observables.motion import unit_vectors

_ROUNDING = 1e-12  # part of a width that bins may reach beyond half of it


def pair_distribution(
    positions: ArrayLike, bins: ArrayLike, cell: ArrayLike | None = None
) -> np.ndarray:
    """Return g(r), (k,): pairs in each bin of distance, in units of those of an ideal gas.

    Without a periodic cell the ideal gas fills the smallest box around the points with faces along
    the axes. Pairs of which one point would be outside of it are accounted for exactly.

    Parameters
    ----------
    positions : (n, 3) array_like
        At least two; in a periodic cell anywhere.
    bins : (k + 1,) array_like
        Edges of the bins, increasing from 0 or more. A bin has its upper edge.
    cell : (3,) or (3, 3) array_like, optional
        Periodic box: lengths of its edges along the axes, or lattice vectors in rows.

    Raises
    ------
    ValueError, TypeError
        If an argument has another shape, or if bins reach beyond half the width of the cell, or
        beyond the shortest edge of the box around the points.

    Notes
    -----
    With a cell, g = pairs / [n (n - 1) (shell's volume) / V]. Without, the shell's volume is
    multiplied by the mean over directions of (overlap of the box with itself moved by r) / V.

    Examples
    --------
    >>> import mrs
    >>> import numpy as np
    >>> gas = np.random.default_rng(0).random((2000, 3))
    >>> print(mrs.observables.pair_distribution(gas, [0.1, 0.2, 0.3], cell=(1, 1, 1)).round(2))
    [1. 1.]
    """
    points, edges = check.points("positions", positions), bin_edges(bins)
    count = len(points)
    if count < 2:
        raise ValueError(f"positions must be at least two points, got {count}")
    if cell is None:
        share = _share_in_box(np.ptp(points, axis=0), edges)
    else:
        share = np.diff(4.0 / 3.0 * np.pi * edges**3) / abs(np.linalg.det(Periodic(cell).vectors))
    return _sums_over_pairs(points, np.ones((count, 1)), edges, cell) / (
        count * (count - 1) * share
    )


def orientation_correlation(
    positions: ArrayLike,
    directions: ArrayLike,
    bins: ArrayLike,
    cell: ArrayLike | None = None,
) -> np.ndarray:
    """Return the mean of p_i . p_j over the pairs in each bin of distance, (k,); nan without pairs.

    Parameters
    ----------
    positions : (n, 3) array_like
    directions : (n, 3) array_like
        Scaled to unit length.
    bins : (k + 1,) array_like
        As for `pair_distribution`.
    cell : (3,) or (3, 3) array_like, optional
        As for `pair_distribution`.

    Raises
    ------
    ValueError, TypeError
        If an argument has another shape, a direction is zero, or if bins reach beyond half the
        width of the cell.

    Examples
    --------
    >>> import mrs
    >>> positions = [[0, 0, 0], [1, 0, 0], [2, 0, 0]]
    >>> directions = [[1, 0, 0], [1, 0, 0], [-1, 0, 0]]
    >>> print(mrs.observables.orientation_correlation(positions, directions, bins=[0.5, 1.5, 2.5]))
    [ 0. -1.]
    """
    points, edges = check.points("positions", positions), bin_edges(bins)
    unit = unit_vectors("directions", check.rows("directions", directions, 3, len(points)))
    pairs = _sums_over_pairs(points, np.ones((len(points), 1)), edges, cell)
    products = _sums_over_pairs(points, unit, edges, cell)
    return np.divide(products, pairs, out=np.full(len(pairs), np.nan), where=pairs > 0)


def number_density(
    positions: ArrayLike, edges: ArrayLike, area: float, axis: int = 2
) -> np.ndarray:
    """Return the number of points per volume in slabs across an axis, (k,).

    Parameters
    ----------
    positions : (n, 3) array_like
    edges : (k + 1,) array_like
        Of the slabs, increasing.
    area : float
        Of a slab, across the axis.
    axis : int, optional
        0, 1 or 2.

    Raises
    ------
    ValueError, TypeError
        If an argument has another shape, or the edges do not increase.

    Examples
    --------
    >>> import mrs
    >>> import numpy as np
    >>> positions = np.random.default_rng(0).random((1000, 3)) ** [1, 1, 2]  # denser below
    >>> print(mrs.observables.number_density(positions, [0.0, 0.25, 1.0], area=1.0))
    [2008.  664.]
    """
    points, edges = check.points("positions", positions), _increasing("edges", edges)
    check.positive("area", area)
    counts, _ = np.histogram(points[:, check.integer("axis", axis, 0, 2)], edges)
    return counts / (area * np.diff(edges))


def _increasing(name: str, value: ArrayLike) -> np.ndarray:
    edges = check.shaped(name, value, (np.size(value),))
    if len(edges) < 2 or (np.diff(edges) <= 0.0).any():
        raise ValueError(f"{name} must be at least two numbers that increase, got {value!r}")
    return edges


def bin_edges(bins: ArrayLike) -> np.ndarray:
    edges = _increasing("bins", bins)
    if edges[0] < 0.0:
        raise ValueError(f"bins must not be negative, got {edges[0]:g}")
    return edges


def require_within(reach: float, box: Periodic) -> None:
    """Refuse bins that reach beyond half the width of a periodic box, and slabs."""
    if len(box.cell) < 3:
        raise ValueError(f"cell must have three lattice vectors, got {box}")
    half = 0.5 * box.heights.min()
    if reach > (1.0 + _ROUNDING) * half:
        raise ValueError(
            f"bins must end within half the width of the cell, {half:g}, got {reach:g}"
        )


def _share_in_box(box: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Return the part of the pairs of two random points in a box that is in each bin."""
    if edges[-1] > box.min():
        raise ValueError(
            f"bins must end within the shortest edge {box.min():g} of the box around the "
            f"positions, got {edges[-1]:g}; or is there a periodic cell?"
        )
    a, b, c = box
    r = edges
    # Mean overlap: abc - (ab + bc + ca) r/2 + 2 (a + b + c) r^2/(3 pi) - r^3/(4 pi)
    overlaps = (
        4.0 / 3.0 * np.pi * a * b * c * r**3
        - np.pi / 2.0 * (a * b + b * c + c * a) * r**4
        + 8.0 / 15.0 * (a + b + c) * r**5
        - r**6 / 6.0
    )
    return np.diff(overlaps) / (a * b * c) ** 2


def _sums_over_pairs(
    points: np.ndarray, values: np.ndarray, edges: np.ndarray, cell: ArrayLike | None
) -> np.ndarray:
    """Return the sums of v_i . v_j over ordered pairs in each bin of distance, (k,)."""
    others, numbers = points, np.arange(len(points))
    if cell is not None:
        box = Periodic(cell)
        require_within(edges[-1], box)
        others, numbers = box.with_images(points, edges[-1])
        points = others[: len(points)]
    own, all_others = scipy.spatial.cKDTree(points), scipy.spatial.cKDTree(others)
    sums = [
        own.count_neighbors(all_others, edges, weights=(v, v[numbers]), cumulative=False)
        for v in values.T
    ]
    return np.sum(sums, axis=0)[1:]  # the first has distances up to the first edge: 0 is a point
