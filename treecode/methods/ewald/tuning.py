"""What a tolerance asks for: where both parts are cut off, and the split that costs least.

All lengths are in units of the edge of a cube as large as the cell.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from treecode.methods.ewald.cells import pairs_of_a_target
from treecode.methods.ewald.long_part import count_waves, precision_for
from treecode.methods.ewald.split import blob, multiplier, short_functions

_SHARE = 0.25  # of the tolerance, for the error of each cut-off
_SINGLE = 3e-6  # tolerance from which pairs are summed in singles,
_SINGLE_UNIT = 2.0**-24  # whose rounding the kernel has to bear
_SAMPLES = 400  # distances, and wave numbers, at which tails are integrated
_LONGEST = 0.76 * 2.0 * math.pi  # from this wave number on the integral is the sum over a cube
SPLITS = tuple(2.0 ** (0.25 * n) for n in range(4, 41))  # that are tried, from the first

# Seconds on one thread of an EPYC (Zen 3, AVX2), of which ratios matter; no clock is asked, or a
# choice would depend on it. Of a pair by values and bytes of a number, with what is done around it;
# of finufft by bytes of a complex number, for a point of its kernel and for one of its own grid.
_PAIR = {(3, 8): 1.4e-8, (3, 4): 6.7e-9, (6, 8): 2.1e-8, (6, 4): 9.0e-9}
_WAVE = {16: (8.5e-10, 5.5e-8), 8: (6.0e-10, 3.2e-8)}


class Task(NamedTuple):
    """A periodic sum, in units of its cell.

    Attributes
    ----------
    vectors : (3, 3) float64
        Lattice vectors, in rows; the volume is 1.
    epsilon : float
    size : int
        Of the values of the kernel: 3, or 6 with torques and angular velocities.
    sources, targets : int
        How many.
    tol : float
    """

    vectors: np.ndarray
    epsilon: float
    size: int
    sources: int
    targets: int
    tol: float


class Split(NamedTuple):
    """A splitting parameter, and where both parts are cut off.

    Attributes
    ----------
    xi : float
        An inverse length.
    distance : float
        Of pairs.
    wave_number : float
    norm : float
        Root mean square of the velocity that a random force of size 1 drives, times 8 pi mu.
    """

    xi: float
    distance: float
    wave_number: float
    norm: float


def split_at(task: Task, xi: float) -> Split:
    """Return the split by a parameter, with tails that are a small part of the flow.

    Both are root mean squares over random strengths and targets: of what is cut off, as of Kolafa &
    Perram (Mol. Simul. 9, 1992) and Lindbo & Tornberg (J. Comput. Phys. 230, 2011), and of the
    whole. They are compared for each pair of load and motion apart. No pair of points counts that
    is closer than is usual: what a point does to itself would hide errors elsewhere. What a clump
    does to itself is not random: the largest values of what is cut off are compared with that of
    the kernel too.
    """
    x = np.linspace(0.0, math.sqrt(math.log(1.0 / task.tol) + 12.0), _SAMPLES + 1)[1:]
    r, k = x / xi, 2.0 * xi * x
    spacing = max(task.epsilon, max(task.sources, 1) ** (-1.0 / 3.0))
    all_k = np.geomspace(_LONGEST, _LONGEST + 30.0 / task.epsilon, _SAMPLES)
    kinds = zip(
        _squares_of_pairs(r, task.epsilon, xi),
        _squares_of_waves(k, multiplier(k, task.epsilon, xi)),
        _squares_of_waves(all_k, blob(spacing * all_k)),
        _squares_of_waves(all_k, blob(task.epsilon * all_k)),
        strict=True,
    )
    distance = wave_number = 0.0
    norms = []
    for pairs, waves, flow, own in list(kinds)[: 3 if task.size == 6 else 1]:
        norms.append(math.sqrt(np.trapezoid(flow, all_k)))
        limit = (_SHARE * task.tol * norms[-1]) ** 2
        largest = _SHARE * task.tol * float(np.trapezoid(_peak(all_k, own), all_k))
        distance = max(distance, _end(r, pairs, limit), _last(r, pairs, largest))
        wave_number = max(wave_number, _end(k, waves, limit), _end(k, _peak(k, waves), largest))
    return Split(xi, distance, wave_number, norms[0])


def pair_precision(task: Task, split: Split) -> type:
    """Return the type of numbers in which pairs are summed.

    Roundings of singles are those of coordinates, beside the blob, and of the kernel, which is
    1/r, of all pairs at worst in the same direction.
    """
    limit = _SHARE * task.tol
    resolved = _SINGLE_UNIT * split.distance <= limit * task.epsilon
    terms = 4.0 * math.pi * split.distance**2 * math.sqrt(task.sources)
    precise = _SINGLE_UNIT * terms <= limit * split.norm
    return np.float32 if task.tol >= _SINGLE and resolved and precise else np.float64


def seconds_of(task: Task, split: Split, crowding: float = 1.0) -> tuple[float, float]:
    """Return what both parts take on one thread: pairs, and waves.

    `crowding` is by how much there are more pairs than if points were spread evenly.
    """
    itemsize = np.dtype(pair_precision(task, split)).itemsize
    densities = crowding * task.sources, crowding * task.targets
    pairs = (
        _PAIR[task.size, itemsize] * task.targets * pairs_of_a_target(split.distance, *densities)
    )
    waves = count_waves(task.vectors, split.wave_number)
    return pairs, seconds_of_waves(task.size, task.tol, waves, task.sources + task.targets)


def seconds_of_waves(size: int, tol: float, counts: np.ndarray, points: int) -> float:
    """Return what waves from -counts to counts take on one thread, of sources and targets."""
    precision = precision_for(tol)
    spread, grid = _WAVE[np.dtype(precision.dtype).itemsize]
    waves = 2.0 * counts + 1.0
    each = spread * precision.width**3 * points
    each += 2.0 * grid * float(np.prod(precision.factor * waves + precision.width))
    return -(-size // 2) * each


def cheapest_split(task: Task, crowding: Callable[[float], float] = lambda _: 1.0) -> Split:
    """Return the split that should take the least time; `crowding` is that within a distance."""
    best, least = None, math.inf
    for xi in SPLITS:
        split = split_at(task, xi)
        pairs, waves = seconds_of(task, split, crowding(split.distance))
        if waves >= least:  # they become more and more
            break
        if pairs + waves < least:
            best, least = split, pairs + waves
    assert best is not None
    return best


def _end(x: np.ndarray, density: np.ndarray, limit: float) -> float:
    """Return from where on a positive function has no integral above `limit`."""
    parts = 0.5 * (density[1:] + density[:-1]) * np.diff(x)
    tails = np.append(parts[::-1].cumsum()[::-1], 0.0)
    return float(x[np.argmax(tails <= limit)])


def _last(r: np.ndarray, squares: np.ndarray, limit: float) -> float:
    """Return from where on the short part is nowhere larger than `limit`."""
    larger = np.flatnonzero(squares > 4.0 * math.pi * (limit * r) ** 2)
    return float(r[min(larger[-1] + 1, len(r) - 1)]) if larger.size else 0.0


def _peak(k: np.ndarray, squares: np.ndarray) -> np.ndarray:
    """Return what shells of waves add to the value at r = 0."""
    return np.asarray(k / (math.sqrt(2.0) * math.pi) * np.sqrt(squares))


def _squares_of_pairs(r: np.ndarray, epsilon: float, xi: float) -> list[np.ndarray]:
    """Return squares of the norms of the short part over shells: f to u, f to w, n to w."""
    r2 = r**2
    shell = 4.0 * math.pi * r2
    a0, a1, a2, a3 = short_functions(r2, epsilon, xi)
    q, d = 2.5 * a1 - 0.5 * r2 * a2, 1.75 * a2 - 0.25 * r2 * a3
    return [
        shell * (2.0 * (2.0 * a0 - r2 * a1) ** 2 + 4.0 * a0**2),
        shell * 2.0 * q**2 * r2,
        shell * (2.0 * (q - r2 * d) ** 2 + q**2),
    ]


def _squares_of_waves(k: np.ndarray, factor: np.ndarray) -> list[np.ndarray]:
    """Return squares of the norms of waves over shells: f to u, f to w, n to w."""
    chi = 4.0 * math.pi / k**2 * factor
    shell = k**2 / (2.0 * math.pi**2)
    return [shell * 8.0 * chi**2, shell * 2.0 * chi**2 * k**2, shell * 0.5 * chi**2 * k**4]
