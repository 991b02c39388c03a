"""Direct summation: the treecode whose root is a leaf that no target is far from."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from treecode.kernels.base import MEMBERS
from treecode.threads import Threads
from treecode.tree import Tree, build_tree

MIN_DEGREE = 1
KERNEL_MEMBERS = MEMBERS


class NoExpansion(NamedTuple):
    """Stands where the treecodes have an expansion."""

    def holds(self, cluster):
        return False

    def approximate(self, kernel, tree, cluster, targets, first, last, out):
        pass

    def terms(self):
        return 0


def build(points: np.ndarray, leaf_size: int) -> tuple[Tree, np.ndarray]:
    """Make one leaf of all points."""
    return build_tree(points, max(1, points.shape[1]), shrink=False)


def distance2(tree: Tree, theta: float) -> np.ndarray:
    """Return the distance from which a cluster is approximated: never."""
    return np.full(len(tree.radius), np.inf)


def prepare(
    kernel: object, tree: Tree, degree: int, wanted: np.ndarray, dtype: type
) -> NoExpansion:
    """Return the expansion that is never used."""
    return NoExpansion()


def update(
    expansion: NoExpansion, tree: Tree, sources: np.ndarray, weights: np.ndarray, threads: Threads
) -> None:
    """Do nothing: the sum is taken over the points themselves."""
