"""Translations between cubes of one size, compressed, from evaluations of the kernel alone.

In a cube [-1, 1]^3 sources and values are expanded in products of Legendre polynomials, scaled to
be orthonormal. For cubes t cells apart the kernel is then the matrix

    K_t[(i, k), (j, l)] = int int p_k(x) K_ij(h (2 t + x - y)) p_l(y) dx dy,

the best approximation in the mean square. Four things make it cheap:

* Few combinations of polynomials matter: of all translations together the leading
  singular vectors, U on the side of the targets and V on that of the sources, U^T K_t V = C_t.
* Under a reflection a component of the kernel keeps its value or changes its sign. Every
  combination is even or odd in each direction, which makes eight classes. Sums over the 2, 4 or 8
  cubes that are mirror images of t then need 1/2, 1/4 or 1/8 of the products (`loops.combine`).
* The classes are sorted by weight, and the further apart two cubes are the fewer are used.
* Under a permutation of the axes components change places: C_t follows from another one.

Channels of different units (forces and torques) are brought to one size before: with lengths in
micrometres errors were 25 times the tolerance.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from treecode.kernels.base import Kernel
from treecode.methods.fmm.bases import (
    GROUP,
    Side,
    choose_degree,
    class_of,
    common_rank,
    make_side,
    permutations,
)
from treecode.methods.fmm.legendre import fill_evenly, polynomials
from treecode.methods.fmm.level import CLASSES, OFFSETS, PARITY, Level, meeting
from treecode.methods.fmm.symmetry import find_symmetry, find_units, tabulate

# Shares of the tolerance for degree, rank, and truncation of far translations, in squares.
_SHARES = 0.3, 0.4, 0.3
# Equations for each unknown in fits. With 1.25 the error was 1.2 to 1.3 times as large, with 2 at
# 1e-8 0.65 times as large.
_OVERSAMPLING = 1.5
_FAR = 4.0  # half sides, a distance at which channels are brought to one size


def build_level(kernel: Kernel, half: float, tol: float, degree: int | None, dtype: type) -> Level:
    """Build the operators for cubes with sides ``2 * half``.

    Parameters
    ----------
    kernel : Kernel
    half : float
    tol : float
        Relative error in the mean square.
    degree : int, optional
        Polynomials in each direction; as many as the tolerance asks for by default.
    dtype : type
        float32 or float64.
    """
    symmetry = find_symmetry(kernel, half)
    units = find_units(kernel, _FAR * half)
    factors = np.outer(units.values, units.sources)
    tol *= units.evenness

    def inward(points: np.ndarray) -> np.ndarray:
        return tabulate(kernel, points) * factors

    def outward(points: np.ndarray) -> np.ndarray:
        return inward(-points).transpose(0, 2, 1)

    shares = [share * tol**2 for share in _SHARES]
    degree = degree or choose_degree(inward, symmetry.values, half, shares[0] / 2)
    values = make_side(inward, symmetry.values, half, degree, shares[1] / 2)
    sources = values
    if not symmetry.adjoint:
        sources = make_side(outward, symmetry.sources, half, degree, shares[1] / 2)
    rank = max(common_rank(side.modes, shares[1] / 2) for side in (values, sources))
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


def _octant(basis: tuple[np.ndarray, ...], side: Side) -> _Octant:
    """Place points, denser towards the faces as least squares ask for, and factorise."""
    degree, signs = side.degree, side.channels.parity
    channels, rank = signs.shape[1], basis[0].shape[1]
    count = math.ceil(_OVERSAMPLING * rank / channels) + 4
    angle = 0.5 * np.pi * fill_evenly(3, count)
    points = np.cos(angle)
    weight = np.sqrt(np.sin(angle).prod(axis=0))
    x, y, z = (polynomials(axis, degree) for axis in points)
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
    values = (PARITY @ values.reshape(CLASSES, -1)).reshape(CLASSES * n, CLASSES, -1)
    values = (PARITY @ values).reshape(CLASSES, n, CLASSES, other, rows, columns)
    rank = len(inside.fit[0])
    blocks = np.zeros((CLASSES, CLASSES, rank, rank))
    for p in range(CLASSES):
        for q in meeting(p, offset):
            block = values[p, :, q].transpose(0, 2, 1, 3).reshape(n * rows, other * columns)
            blocks[p, q] = inside.fit[p] @ block @ outside.fit[q].T
    return blocks


class _End(NamedTuple):
    """One end of the translations: a side, its basis, and what they become there.

    Attributes
    ----------
    side : Side
    basis : tuple of 8 (members, rank) arrays
    octant : _Octant
    rotations : list
        See `_rotations`.
    """

    side: Side
    basis: tuple[np.ndarray, ...]
    octant: _Octant
    rotations: list[tuple[np.ndarray, np.ndarray]]


def _make_end(side: Side, rank: int) -> _End:
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


def _rotations(side: Side, basis: tuple[np.ndarray, ...]) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return for each permutation of axes the class that each is made from, and how, (8, m, m)."""
    embedded = np.zeros((CLASSES, sum(map(len, side.members)), basis[0].shape[1]))
    classes = class_of(side.members)
    for c in range(CLASSES):
        embedded[c, side.members[c]] = basis[c]
    out = []
    for places, signs in permutations(side.channels, side.degree):
        origins = np.array([classes[places[own]].max(initial=0) for own in side.members])
        moved = [
            functions.T @ (signs[own, None] * embedded[c, places[own]])
            for functions, own, c in zip(basis, side.members, origins, strict=True)
        ]
        out.append((origins, np.stack(moved)))
    return out


def _used(blocks: np.ndarray, budget: float) -> int:
    """Return how many functions of each class matter across one offset."""
    # Leading functions inside, and those left out of them, by sums over squares from the end.
    square = (blocks**2).sum(axis=(0, 1))
    shells = np.tril(square).sum(axis=1) + np.triu(square, 1).sum(axis=0)
    left_out = np.append(shells[::-1].cumsum()[::-1], 0.0)
    count = int(np.argmax(left_out <= budget))
    return min(len(square), -(-max(count, 1) // GROUP) * GROUP)
