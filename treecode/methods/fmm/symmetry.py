"""What reflections, permutations of the axes and units do to a kernel, found from its values."""

from __future__ import annotations

import itertools
from typing import Any, NamedTuple, NoReturn

import numpy as np

from treecode._jit import Driver
from treecode.kernels.base import Kernel
from treecode.pairs import accumulate

_SAME = 1e-9  # relative to the largest component at its distance
_POINTS = np.random.default_rng(0).uniform(1.0, 2.0, (3, 16))  # where kernels are looked at


class Channels(NamedTuple):
    """How the components of values, or of sources, answer to reflections and permutations.

    Attributes
    ----------
    parity : (3, channels) of +-1
        Sign under each reflection.
    axes : (permutations, 3) int64
        Permutations P, (P r)[d] = r[axes[d]], under which the components of the kernel change
        places and signs; the identity first.
    becomes : (permutations, channels) int64
        At P r a component is this one at r,
    signs : (permutations, channels) of +-1
        times this.
    alike : bool
        Whether errors of all channels count alike. If not, they count by the size of the channel.
    """

    parity: np.ndarray
    axes: np.ndarray
    becomes: np.ndarray
    signs: np.ndarray
    alike: bool


class Symmetry(NamedTuple):
    """The symmetries of a kernel K(r).

    Attributes
    ----------
    values, sources : Channels
    adjoint : bool
        Whether K(-r) is the transpose of K(r), so that sources and values are alike.
    """

    values: Channels
    sources: Channels
    adjoint: bool


def tabulate(kernel: Kernel, points: np.ndarray) -> np.ndarray:
    """Return K(r), (n, value_size, weight_size), at points r, (3, n)."""
    n, columns = points.shape[1], kernel.weight_size
    padded = np.zeros((3, n + 64))
    padded[:, :n] = points
    out = np.zeros((columns, kernel.value_size, n))
    _tabulate(kernel, padded, np.zeros((3, 1)), np.eye(columns), out)
    return out.transpose(2, 1, 0)


@Driver
def _tabulate(kernel, points, origin, units, out):
    for c in range(out.shape[0]):
        accumulate(
            kernel, points, 0, out.shape[2], origin, units[:, c : c + 1].copy(), 0, 1, out[c]
        )


def scale_powers(kernel: Kernel, lengths: list[float]) -> np.ndarray | None:
    """Return p with ``K(s r)[i, j] = s^p[j] K(r)[i, j]``; None if a kernel has a length of its own.

    Parameters
    ----------
    kernel : Kernel
    lengths : list of float
        At which this has to hold, as well as between 2^-200 and 2^200.
    """
    scale = np.append(2.0 ** np.arange(-200.0, 201.0, 20.0), lengths)
    one, two = tabulate(kernel, _POINTS), tabulate(kernel, 2.0 * _POINTS)
    with np.errstate(all="ignore"):  # what leaves the range of doubles is not the same
        powers = np.log2(np.linalg.norm(two, axis=(0, 1)) / np.linalg.norm(one, axis=(0, 1)))
        tables = np.array([tabulate(kernel, s * _POINTS) / s**powers for s in scale])
        same = np.abs(tables - one) <= _SAME * np.abs(one).max(axis=(0, 1))
    return powers if same.all() else None


class Units(NamedTuple):
    """What brings all channels to one size at a distance.

    Attributes
    ----------
    values, sources : (channels,) float64
        Components of the kernel are multiplied by both.
    evenness : float
        How small what one kind of source does to one kind of value is even then, beside the
        largest; a third counts as 1. Wide blobs hardly turn what they push.
    """

    values: np.ndarray
    sources: np.ndarray
    evenness: float


def _adds_to_flow(kernel: Any) -> bool:
    """Tell whether a kernel is a correction, whose values are small parts of a flow."""
    return bool(getattr(kernel, "adds_to_flow", False))


def find_units(kernel: Any, length: float) -> Units:
    """Find the units of a kernel at a distance.

    With lengths in micrometres a torque does a millionth of what a force does. Components that
    change places under permutations of the axes get the same unit.

    Of a kernel that `adds_to_flow`, a channel that does little may be far off: units are those of
    its dimensions alone.
    """
    if _adds_to_flow(kernel):
        values, sources = (
            length ** np.array(own, np.float64)
            for own in (kernel.value_lengths, kernel.weight_lengths)
        )
        return Units(values, sources, 1.0)
    images = [_POINTS[list(axes)] for axes in itertools.permutations(range(3))]
    sizes = np.abs(tabulate(kernel, length * np.concatenate(images, axis=1))).mean(axis=0)
    values, sources = np.ones(sizes.shape[0]), np.ones(sizes.shape[1])
    known = sizes > 0.0
    for _ in range(2):  # first with components that are zero but for rounding
        rows, columns = np.nonzero(known)
        either = np.hstack([np.eye(len(values))[rows], np.eye(len(sources))[columns]])
        logarithms, *_ = np.linalg.lstsq(either, -np.log(sizes[known]))
        values, sources = np.split(np.exp(logarithms), [len(values)])
        even = sizes * np.outer(values, sources)
        known &= even > _SAME
    largest: dict[tuple[float, float], float] = {}
    for i, j in zip(*np.nonzero(known), strict=True):  # by kinds: those of one unit
        kinds = float(f"{values[i]:.6g}"), float(f"{sources[j]:.6g}")
        largest[kinds] = max(largest.get(kinds, 0.0), float(even[i, j]))
    evenness = 3.0 * min(largest.values(), default=1.0) / max(largest.values(), default=1.0)
    return Units(values, sources, min(1.0, evenness))


def find_symmetry(kernel: Kernel, half: float) -> Symmetry:
    """Find how a kernel behaves under reflections and permutations of the axes.

    Beside the size of the cubes larger ones are looked at: where the kernel hardly varies, what
    couples its channels is lost, and with it the sign of one relative to another.

    Raises
    ------
    ValueError
        If a reflection does more than change signs of components, the kernel vanishes at a
        distance, or a weight does nothing or a value is always zero.
    """
    lengths = half * 2.0 ** np.arange(0.0, 60.0, 4.0)
    units = [np.outer(*find_units(kernel, length)[:2]) for length in lengths]

    def sample(moved: np.ndarray) -> np.ndarray:
        pairs = zip(lengths, units, strict=True)
        tables = [tabulate(kernel, length * moved) * unit for length, unit in pairs]
        if not all(table.any() for table in tables):
            _refuse(kernel, "that vanishes at a distance", "it compresses what is far")
        return np.concatenate([table / np.abs(table).max() for table in tables])

    table = sample(_POINTS)
    for axis, what in ((1, "value_size"), (2, "weight_size")):
        used = table.any(axis=tuple({0, 1, 2} - {axis}))
        if not used.all():
            which = f"number {int(np.argmin(used))} of its {what} is always without effect"
            _refuse(kernel, f"of which {which}", "leave it out")
    parity = [
        _reflected(kernel, table, sample(np.where(np.arange(3)[:, None] == d, -_POINTS, _POINTS)))
        for d in range(3)
    ]
    axes, moved = [], []
    for permutation in itertools.permutations(range(3)):
        found = _permuted(table, sample(_POINTS[list(permutation)]))
        if found is not None:
            axes.append(permutation)
            moved.append(found)
    values, sources = (
        Channels(
            np.array([signs[side] for signs in parity]),
            np.array(axes),
            np.array([becomes[side] for becomes, _ in moved]),
            np.array([signs[side] for _, signs in moved]),
            not _adds_to_flow(kernel),
        )
        for side in range(2)
    )
    adjoint = all(
        np.array_equal(*pair) for pair in zip(values[:4], sources[:4], strict=True)
    ) and bool(np.abs(sample(-_POINTS).transpose(0, 2, 1) - table).max() <= _SAME)
    return Symmetry(values, sources, adjoint)


def _reflected(
    kernel: Kernel, table: np.ndarray, mirrored: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the signs of values and sources that a reflection changes."""
    signs = _split_signs(table, mirrored)
    if np.abs(mirrored - np.outer(*signs) * table).max() > _SAME:
        _refuse(
            kernel,
            "that is not isotropic",
            "it needs components that a reflection leaves alone or negates",
        )
    return signs


def _refuse(kernel: Kernel, which: str, why: str) -> NoReturn:
    raise ValueError(
        f"backend must be 'kitc' or 'direct' for a kernel {which}, not 'fmm': {why}; got {kernel!r}"
    )


def _permuted(table: np.ndarray, moved: np.ndarray) -> tuple[tuple, tuple] | None:
    """Return which components change places, and their signs; None if they do more than that."""
    # Not before it is used: it brings half of scipy.
    from scipy.optimize import linear_sum_assignment

    # Components are known by their sizes, whatever the order of what they meet.
    becomes = []
    for axis in (1, 2):
        here, there = (np.sort(np.abs(np.swapaxes(t, 1, axis)), axis=2) for t in (moved, table))
        becomes.append(
            linear_sum_assignment(np.abs(here[:, :, None] - there[:, None]).max(axis=(0, 3)))[1]
        )
    original = table[:, becomes[0]][:, :, becomes[1]]
    signs = _split_signs(original, moved)
    if np.abs(moved - np.outer(*signs) * original).max() > _SAME:
        return None
    return tuple(becomes), signs


def _split_signs(table: np.ndarray, changed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return signs of values and sources whose products are those of changed / table."""
    sign = np.sign((table * changed).sum(axis=0)) * (np.abs(table).max(axis=0) > _SAME)
    values, sources = np.ones(sign.shape[0]), np.ones(sign.shape[1])
    known_values, known_sources = np.zeros(len(values), bool), np.zeros(len(sources), bool)
    while not known_values.all():
        known_values[np.argmin(known_values)] = True  # of parts that do not meet each is free
        for _ in range(len(values) + len(sources)):
            for i, j in np.argwhere(sign):
                if known_values[i] and not known_sources[j]:
                    sources[j], known_sources[j] = sign[i, j] * values[i], True
                elif known_sources[j] and not known_values[i]:
                    values[i], known_values[i] = sign[i, j] * sources[j], True
    return values, sources
