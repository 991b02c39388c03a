"""Which combinations of Legendre polynomials matter in a cube, as the fields of points tell."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.polynomial import legendre

from treecode.methods.fmm.legendre import along_axes, fill_evenly, grid, polynomials
from treecode.methods.fmm.level import CLASSES
from treecode.methods.fmm.symmetry import Channels

MAX_DEGREE = 30
GROUP = 8  # functions of a class come in groups, which are vectors in `loops`

# Points for each degree squared, images among them: several times as many fields as functions kept,
# which are in proportion. With 64 for each degree the error ended at 3e-12.
_SAMPLES = 6
_FEW_SAMPLES = 4  # to choose a degree
_AT_A_TIME = 64  # of these points, for memory
_FEW_MODES = 64  # singular vectors of a class that are looked for first


def class_of(members: Sequence[np.ndarray]) -> np.ndarray:
    """Return the class of each coefficient."""
    out = np.empty(sum(map(len, members)), np.int64)
    for c, own in enumerate(members):
        out[own] = c
    return out


class Side(NamedTuple):
    """Sources or values in a cube, as the far side of the kernel sees them.

    Attributes
    ----------
    degree : int
    channels : Channels
    scale : (channels,) float64
        What brings the channels to one size.
    members : list of 8 int64 arrays
        The coefficients in each class, as flat indices of (channel, k1, k2, k3).
    modes : list of 8 pairs
        Leading combinations of the coefficients of each class, (members, n), and how much of the
        fields is in each, in squares.
    """

    degree: int
    channels: Channels
    scale: np.ndarray
    members: list[np.ndarray]
    modes: list[tuple[np.ndarray, np.ndarray]]

    def basis(self, rank: int) -> tuple[np.ndarray, ...]:
        """Return the first `rank` combinations of each class, and zeros if there are fewer."""
        out = tuple(np.zeros((len(vectors), rank)) for vectors, _ in self.modes)
        for basis, (vectors, _) in zip(out, self.modes, strict=True):
            basis[:, : vectors.shape[1]] = vectors[:, :rank]
        return out


def permutations(channels: Channels, degree: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return where coefficients come from if the axes are permuted, and their signs."""
    index = np.arange(channels.becomes.shape[1] * degree**3).reshape(-1, degree, degree, degree)
    return [
        (index[becomes].transpose(0, *(1 + axes)).ravel(), np.repeat(signs, degree**3))
        for axes, becomes, signs in zip(
            channels.axes, channels.becomes, channels.signs, strict=True
        )
    ]


def _fields(
    table: Callable[[np.ndarray], np.ndarray],
    channels: Channels,
    half: float,
    degree: int,
    samples: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Place points where cubes interact with [-1, 1]^3 and expand their fields in it.

    The fields of the points with their axes permuted are these, permuted.

    Parameters
    ----------
    table : function
        Returns the kernel at points (3, n) as (n, channels in the cube, channels outside).
    channels : Channels
        In the cube.
    half : float
    degree, samples : int

    Returns
    -------
    coefficients : (channels * degree^3, fields) ndarray
    scale : (channels,) ndarray
        What has brought the channels to one size, where all of them count alike.
    """
    spread = fill_evenly(4, samples).T
    # Many close by: they ask most, and with few there the error grew with the number of digits.
    distance = 3.0 + 4.0 * spread[:, :1] ** 2
    outside = 2.0 * spread[:, 1:] - 1.0
    outside *= distance / np.abs(outside).max(axis=1, keepdims=True)
    x, w = legendre.leggauss(degree + 2)
    project = polynomials(x, degree) * w
    nodes = grid(x)[:, None]
    parts = []
    for some in np.array_split(np.arange(samples), -(-samples // _AT_A_TIME)):
        values = table(half * (nodes - outside[some].T[:, :, None]).reshape(3, -1))
        values = values.reshape(len(some), len(x), len(x), len(x), *values.shape[1:])
        values = values * distance[some][:, :, None, None, None, None]
        # channel inside, k1, k2, k3, sample, channel outside
        values = along_axes(project, values).transpose(1, 3, 4, 5, 0, 2)
        parts.append(values.reshape(values.shape[0], degree**3, -1))
    coefficients = np.concatenate(parts, axis=2)
    square = (coefficients**2).sum(axis=(1, 2))
    scale = np.ones(len(square))
    if channels.alike:
        scale = 1.0 / np.sqrt(square[channels.becomes].mean(axis=0))
    return (coefficients * scale[:, None, None]).reshape(-1, coefficients.shape[2]), scale


def _degrees(degree: int, channels: int) -> np.ndarray:
    """Return the degrees (k1, k2, k3) of each coefficient, (3, channels * degree^3)."""
    k = np.indices((degree,) * 3).reshape(3, -1)
    return np.tile(k, channels)


def _members(degree: int, parity: np.ndarray) -> list[np.ndarray]:
    """Return the coefficients of each class: odd in the directions of the bits set."""
    odd = _degrees(degree, parity.shape[1]) + np.repeat(parity < 0, degree**3, axis=1)
    classes = (odd % 2 * np.array([[1], [2], [4]])).sum(axis=0)
    return [np.flatnonzero(classes == c) for c in range(CLASSES)]


def choose_degree(table: Callable, channels: Channels, half: float, budget: float) -> int:
    """Return the smallest degree that leaves out no more than `budget` of the squares."""
    for degree in range(8, MAX_DEGREE + 1, 4):
        fields, _ = _fields(table, channels, half, degree, _FEW_SAMPLES * degree)
        square = (fields**2).sum(axis=1)
        shells = np.bincount(_degrees(degree, len(fields) // degree**3).max(axis=0), square)
        left_out = shells[::-1].cumsum()[::-1] / shells.sum()
        enough = np.flatnonzero(left_out <= budget)
        if len(enough) and enough[0] < degree - 1:
            return int(enough[0])
    return MAX_DEGREE


def make_side(table: Callable, channels: Channels, half: float, degree: int, budget: float) -> Side:
    """Return the modes of one side, but for some that weigh far less than `budget` of all."""
    moves = permutations(channels, degree)
    # Parts of one flow are not independent: three channels would have as many functions.
    some = 1.0 if channels.alike else 3.0 / channels.parity.shape[1]
    samples = math.ceil(some * _SAMPLES * degree**2 / len(moves))
    fields, scale = _fields(table, channels, half, degree, samples)
    members = _members(degree, channels.parity)
    classes = class_of(members)
    negligible = 0.01 * budget * len(moves) * np.vdot(fields, fields)
    modes: list[tuple[np.ndarray, np.ndarray]] = []
    for c in range(CLASSES):
        own = members[c]
        same = [(places[own], signs[own, None]) for places, signs in moves]
        image_of = next((s for s in same if (classes[s[0]] < c).any()), None)
        if image_of is None:
            images = np.concatenate([signs * fields[places] for places, signs in same], axis=1)
            modes.append(_modes(images, negligible))
        else:
            places, signs = image_of
            image = classes[places[0]]
            vectors, weights = modes[image]
            modes.append((signs * vectors[np.searchsorted(members[image], places)], weights))
    return Side(degree, channels, scale, members, modes)


def _modes(fields: np.ndarray, negligible: float) -> tuple[np.ndarray, np.ndarray]:
    """Return left singular vectors and the squares of the singular values.

    First of random mixtures of the fields, twice as many each time until what
    they leave out is negligible.
    """
    rng = np.random.default_rng(0)
    count = _FEW_MODES
    while 2 * count < min(fields.shape):
        mixtures = fields @ rng.standard_normal((fields.shape[1], count))
        span, _ = np.linalg.qr(mixtures)
        vectors, squares = _singular(span.T @ fields)
        if squares[-1] * len(fields) <= negligible:
            return span @ vectors, squares
        count *= 2
    return _singular(fields)


def _singular(fields: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    # Not the eigenvectors of fields @ fields.T, where what is below 1e-8 of the largest is lost.
    vectors, values, _ = np.linalg.svd(np.transpose(np.linalg.qr(fields.T, mode="r")))
    return vectors, values**2


def common_rank(modes: list[tuple[np.ndarray, np.ndarray]], budget: float) -> int:
    """Return how many functions a class keeps if those left out weigh `budget` of all."""
    weights = np.zeros(max(len(values) for _, values in modes))
    for _, values in modes:
        weights[: len(values)] += values
    left_out = np.append(weights[::-1].cumsum()[::-1], 0.0)
    count = int(np.argmax(left_out <= budget * weights.sum()))
    return -(-max(count, 1) // GROUP) * GROUP
