"""The smooth part of a periodic sum: to waves and back by finufft, and flow by flow of waves.

Two real vectors are the parts of one complex transform. Each transform has one thread: with several
finufft adds in an order that depends on them, so that the last bits would.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import scipy

from treecode._jit import compiled, inlined
from treecode.methods.ewald.split import multiplier

# Errors from which on finufft serves in singles, and in doubles on its coarser grid; and what it is
# asked for at least, since its kernels have that: it errs by less on the coarser grid.
_SINGLE, _SINGLE_FINEST = 1e-5, 2e-5
_COARSE, _COARSE_FINEST = 1e-10, 3e-10
_FINEST = 1.01e-14
_KNOTS, _DEGREE = 2000, 7  # of the spline of the multiplier


class Waves(NamedTuple):
    """The waves of a sum.

    Attributes
    ----------
    counts : (3,) int64
        Waves from -counts to counts along each reciprocal vector.
    reciprocal : (3, 3) float64
        Reciprocal vectors, in rows, with the factor 2 pi.
    chi : (counts[0] + 1, 2 counts[1] + 1, 2 counts[2] + 1) float64
        Half of what a force drives across a wave, over the volume: of the smooth part 4 pi / k^2
        times the multiplier. Of half of the waves, which the conjugates of the others are.
    """

    counts: np.ndarray
    reciprocal: np.ndarray
    chi: np.ndarray

    @property
    def shape(self) -> tuple[int, ...]:
        """Waves along each reciprocal vector."""
        return tuple((2 * self.counts + 1).tolist())


def count_waves(vectors: np.ndarray, largest: float) -> np.ndarray:
    """Return how many waves there are along each reciprocal vector, up to a wave number."""
    return (largest * np.linalg.norm(vectors, axis=1) / (2.0 * math.pi)).astype(np.int64)


def make_waves(vectors: np.ndarray, epsilon: float, xi: float, largest: float) -> Waves:
    """Return the waves up to a wave number, for the smooth part of a split."""

    def chi(k: np.ndarray) -> np.ndarray:
        # As a function of log k it is smooth, which it is not at k = 0.
        knots = np.linspace(math.log(k.min()) - 0.1, math.log(largest) + 0.1, _KNOTS)
        smooth = scipy.interpolate.make_interp_spline(
            knots, multiplier(np.exp(knots), epsilon, xi), _DEGREE
        )
        return np.asarray(4.0 * math.pi * smooth(np.log(k)) / k**2)

    return waves_of(vectors, largest, chi)


def waves_of(vectors: np.ndarray, largest: float, chi: Callable[[np.ndarray], np.ndarray]) -> Waves:
    """Return the waves up to a wave number; `chi` is a function of wave numbers, (n,)."""
    counts = count_waves(vectors, largest)
    reciprocal = 2.0 * math.pi * np.linalg.inv(vectors).T
    numbers = [np.arange(-n, n + 1.0) for n in counts]
    numbers[0] = numbers[0][: counts[0] + 1]
    k2 = np.zeros([len(n) for n in numbers])
    for d in range(3):
        parts = [n * b for n, b in zip(numbers, reciprocal[:, d], strict=True)]
        k2 += (parts[0][:, None, None] + parts[1][:, None] + parts[2]) ** 2
    used = (k2 > 0.0) & (k2 <= largest**2)
    values = np.zeros_like(k2)
    if used.any():
        values[used] = chi(np.sqrt(k2[used])) / abs(np.linalg.det(vectors))
    return Waves(counts, reciprocal, values)


class Precision(NamedTuple):
    """How finufft is called.

    Attributes
    ----------
    dtype : type
        Of the transforms.
    error : float
        That it is asked for.
    factor : float
        By how much its grid is finer than the waves ask for, in each direction.
    """

    dtype: type
    error: float
    factor: float

    @property
    def width(self) -> float:
        """Points of the grid, in each direction, to which a point is spread."""
        return -math.log(self.error) / (math.pi * math.sqrt(1.0 - 1.0 / self.factor))


def precision_for(tol: float) -> Precision:
    """Return what serves for an error of the flow, which is smaller than that of its waves."""
    if tol >= _SINGLE:
        return Precision(np.complex64, max(tol, _SINGLE_FINEST), 1.25)
    if tol >= _COARSE:
        return Precision(np.complex128, max(tol, _COARSE_FINEST), 1.25)
    return Precision(np.complex128, max(0.3 * tol, _FINEST), 2.0)


def to_waves(
    places: np.ndarray, strengths: np.ndarray, shape: tuple[int, ...], precision: Precision
) -> np.ndarray:
    """Return the transform of complex strengths, (N,), at points in parts of lattice vectors."""
    import finufft  # not before it is used: free space needs none

    return _transform(finufft.nufft3d1, places, strengths, precision, isign=-1, n_modes=shape)


def from_waves(places: np.ndarray, modes: np.ndarray, precision: Precision) -> np.ndarray:
    """Return the sum of waves, (M,), at points in parts of lattice vectors."""
    import finufft

    return _transform(finufft.nufft3d2, places, modes, precision, isign=1)


def _transform(
    function: Callable,
    places: np.ndarray,
    data: np.ndarray,
    precision: Precision,
    **options: Any,
) -> np.ndarray:
    data = data.astype(precision.dtype, copy=False)
    # Signs of waves, from angles that begin at -pi, cancel on the way back.
    angles = (2.0 * math.pi * places - math.pi).astype(data.real.dtype, copy=False)
    options |= {"eps": precision.error, "upsampfac": precision.factor, "nthreads": 1}
    return np.asarray(function(*angles, data, **options))


class Transforms:
    """The smooth flow of some weights: to waves and back, one transform after the other.

    Parameters
    ----------
    waves : Waves
    precision : Precision
    weights : (3 or 6, N) float64
        Forces, and torques.
    sources, targets : (3, N) and (3, M) float64
        In parts of lattice vectors.

    Attributes
    ----------
    count : int
        Calls of `forward` and of `backward`, in any order, on any threads.
    rows : int
        Of waves, to which `apply` applies the kernel between them.
    """

    def __init__(
        self,
        waves: Waves,
        precision: Precision,
        weights: np.ndarray,
        sources: np.ndarray,
        targets: np.ndarray,
    ) -> None:
        self._waves, self._precision = waves, precision
        self._weights, self._sources, self._targets = weights, sources, targets
        self.count, self.rows = -(-len(weights) // 2), int(waves.counts[0]) + 1
        self._modes: np.ndarray = np.zeros((self.count, *waves.shape), precision.dtype)
        self._smooth: np.ndarray = np.empty((self.count, targets.shape[1]), precision.dtype)

    def forward(self, t: int) -> None:
        """Turn two components of the weights into waves."""
        real, *imaginary = self._weights[2 * t : 2 * t + 2]
        pair = real + 1j * (imaginary[0] if imaginary else 0.0)
        self._modes[t] = to_waves(self._sources, pair, self._waves.shape, self._precision)

    def apply(self, rows: slice) -> None:
        """Turn some waves of the weights into those of their flow."""
        waves = self._waves
        of_waves = waves.counts, waves.reciprocal, waves.chi
        apply_flow(self._modes, *of_waves, rows.start, rows.stop)

    def backward(self, t: int) -> None:
        """Turn the waves of two components of the flow into values at the targets."""
        self._smooth[t] = from_waves(self._targets, self._modes[t], self._precision)

    def add_to(self, values: np.ndarray, order: np.ndarray | slice) -> None:
        """Add the flow to some rows of values, (M, 3 or 6), one for each target."""
        for c in range(values.shape[1]):
            part = self._smooth[c // 2]
            values[order, c] += part.imag if c % 2 else part.real


@compiled
def apply_flow(modes, counts, reciprocal, chi, begin, end):
    """Turn the waves of strengths into those of their flow, in place.

    Parameters
    ----------
    modes : (T, ...) complex128
        Of T transforms, each of two real vectors: three of forces, and then three of torques if
        there are six. Overwritten by velocities, and angular velocities.
    counts, reciprocal, chi :
        See `Waves`.
    begin, end : int
        Waves ``begin - counts[0]`` to ``end - counts[0]`` along the first reciprocal vector, no
        larger than 0, with their conjugates.
    """
    size1, size2, size3 = 2 * counts[0], 2 * counts[1], 2 * counts[2]
    torques = len(modes) == 3
    q = np.zeros(6, np.complex128)
    flow = np.zeros(6, np.complex128)
    k = np.zeros(3)
    for i in range(begin, end):
        for j in range(size2 + 1):
            for m in range(size3 + 1):
                if i == counts[0] and (j > counts[1] or (j == counts[1] and m > counts[2])):
                    continue  # conjugates of others
                for t in range(len(modes)):
                    a = modes[t, i, j, m]
                    b = modes[t, size1 - i, size2 - j, size3 - m].conjugate()
                    q[2 * t] = 0.5 * (a + b)
                    q[2 * t + 1] = -0.5j * (a - b)
                for d in range(3):
                    k[d] = (
                        (i - counts[0]) * reciprocal[0, d]
                        + (j - counts[1]) * reciprocal[1, d]
                        + (m - counts[2]) * reciprocal[2, d]
                    )
                _flow_of_wave(k, chi[i, j, m], q, torques, flow)
                for t in range(len(modes)):
                    a, b = flow[2 * t], 1j * flow[2 * t + 1]
                    modes[t, i, j, m] = a + b
                    modes[t, size1 - i, size2 - j, size3 - m] = a.conjugate() - b.conjugate()


@inlined
def _flow_of_wave(k, chi, q, torques, flow):
    """Write velocity, and with torques angular velocity, of the wave of forces and torques `q`."""
    k2 = k[0] * k[0] + k[1] * k[1] + k[2] * k[2]
    inverse = 1.0 / k2 if k2 > 0.0 else 0.0
    along = (k[0] * q[0] + k[1] * q[1] + k[2] * q[2]) * inverse
    for d in range(3):
        flow[d] = 2.0 * chi * (q[d] - k[d] * along)
    if torques:
        spin = k[0] * q[3] + k[1] * q[4] + k[2] * q[5]
        for d in range(3):
            a, b = (d + 1) % 3, (d + 2) % 3
            flow[d] += 1j * chi * (k[a] * q[3 + b] - k[b] * q[3 + a])
            flow[3 + d] = 1j * chi * (k[a] * q[b] - k[b] * q[a])
            flow[3 + d] += 0.5 * chi * (k2 * q[3 + d] - k[d] * spin)
