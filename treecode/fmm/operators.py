"""Translations between cubes of one size, compressed, from evaluations of the kernel alone.

In a cube [-1, 1]^3 sources and values are expanded in products of Legendre polynomials, scaled to
be orthonormal. For cubes t cells apart the kernel is then the matrix

    K_t[(i, k), (j, l)] = int int p_k(x) K_ij(h (2 t + x - y)) p_l(y) dx dy,

the best approximation in the mean square. Three things make it cheap:

* Few combinations of polynomials matter: of all translations together the leading
  singular vectors, U on the side of the targets and V on that of the sources, U^T K_t V = C_t.
* Under a reflection a component of the kernel keeps its value or changes its sign. Every
  combination is even or odd in each direction, which makes eight classes. Sums over the 2, 4 or 8
  cubes that are mirror images of t then need 1/2, 1/4 or 1/8 of the products (`passes.combine`).
* The classes are sorted by weight, and the further apart two cubes are the fewer are used.

Channels of different units (forces and torques) are brought to one size before.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial import legendre

from treecode._jit import serial_driver
from treecode.kernels.base import Kernel
from treecode.pairs import accumulate

CLASSES = 8
# Every translation up to reflections.
OFFSETS = [t for t in itertools.product(range(4), repeat=3) if max(t) > 1]
MAX_DEGREE = 30
# Sign of a function of a class at an image, in (class, image) order.
_PARITY = np.array([[(-1.0) ** bin(p & q).count("1") for q in range(8)] for p in range(8)])
_GROUP = 4  # functions of a class come in groups: whole vectors, and few different shapes

# Shares of the tolerance for degree, rank, and truncation of far translations, in squares.
_SHARES = 0.3, 0.4, 0.3
_SAMPLES = 64  # points drawn for each degree: several times as many fields as functions kept
_OVERSAMPLING = 2  # equations for each unknown in fits
_FEW_SAMPLES = 8  # to choose a degree


class Level(NamedTuple):
    """Operators for cubes of one size.

    Attributes
    ----------
    degree : int
        Polynomials in each direction.
    sources, values : tuple of 8 (3 + degree^3 ...) arrays
        For each class the matrix from Legendre coefficients to compressed ones.
    source_members, value_members : tuple of 8 int64 arrays
        The coefficients in each class, as flat indices of (channel, k1, k2, k3).
    source_scale, value_scale : (channels,) float64
        What brings channels to one size.
    translations : tuple of 56 (8, n, m) arrays
        C_t for each of `OFFSETS`, transposed: for each class of values the rows are the classes of
        sources that meet it, m functions of each.
    """

    degree: int
    source_basis: tuple[np.ndarray, ...]
    value_basis: tuple[np.ndarray, ...]
    source_members: tuple[np.ndarray, ...]
    value_members: tuple[np.ndarray, ...]
    source_scale: np.ndarray
    value_scale: np.ndarray
    translations: tuple[np.ndarray, ...]

    @property
    def rank(self) -> int:
        """Compressed functions in each class."""
        return int(self.source_basis[0].shape[1])

    def source_bases(self, dtype: Any) -> list[np.ndarray]:
        """Return for each class the matrix from Legendre coefficients to compressed ones."""
        return self._scaled(self.source_basis, self.source_members, self.source_scale, dtype)

    def value_bases(self, dtype: Any) -> list[np.ndarray]:
        """Return for each class the matrix whose transpose goes back to Legendre coefficients."""
        return self._scaled(self.value_basis, self.value_members, self.value_scale, dtype)

    def _scaled(self, basis: Any, members: Any, scale: np.ndarray, dtype: Any) -> list[np.ndarray]:
        channel = (m // self.degree**3 for m in members)
        return [(b / scale[c, None]).astype(dtype) for b, c in zip(basis, channel, strict=True)]

    def nodes(self, half: float) -> tuple[np.ndarray, np.ndarray]:
        """Return Gauss points, (3, degree^3), and weighted polynomials there, (points, products).

        Values at the points times the second are Legendre coefficients; the second times
        coefficients are weights of points that act as they do.
        """
        points, project = _gauss(self.degree)
        return half * points, project


class Reflections(NamedTuple):
    """Signs with which the channels of a kernel answer to a reflection, (3, channels) of +-1."""

    values: np.ndarray
    sources: np.ndarray


def tabulate(kernel: Kernel, points: np.ndarray) -> np.ndarray:
    """Return K(r), (n, value_size, weight_size), at points r, (3, n)."""
    n, columns = points.shape[1], kernel.weight_size
    padded = np.zeros((3, n + 64))
    padded[:, :n] = points
    out = np.zeros((columns, kernel.value_size, n))
    _tabulate(kernel, padded, np.zeros((3, 1)), np.eye(columns), out)
    return out.transpose(2, 1, 0)


@serial_driver
def _tabulate(kernel, points, origin, units, out):
    for c in range(out.shape[0]):
        accumulate(
            kernel, points, 0, out.shape[2], origin, units[:, c : c + 1].copy(), 0, 1, out[c]
        )


def reflections(kernel: Kernel, half: float) -> Reflections:
    """Find how a kernel behaves under reflections.

    Beside the size of the cubes larger ones are looked at: where the kernel hardly varies, what
    couples its channels is lost, and with it the sign of one relative to another.

    Raises
    ------
    ValueError
        If a reflection does more than change signs of components.
    """
    points = np.random.default_rng(0).uniform(1.0, 2.0, (3, 16))
    lengths = half * 2.0 ** np.arange(0.0, 60.0, 4.0)

    def sample(mirror: np.ndarray) -> np.ndarray:
        tables = (tabulate(kernel, length * points * mirror[:, None]) for length in lengths)
        return np.concatenate([table / np.abs(table).max() for table in tables])

    table = sample(np.ones(3))
    values, sources = np.ones((3, table.shape[1])), np.ones((3, table.shape[2]))
    size = np.abs(table).max(axis=0)
    for d in range(3):
        mirrored = sample(np.where(np.arange(3) == d, -1.0, 1.0))
        sign = np.sign((table * mirrored).sum(axis=0)) * (size > 1e-9)
        _split_signs(sign, values[d], sources[d])
        if np.abs(mirrored - np.outer(values[d], sources[d]) * table).max() > 1e-9:
            raise ValueError(
                "backend must be 'kitc' or 'direct' for a kernel that is not isotropic: "
                f"'fmm' needs components that a reflection leaves alone or negates, got {kernel!r}"
            )
    return Reflections(values, sources)


def _split_signs(sign: np.ndarray, values: np.ndarray, sources: np.ndarray) -> None:
    """Write sign[i, j] = values[i] sources[j] where it is not zero."""
    known_values, known_sources = np.zeros(len(values), bool), np.zeros(len(sources), bool)
    while not known_values.all():
        known_values[np.argmin(known_values)] = True  # of parts that do not meet each is free
        for _ in range(len(values) + len(sources)):
            for i, j in np.argwhere(sign):
                if known_values[i] and not known_sources[j]:
                    sources[j], known_sources[j] = sign[i, j] * values[i], True
                elif known_sources[j] and not known_values[i]:
                    values[i], known_values[i] = sign[i, j] * sources[j], True


def _polynomials(x: np.ndarray, degree: int) -> np.ndarray:
    """Return the orthonormal Legendre polynomials at x, (degree, n)."""
    scale = np.sqrt(np.arange(degree) + 0.5)
    return np.asarray(legendre.legvander(x, degree - 1) * scale).T


@lru_cache(maxsize=2)
def _gauss(degree: int) -> tuple[np.ndarray, np.ndarray]:
    """Return Gauss points in [-1, 1]^3 and weighted polynomials there; see `Level.nodes`."""
    x, w = legendre.leggauss(degree)
    points = np.stack(np.meshgrid(x, x, x, indexing="ij")).reshape(3, -1)
    p = (_polynomials(x, degree) * w).T
    return points, np.einsum("ai,bj,ck->abcijk", p, p, p).reshape(len(x) ** 3, -1)


class _Fields(NamedTuple):
    """What single sources far away do in a cube, or single targets far away feel of it.

    Attributes
    ----------
    coefficients : (channels * degree^3, samples) float64
    scale : (channels,) float64
        What has brought the channels to one size.
    """

    coefficients: np.ndarray
    scale: np.ndarray


def _fields(
    table: Callable[[np.ndarray], np.ndarray], half: float, degree: int, samples: int = _SAMPLES
) -> _Fields:
    """Draw points where cubes interact with [-1, 1]^3 and expand their fields in it.

    `table` returns the kernel at points (3, n) as (n, channels in the cube, channels outside).
    """
    rng = np.random.default_rng(0)
    # As many at every distance: those nearby ask most. The weight makes up for their number.
    distance = rng.uniform(3.0, 7.0, (samples * degree, 1))
    outside = rng.uniform(-1.0, 1.0, (samples * degree, 3))
    outside *= distance / np.abs(outside).max(axis=1, keepdims=True)
    x, w = legendre.leggauss(degree + 2)
    project = _polynomials(x, degree) * w
    grid = np.stack(np.meshgrid(x, x, x, indexing="ij")).reshape(3, 1, -1)
    values = table(half * (grid - outside.T[:, :, None]).reshape(3, -1))
    values = values.reshape(len(outside), len(x), len(x), len(x), *values.shape[1:])
    values = values * distance[:, :, None, None, None, None]
    for _ in range(3):  # each takes the first axis of the cube to the end
        values = np.tensordot(values, project, axes=(1, 1))
    # sample, channel inside, channel outside, k1, k2, k3
    values = np.moveaxis(values, (0, 2), (-2, -1))
    values = values.reshape(values.shape[0], degree**3, -1)
    scale = 1.0 / np.sqrt((values**2).sum(axis=(1, 2)))
    return _Fields((values * scale[:, None, None]).reshape(-1, values.shape[2]), scale)


class _Octant(NamedTuple):
    """Points in the upper octant of a cube, where functions of known parity are sampled.

    Attributes
    ----------
    images : (3, 8, n) float64
        The points and their mirror images; bit d of the second index mirrors direction d.
    fit : tuple of 8 (m, n * channels) arrays
        For each class: from values at the points to coefficients of the basis, by least squares.
    signs : (8, channels) float64
        Sign of each channel at an image, over the number of images.
    """

    images: np.ndarray
    fit: tuple[np.ndarray, ...]
    signs: np.ndarray


def _octant(
    basis: list[np.ndarray], members: list[np.ndarray], degree: int, signs: np.ndarray, seed: int
) -> _Octant:
    """Draw points, denser towards the faces as least squares ask for, and factorise."""
    channels, rank = signs.shape[1], basis[0].shape[1]
    count = -(-_OVERSAMPLING * rank // channels) + 4
    angle = 0.5 * np.pi * np.random.default_rng(seed).random((3, count))
    points = np.cos(angle)
    weight = np.sqrt(np.sin(angle).prod(axis=0))
    x, y, z = (_polynomials(axis, degree) for axis in points)
    products = np.einsum("an,bn,cn->abcn", x, y, z).reshape(degree**3, count)
    fit = []
    for functions, coefficients in zip(basis, members, strict=True):
        full = np.zeros((channels * degree**3, rank))
        full[coefficients] = functions
        full = full.reshape(channels, degree**3, rank)
        table = np.einsum("kn,ckm->ncm", products, full, optimize=True) * weight[:, None, None]
        fit.append(
            np.linalg.pinv(table.reshape(count * channels, rank)) * np.repeat(weight, channels)
        )
    image = np.arange(CLASSES)
    flips = (-1.0) ** (image >> np.arange(3)[:, None] & 1)  # direction, image
    flipped = (flips[:, :, None] < 0) & (signs[:, None, :] < 0)
    return _Octant(
        points[:, None, :] * flips[:, :, None],
        tuple(fit),
        np.where(flipped, -1.0, 1.0).prod(axis=0) / CLASSES,
    )


def _mirrors(offset: tuple[int, ...]) -> float:
    """Return how many translations of a cube inside an octree this offset stands for."""
    return float(np.prod([1.0 if c in (0, 3) else 2.0 for c in offset]))


def _degrees(degree: int, channels: int) -> np.ndarray:
    """Return the degrees (k1, k2, k3) of each coefficient, (3, channels * degree^3)."""
    k = np.indices((degree,) * 3).reshape(3, -1)
    return np.tile(k, channels)


def _members(degree: int, signs: np.ndarray) -> list[np.ndarray]:
    """Return the coefficients of each class: odd in the directions of the bits set."""
    odd = _degrees(degree, signs.shape[1]) + np.repeat(signs < 0, degree**3, axis=1)
    classes = (odd % 2 * np.array([[1], [2], [4]])).sum(axis=0)
    return [np.flatnonzero(classes == c) for c in range(CLASSES)]


def _blocks(
    table: Callable[[np.ndarray], np.ndarray],
    half: float,
    offset: tuple[int, ...],
    inside: _Octant,
    outside: _Octant,
    value_scale: np.ndarray,
    source_scale: np.ndarray,
) -> np.ndarray:
    """Return C_t by class of values and of sources, (8, 8, m, m)."""
    shift = 2.0 * np.array(offset)[:, None, None, None, None]
    x, y = inside.images[:, :, :, None, None], outside.images[:, None, None]
    points = half * (shift + x - y)
    _, _, n, _, other = points.shape
    rows, columns = len(value_scale), len(source_scale)
    values = table(points.reshape(3, -1)).reshape(CLASSES, n, CLASSES, other, rows, columns)
    signs = inside.signs[:, None, None, None, :, None] * outside.signs[None, None, :, None, None]
    values = values * (signs * value_scale[:, None] * source_scale)
    # Classes in place of images: sums and differences, both sides.
    values = (_PARITY @ values.reshape(CLASSES, -1)).reshape(CLASSES * n, CLASSES, -1)
    values = (_PARITY @ values).reshape(CLASSES, n, CLASSES, other, rows, columns)
    rank = len(inside.fit[0])
    blocks = np.zeros((CLASSES, CLASSES, rank, rank))
    for p in range(CLASSES):
        for q in meeting(p, offset):
            block = values[p, :, q].transpose(0, 2, 1, 3).reshape(n * rows, other * columns)
            blocks[p, q] = inside.fit[p] @ block @ outside.fit[q].T
    return blocks


def meeting(p: int, offset: tuple[int, ...]) -> list[int]:
    """Return the classes of sources that act on class `p` across an offset."""
    fixed = sum(1 << d for d in range(3) if offset[d] == 0)
    return [q for q in range(CLASSES) if (p ^ q) & fixed == 0]


def build_level(
    kernel: Kernel, half: float, tolerance: float, degree: int | None, dtype: type
) -> Level:
    """Build the operators for cubes with sides ``2 * half``.

    Parameters
    ----------
    kernel : Kernel
    half : float
    tolerance : float
        Relative error in the mean square.
    degree : int, optional
        Polynomials in each direction; as many as the tolerance asks for by default.
    dtype : type
        float32 or float64.
    """
    signs = reflections(kernel, half)

    def inward(points: np.ndarray) -> np.ndarray:
        return tabulate(kernel, points)

    def outward(points: np.ndarray) -> np.ndarray:
        return tabulate(kernel, -points).transpose(0, 2, 1)

    degree = degree or _choose_degree(inward, half, tolerance)
    shares = [share * tolerance**2 for share in _SHARES]
    values, sources = (_fields(table, half, degree) for table in (inward, outward))
    value_members = _members(degree, signs.values)
    source_members = _members(degree, signs.sources)
    value_modes = [_modes(values.coefficients[m]) for m in value_members]
    source_modes = [_modes(sources.coefficients[m]) for m in source_members]
    rank = max(_rank(modes, shares[1] / 2) for modes in (value_modes, source_modes))
    value_basis = [_leading(vectors, rank) for vectors, _ in value_modes]
    source_basis = [_leading(vectors, rank) for vectors, _ in source_modes]
    inside = _octant(value_basis, value_members, degree, signs.values, 1)
    outside = _octant(source_basis, source_members, degree, signs.sources, 2)
    all_blocks = [
        _blocks(inward, half, offset, inside, outside, values.scale, sources.scale)
        for offset in OFFSETS
    ]
    total = sum(_mirrors(t) * np.vdot(b, b) for t, b in zip(OFFSETS, all_blocks, strict=True))
    translations: list[np.ndarray] = []
    for offset, blocks in zip(OFFSETS, all_blocks, strict=True):
        used = _used(blocks, shares[2] * total / (len(OFFSETS) * _mirrors(offset)))
        rows = [
            np.concatenate([blocks[p, q, :used, :used].T for q in meeting(p, offset)])
            for p in range(CLASSES)
        ]
        translations.append(np.stack(rows).astype(dtype))
    return Level(
        degree,
        tuple(source_basis),
        tuple(value_basis),
        tuple(source_members),
        tuple(value_members),
        sources.scale,
        values.scale,
        tuple(translations),
    )


def _choose_degree(table: Callable, half: float, tolerance: float) -> int:
    """Return the smallest degree that leaves out its share of the tolerance."""
    for degree in range(8, MAX_DEGREE + 1, 4):
        square = _fields(table, half, degree, _FEW_SAMPLES).coefficients ** 2
        channels = len(square) // degree**3
        shells = np.bincount(_degrees(degree, channels).max(axis=0), square.sum(axis=1))
        left_out = shells[::-1].cumsum()[::-1] / shells.sum()
        enough = np.flatnonzero(left_out <= 0.5 * _SHARES[0] * tolerance**2)
        if len(enough) and enough[0] < degree - 1:
            return int(enough[0])
    return MAX_DEGREE


def _modes(fields: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the left singular vectors and the squares of the singular values."""
    # Not the eigenvectors of fields @ fields.T, where what is below 1e-8 of the largest is lost.
    vectors, values, _ = np.linalg.svd(np.transpose(np.linalg.qr(fields.T, mode="r")))
    return vectors, values**2


def _rank(modes: list[tuple[np.ndarray, np.ndarray]], budget: float) -> int:
    """Return how many functions a class keeps if those left out weigh `budget` of all."""
    weights = np.zeros(max(len(values) for _, values in modes))
    for _, values in modes:
        weights[: len(values)] += values
    left_out = np.append(weights[::-1].cumsum()[::-1], 0.0)
    count = int(np.argmax(left_out <= budget * weights.sum()))
    return -(-max(count, 1) // _GROUP) * _GROUP


def _leading(vectors: np.ndarray, rank: int) -> np.ndarray:
    """Return the first `rank` columns, and zeros if there are fewer."""
    basis = np.zeros((len(vectors), rank))
    basis[:, : vectors.shape[1]] = vectors[:, :rank]
    return basis


def _used(blocks: np.ndarray, budget: float) -> int:
    """Return how many functions of each class matter across one offset."""
    rank = blocks.shape[-1]
    square = (blocks**2).sum(axis=(0, 1))
    left_out = np.array([square.sum() - square[:n, :n].sum() for n in range(rank + 1)])
    count = int(np.argmax(left_out <= budget))
    return min(rank, -(-max(count, 1) // _GROUP) * _GROUP)


class Transfer(NamedTuple):
    """From cubes to their parents and back, for each octant.

    Attributes
    ----------
    up : (8, 8 * rank, 8 * parent's rank)
    down : (8, 8 * parent's rank, 8 * rank)
    """

    up: np.ndarray
    down: np.ndarray


def make_transfer(child: Level, parent: Level) -> Transfer:
    """Return the operators between a level and the one above."""
    dtype = child.translations[0].dtype
    up = _merge(
        (child.source_basis, child.source_members, child.source_scale, child.degree),
        (parent.source_basis, parent.source_members, parent.source_scale, parent.degree),
    )
    down = _merge(
        (child.value_basis, child.value_members, child.value_scale, child.degree),
        (parent.value_basis, parent.value_members, parent.value_scale, parent.degree),
    ).transpose(0, 2, 1)
    return Transfer(up.astype(dtype), np.ascontiguousarray(down.astype(dtype)))


def _merge(child: tuple, parent: tuple) -> np.ndarray:
    """Return compressed coefficients of a child to those of its parent, (8, 8 m, 8 m_parent)."""
    basis, members, scale, degree = child
    parent_basis, parent_members, parent_scale, parent_degree = parent
    shift = _shift_matrix(parent_degree, degree)
    ratio = (scale / parent_scale)[:, None, None, None, None]
    out = np.zeros((8, CLASSES, basis[0].shape[1], CLASSES, parent_basis[0].shape[1]))
    for q in range(CLASSES):
        full = np.zeros((len(scale) * degree**3, basis[q].shape[1]))
        full[members[q]] = basis[q]
        full = full.reshape(len(scale), degree, degree, degree, -1) * ratio
        for axis in (1, 2, 3):
            full = np.moveaxis(np.tensordot(shift, full, axes=(1, axis)), 0, axis)
        full = full.reshape(len(scale) * parent_degree**3, -1)
        for p in range(CLASSES):
            block = full[parent_members[p]].T @ parent_basis[p]
            # The upper half is the mirror image of the lower one.
            out[:, q, :, p] = _PARITY[p ^ q][:, None, None] * block
    return out.reshape(8, CLASSES * out.shape[2], CLASSES * out.shape[4])


def _shift_matrix(parent_degree: int, degree: int) -> np.ndarray:
    """Return S with p_k((x - 1) / 2) = sum_j S[k, j] p_j(x): a cube in its parent's lower half."""
    x, w = legendre.leggauss(max(degree, parent_degree))
    lower = _polynomials(0.5 * (x - 1.0), parent_degree)
    return (lower * w) @ _polynomials(x, degree).T
