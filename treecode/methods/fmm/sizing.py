"""How large things are before they are made: expansions, cubes, leaves, operators, a whole sum."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from treecode.kernels.base import Kernel
from treecode.memory import memory_limit
from treecode.methods.fmm.lists import direct_lists
from treecode.methods.fmm.octree import build_octree
from treecode.threads import Threads

# An operator's error in the mean square as part of the tolerance: strengths that cancel, and
# points that crowd in corners of cubes, make more of it.
SAFETY = 0.4
SINGLE = 3e-6  # tolerance from which single precision serves, if it does for the kernel
FIRST_LEVEL = 2  # the coarsest level with cubes that do not touch

_MEMORY = 0.5  # part of the machine's memory that operators may take
_BUILDING = 4  # operators as large as this many others are in memory when some are built
_SAMPLE = 40_000  # points from which the side of the root is chosen,
_PER_LEAF = 8  # more if fewer than so many would be left in a leaf


class Work(NamedTuple):
    """What a sum takes.

    Attributes
    ----------
    pairs : float
        Near pairs.
    cubes : float
        What cubes cost, in near pairs.
    sizes : int
        Of cubes, each with operators of its own unless one serves all.
    """

    pairs: float
    cubes: float
    sizes: int


def precision_for(tol: float) -> str:
    """Return the precision that a tolerance allows, if the kernel does."""
    return "float32" if tol >= SINGLE else "float64"


def expansion_size(tol: float, degree: int | None) -> int:
    """Return about how many points would stand for an expansion, before operators are known."""
    return (degree or math.ceil(1.5 * math.log10(1.0 / (SAFETY * tol)))) ** 3


def _channels(kernel: Kernel) -> float:
    return kernel.weight_size * kernel.value_size / 9.0


def _rank(kernel: Kernel, tol: float) -> float:
    """Return about how many functions an expansion has; a level takes 35 numbers times its square.

    Measured for 3 x 3 and 6 x 6 kernels at 1e-4 to 2e-11: 29 to 45 times.
    """
    return 12.0 * math.log10(1.0 / tol) ** 2 * _channels(kernel) ** 0.4


def cube_cost(kernel: Kernel, tol: float) -> float:
    """Return what one cube more costs, in near pairs of the same precision.

    Measured: 40 and 120 microseconds for translations at ranks of 128 and 320 in single precision,
    0.75 ms at 576 in double precision, some 15 for the rest; 0.9e9 and 0.75e9 pairs a second.
    """
    single = precision_for(tol) == "float32"
    channels, rank = _channels(kernel), _rank(kernel, SAFETY * tol)
    seconds = (0.6e-9 if single else 2.2e-9) * rank**2 + 1.25e-7 * rank + 3e-5
    return seconds * (0.9e9 if single else 0.75e9) / channels**0.6


def sampling_interval(count: int, leaf_size: int) -> int:
    """Return that one of so many points, `count` in all, shall be in a sample."""
    return max(1, min(-(-count // _SAMPLE), leaf_size // _PER_LEAF))


def choose_width(
    widths: list[float],
    sample: np.ndarray,
    split: int | None,
    every: int,
    leaf_size: int,
    cost: float,
    threads: Threads,
) -> tuple[float, Work]:
    """Return the side of the root that costs least, which sets how full the leaves are.

    Parameters
    ----------
    widths : list of float
        To choose from, see `octree.root_widths`.
    sample : (3, n) float64
        Sources, and after the first `split` of them targets; all are both if it is None.
    split : int, optional
    every : int
        One of so many points is in the sample: `sampling_interval`.
    leaf_size : int
    cost : float
        Of a cube, see `cube_cost`.
    threads : Threads

    Returns
    -------
    width : float
    work : Work
        Estimated from a sample.
    """
    # Counts in a sample scatter, and cubes that hardly fit in must not seem to be split.
    mean = leaf_size / every
    most = max(1, round(mean + 0.5 * math.sqrt(mean * (1.0 - 1.0 / every))))
    works: dict[float, Work] = {}

    def weigh(chunk: slice) -> None:
        width = widths[chunk.start]
        with Threads(most=1) as alone:
            tree, _, _ = build_octree(sample.copy(), split, most, width, alone)
            leaves = np.flatnonzero(tree.leaf)
            begin, entries = direct_lists(tree, leaves, len(sample.T), False, alone)
        counts = np.append(np.diff(tree.source)[entries, 0], 0)
        near = np.add.reduceat(counts, begin[:-1]) * (np.diff(begin) > 0)
        pairs = float(near @ np.diff(tree.target)[leaves, 0]) * every**2
        cubes = cost * np.count_nonzero(tree.level >= FIRST_LEVEL)
        works[width] = Work(pairs, cubes, max(0, tree.depth + 1 - FIRST_LEVEL))

    threads(weigh, len(widths), 1)
    width = min(works, key=lambda width: (sum(works[width][:2]), width))
    return width, works[width]


def require_memory(kernel: Kernel, tol: float, sizes: int, dtype: Any) -> None:
    """Refuse operators that do not fit; estimated, as building them can take minutes."""
    allowed = _MEMORY * memory_limit() / (sizes + _BUILDING)
    per_rank2 = 35.0 * np.dtype(dtype).itemsize
    if per_rank2 * _rank(kernel, SAFETY * tol) ** 2 > allowed:
        # Ranks are in proportion to the square of the digits.
        rank = _rank(kernel, 0.1)
        digits = math.sqrt(math.sqrt(allowed / per_rank2) / rank)
        raise ValueError(
            f"tol must be at least {10.0**-digits / SAFETY:.1e} for the operators of cubes of "
            f"{sizes} sizes to fit in memory, got {tol:g}"
        )
