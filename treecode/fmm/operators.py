"""Translations between cubes of one size, compressed, from evaluations of the kernel alone.

In a cube [-1, 1]^3 sources and values are expanded in products of Legendre polynomials, scaled to
be orthonormal. For cubes t cells apart the kernel is then the matrix

    K_t[(i, k), (j, l)] = int int p_k(x) K_ij(h (2 t + x - y)) p_l(y) dx dy,

the best approximation in the mean square. Four things make it cheap:

* Few combinations of polynomials matter: of all translations together the leading
  singular vectors, U on the side of the targets and V on that of the sources, U^T K_t V = C_t.
* Under a reflection a component of the kernel keeps its value or changes its sign. Every
  combination is even or odd in each direction, which makes eight classes. Sums over the 2, 4 or 8
  cubes that are mirror images of t then need 1/2, 1/4 or 1/8 of the products (`passes.combine`).
* The classes are sorted by weight, and the further apart two cubes are the fewer are used.
* Under a permutation of the axes components change places: C_t follows from another one.

Channels of different units (forces and torques) are brought to one size before: with lengths in
micrometres errors were 25 times the tolerance.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial import legendre

from treecode.fmm.symmetry import Channels, find_symmetry, find_units, tabulate
from treecode.kernels.base import Kernel

CLASSES = 8
# Every translation up to reflections.
OFFSETS = [t for t in itertools.product(range(4), repeat=3) if max(t) > 1]
MAX_DEGREE = 30
# Sign of a function of a class at an image, in (class, image) order.
_PARITY = np.array([[(-1.0) ** bin(p & q).count("1") for q in range(8)] for p in range(8)])
_GROUP = 8  # functions of a class come in groups, which are vectors in `passes`

# Shares of the tolerance for degree, rank, and truncation of far translations, in squares.
_SHARES = 0.3, 0.4, 0.3
# Points for each degree squared, images among them: several times as many fields as functions kept,
# which are in proportion. With 64 for each degree the error ended at 3e-12.
_SAMPLES = 6
# Equations for each unknown in fits. With 1.25 the error was 1.2 to 1.3 times as large, with 2 at
# 1e-8 0.65 times as large.
_OVERSAMPLING = 1.5
_FEW_SAMPLES = 4  # to choose a degree
_FAR = 4.0  # half sides, a distance at which channels are brought to one size
_AT_A_TIME = 64  # of these points, for memory
_FEW_MODES = 64  # singular vectors of a class that are looked for first


class Level(NamedTuple):
    """Operators for cubes of one size.

    Attributes
    ----------
    degree : int
        Polynomials in each direction.
    source_basis, value_basis : tuple of 8 (members, rank) float64 arrays
        For each class the combinations of Legendre coefficients that are kept.
    source_members, value_members : tuple of 8 int64 arrays
        The coefficients in each class, as flat indices of (channel, k1, k2, k3).
    source_scale, value_scale : (channels,) float64
        What brings channels to one size.
    matrices : (n,) float32 or float64
        C_t for each of `OFFSETS`, transposed: for each class of values the rows are the classes of
        sources that meet it. One behind the other,
    begin : (57,) int64
        from here on,
    used : (56,) int64
        with so many functions of each class.
    """

    degree: int
    source_basis: tuple[np.ndarray, ...]
    value_basis: tuple[np.ndarray, ...]
    source_members: tuple[np.ndarray, ...]
    value_members: tuple[np.ndarray, ...]
    source_scale: np.ndarray
    value_scale: np.ndarray
    matrices: np.ndarray
    begin: np.ndarray
    used: np.ndarray

    @property
    def rank(self) -> int:
        """Compressed functions in each class."""
        return int(self.source_basis[0].shape[1])

    def resized(self, factor: float, powers: np.ndarray) -> Level:
        """Return the operators for larger cubes, if the kernel has no length of its own.

        `powers` are those of `symmetry.scale_powers`.
        """
        return self._replace(source_scale=self.source_scale * factor**-powers)

    def source_bases(self, dtype: Any) -> list[np.ndarray]:
        """Return for each class the matrix from Legendre coefficients to compressed ones."""
        return self._scaled(self.source_basis, self.source_members, self.source_scale, dtype)

    def value_bases(self, dtype: Any) -> list[np.ndarray]:
        """Return for each class the matrix whose transpose goes back to Legendre coefficients."""
        return self._scaled(self.value_basis, self.value_members, self.value_scale, dtype)

    def _scaled(self, basis: Any, members: Any, scale: np.ndarray, dtype: Any) -> list[np.ndarray]:
        channel = (m // self.degree**3 for m in members)
        return [(b / scale[c, None]).astype(dtype) for b, c in zip(basis, channel, strict=True)]

    def nodes(self, half: float) -> np.ndarray:
        """Return Gauss points in a cube, (3, degree^3)."""
        x, _ = _gauss(self.degree)
        return half * _grid(x)

    def project(self, values: np.ndarray) -> np.ndarray:
        """Return Legendre coefficients of values at the nodes, both (boxes, channels, degree^3)."""
        return self._apply(_gauss(self.degree)[1], values)

    def spread(self, coefficients: np.ndarray) -> np.ndarray:
        """Return the weights of nodes that act as Legendre coefficients do."""
        return self._apply(_gauss(self.degree)[1].T, coefficients)

    def _apply(self, matrix: np.ndarray, values: np.ndarray) -> np.ndarray:
        cubes = values.reshape(-1, *3 * (self.degree,))
        return _along_axes(matrix, cubes).reshape(values.shape)


def _polynomials(x: np.ndarray, degree: int) -> np.ndarray:
    """Return the orthonormal Legendre polynomials at x, (degree, n)."""
    scale = np.sqrt(np.arange(degree) + 0.5)
    return np.asarray(legendre.legvander(x, degree - 1) * scale).T


@lru_cache(maxsize=2)
def _gauss(degree: int) -> tuple[np.ndarray, np.ndarray]:
    """Return Gauss points in [-1, 1] and weighted polynomials there, (degree, points)."""
    x, w = legendre.leggauss(degree)
    return x, _polynomials(x, degree) * w


def _grid(x: np.ndarray) -> np.ndarray:
    """Return the points of a cubic grid, (3, n^3)."""
    return np.stack(np.meshgrid(x, x, x, indexing="ij")).reshape(3, -1)


def _along_axes(matrix: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Apply a (m, n) matrix to the axes 1, 2 and 3 of an array, which go to its end."""
    for _ in range(3):
        values = np.tensordot(values, matrix, axes=(1, 1))
    return values


def _class_of(members: Sequence[np.ndarray]) -> np.ndarray:
    """Return the class of each coefficient."""
    out = np.empty(sum(map(len, members)), np.int64)
    for c, own in enumerate(members):
        out[own] = c
    return out


class _Side(NamedTuple):
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


def _permutations(channels: Channels, degree: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return where coefficients come from if the axes are permuted, and their signs."""
    index = np.arange(channels.becomes.shape[1] * degree**3).reshape(-1, degree, degree, degree)
    return [
        (index[becomes].transpose(0, *(1 + axes)).ravel(), np.repeat(signs, degree**3))
        for axes, becomes, signs in zip(*channels[1:], strict=True)
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
        What has brought the channels to one size.
    """
    spread = _evenly(4, samples).T
    # Many close by: they ask most, and with few there the error grew with the number of digits.
    distance = 3.0 + 4.0 * spread[:, :1] ** 2
    outside = 2.0 * spread[:, 1:] - 1.0
    outside *= distance / np.abs(outside).max(axis=1, keepdims=True)
    x, w = legendre.leggauss(degree + 2)
    project = _polynomials(x, degree) * w
    grid = _grid(x)[:, None]
    parts = []
    for some in np.array_split(np.arange(samples), -(-samples // _AT_A_TIME)):
        values = table(half * (grid - outside[some].T[:, :, None]).reshape(3, -1))
        values = values.reshape(len(some), len(x), len(x), len(x), *values.shape[1:])
        values = values * distance[some][:, :, None, None, None, None]
        # channel inside, k1, k2, k3, sample, channel outside
        values = _along_axes(project, values).transpose(1, 3, 4, 5, 0, 2)
        parts.append(values.reshape(values.shape[0], degree**3, -1))
    coefficients = np.concatenate(parts, axis=2)
    square = (coefficients**2).sum(axis=(1, 2))
    scale = 1.0 / np.sqrt(square[channels.becomes].mean(axis=0))
    return (coefficients * scale[:, None, None]).reshape(-1, coefficients.shape[2]), scale


def _evenly(dimensions: int, count: int) -> np.ndarray:
    """Return points that fill the unit cube evenly, (dimensions, count).

    A Kronecker sequence: multiples, modulo 1, of powers of 1/g, where g^(d + 1) = g + 1. Of random
    points least squares need 1.5 times as many to be as well conditioned.
    """
    g = np.roots([1.0, *[0.0] * (dimensions - 1), -1.0, -1.0]).real.max()
    return (0.5 + np.outer(g ** -np.arange(1.0, dimensions + 1), np.arange(1, count + 1))) % 1.0


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


def _octant(basis: tuple[np.ndarray, ...], side: _Side) -> _Octant:
    """Place points, denser towards the faces as least squares ask for, and factorise."""
    degree, signs = side.degree, side.channels.parity
    channels, rank = signs.shape[1], basis[0].shape[1]
    count = math.ceil(_OVERSAMPLING * rank / channels) + 4
    angle = 0.5 * np.pi * _evenly(3, count)
    points = np.cos(angle)
    weight = np.sqrt(np.sin(angle).prod(axis=0))
    x, y, z = (_polynomials(axis, degree) for axis in points)
    products = np.einsum("an,bn,cn->abcn", x, y, z).reshape(degree**3, count)
    fit = []
    for functions, coefficients in zip(basis, side.members, strict=True):
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


def _members(degree: int, parity: np.ndarray) -> list[np.ndarray]:
    """Return the coefficients of each class: odd in the directions of the bits set."""
    odd = _degrees(degree, parity.shape[1]) + np.repeat(parity < 0, degree**3, axis=1)
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
    symmetry = find_symmetry(kernel, half)
    units = find_units(kernel, _FAR * half)
    factors = np.outer(units.values, units.sources)
    tolerance *= units.evenness

    def inward(points: np.ndarray) -> np.ndarray:
        return tabulate(kernel, points) * factors

    def outward(points: np.ndarray) -> np.ndarray:
        return inward(-points).transpose(0, 2, 1)

    shares = [share * tolerance**2 for share in _SHARES]
    degree = degree or _choose_degree(inward, symmetry.values, half, shares[0] / 2)
    values = _side(inward, symmetry.values, half, degree, shares[1] / 2)
    sources = values
    if not symmetry.adjoint:
        sources = _side(outward, symmetry.sources, half, degree, shares[1] / 2)
    rank = max(_rank(side.modes, shares[1] / 2) for side in (values, sources))
    inside = _make_end(values, rank)
    outside = inside if symmetry.adjoint else _make_end(sources, rank)
    all_blocks = _all_blocks(inward, half, inside, outside)
    total = sum(_mirrors(t) * np.vdot(b, b) for t, b in zip(OFFSETS, all_blocks, strict=True))
    used: list[int] = []
    matrices: list[np.ndarray] = []
    for offset, blocks in zip(OFFSETS, all_blocks, strict=True):
        m = _used(blocks, shares[2] * total / (len(OFFSETS) * _mirrors(offset)))
        rows = [blocks[p, q, :m, :m].T for p in range(CLASSES) for q in meeting(p, offset)]
        matrices.append(np.stack(rows).astype(dtype).ravel())
        used.append(m)
    return Level(
        degree,
        outside.basis,
        inside.basis,
        tuple(sources.members),
        tuple(values.members),
        sources.scale * units.sources,
        values.scale * units.values,
        np.concatenate(matrices),
        np.append(0, np.cumsum([len(matrix) for matrix in matrices])),
        np.array(used),
    )


def _choose_degree(table: Callable, channels: Channels, half: float, budget: float) -> int:
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


def _side(table: Callable, channels: Channels, half: float, degree: int, budget: float) -> _Side:
    """Return the modes of one side, but for some that weigh far less than `budget` of all."""
    permutations = _permutations(channels, degree)
    samples = -(-_SAMPLES * degree**2 // len(permutations))
    fields, scale = _fields(table, channels, half, degree, samples)
    members = _members(degree, channels.parity)
    class_of = _class_of(members)
    negligible = 0.01 * budget * len(permutations) * np.vdot(fields, fields)
    modes: list[tuple[np.ndarray, np.ndarray]] = []
    for c in range(CLASSES):
        own = members[c]
        same = [(places[own], signs[own, None]) for places, signs in permutations]
        done = next((s for s in same if (class_of[s[0]] < c).any()), None)
        if done is None:
            images = np.concatenate([signs * fields[places] for places, signs in same], axis=1)
            modes.append(_modes(images, negligible))
        else:
            places, signs = done
            image = class_of[places[0]]
            vectors, weights = modes[image]
            modes.append((signs * vectors[np.searchsorted(members[image], places)], weights))
    return _Side(degree, channels, scale, members, modes)


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


def _rank(modes: list[tuple[np.ndarray, np.ndarray]], budget: float) -> int:
    """Return how many functions a class keeps if those left out weigh `budget` of all."""
    weights = np.zeros(max(len(values) for _, values in modes))
    for _, values in modes:
        weights[: len(values)] += values
    left_out = np.append(weights[::-1].cumsum()[::-1], 0.0)
    count = int(np.argmax(left_out <= budget * weights.sum()))
    return -(-max(count, 1) // _GROUP) * _GROUP


class _End(NamedTuple):
    """One end of the translations: a side, its basis, and what they become there.

    Attributes
    ----------
    side : _Side
    basis : tuple of 8 (members, rank) arrays
    octant : _Octant
    rotations : list
        See `_rotations`.
    """

    side: _Side
    basis: tuple[np.ndarray, ...]
    octant: _Octant
    rotations: list[tuple[np.ndarray, np.ndarray]]


def _make_end(side: _Side, rank: int) -> _End:
    basis = side.basis(rank)
    return _End(side, basis, _octant(basis, side), _rotations(side, basis))


def _all_blocks(
    table: Callable[[np.ndarray], np.ndarray],
    half: float,
    inside: _End,
    outside: _End,
) -> list[np.ndarray]:
    """Return C_t for each of `OFFSETS`, once from the kernel and then by permutations of axes."""
    axes = inside.side.channels.axes
    blocks: dict[tuple[int, ...], np.ndarray] = {}
    for offset in OFFSETS:
        for n, permutation in enumerate(axes):
            original = tuple(np.array(offset)[np.argsort(permutation)])
            if original in blocks:
                (rows, left), (columns, right) = inside.rotations[n], outside.rotations[n]
                moved = blocks[original][rows][:, columns]
                blocks[offset] = left[:, None] @ moved @ right.transpose(0, 2, 1)
                break
        else:
            scales = inside.side.scale, outside.side.scale
            blocks[offset] = _blocks(table, half, offset, inside.octant, outside.octant, *scales)
    return [blocks[offset] for offset in OFFSETS]


def _rotations(side: _Side, basis: tuple[np.ndarray, ...]) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return for each permutation of axes the class that each is made from, and how, (8, m, m)."""
    embedded = np.zeros((CLASSES, sum(map(len, side.members)), basis[0].shape[1]))
    class_of = _class_of(side.members)
    for c in range(CLASSES):
        embedded[c, side.members[c]] = basis[c]
    out = []
    for places, signs in _permutations(side.channels, side.degree):
        classes = np.array([class_of[places[own]].max(initial=0) for own in side.members])
        moved = [
            functions.T @ (signs[own, None] * embedded[c, places[own]])
            for functions, own, c in zip(basis, side.members, classes, strict=True)
        ]
        out.append((classes, np.stack(moved)))
    return out


def _used(blocks: np.ndarray, budget: float) -> int:
    """Return how many functions of each class matter across one offset."""
    # Leading functions inside, and those left out of them, by sums over squares from the end.
    square = (blocks**2).sum(axis=(0, 1))
    shells = np.tril(square).sum(axis=1) + np.triu(square, 1).sum(axis=0)
    left_out = np.append(shells[::-1].cumsum()[::-1], 0.0)
    count = int(np.argmax(left_out <= budget))
    return min(len(square), -(-max(count, 1) // _GROUP) * _GROUP)


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
    dtype = child.matrices.dtype
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
        full = np.moveaxis(_along_axes(shift, full), 1, -1)
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
