"""Operators between cubes and their parents: M2M and L2L."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.polynomial import legendre

from treecode.methods.fmm.legendre import along_axes, polynomials
from treecode.methods.fmm.level import CLASSES, PARITY, Level


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
        full = np.moveaxis(along_axes(shift, full), 1, -1)
        full = full.reshape(len(scale) * parent_degree**3, -1)
        for p in range(CLASSES):
            block = full[parent_members[p]].T @ parent_basis[p]
            # The upper half is the mirror image of the lower one.
            out[:, q, :, p] = PARITY[p ^ q][:, None, None] * block
    return out.reshape(8, CLASSES * out.shape[2], CLASSES * out.shape[4])


def _shift_matrix(parent_degree: int, degree: int) -> np.ndarray:
    """Return S with p_k((x - 1) / 2) = sum_j S[k, j] p_j(x): a cube in its parent's lower half."""
    x, w = legendre.leggauss(max(degree, parent_degree))
    lower = polynomials(0.5 * (x - 1.0), parent_degree)
    return (lower * w) @ polynomials(x, degree).T
