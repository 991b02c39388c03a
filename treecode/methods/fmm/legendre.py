"""Legendre polynomials in a cube, orthonormal, and points that fill it."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.polynomial import legendre


def polynomials(x: np.ndarray, degree: int) -> np.ndarray:
    """Return the orthonormal Legendre polynomials at x, (degree, n)."""
    scale = np.sqrt(np.arange(degree) + 0.5)
    return np.asarray(legendre.legvander(x, degree - 1) * scale).T


@lru_cache(maxsize=2)
def gauss(degree: int) -> tuple[np.ndarray, np.ndarray]:
    """Return Gauss points in [-1, 1] and weighted polynomials there, (degree, points)."""
    x, w = legendre.leggauss(degree)
    return x, polynomials(x, degree) * w


def grid(x: np.ndarray) -> np.ndarray:
    """Return the points of a cubic grid, (3, n^3)."""
    return np.stack(np.meshgrid(x, x, x, indexing="ij")).reshape(3, -1)


def along_axes(matrix: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Apply a (m, n) matrix to the axes 1, 2 and 3 of an array, which go to its end."""
    for _ in range(3):
        values = np.tensordot(values, matrix, axes=(1, 1))
    return values


def fill_evenly(dimensions: int, count: int) -> np.ndarray:
    """Return points that fill the unit cube evenly, (dimensions, count).

    A Kronecker sequence: multiples, modulo 1, of powers of 1/g, where g^(d + 1) = g + 1. Of random
    points least squares need 1.5 times as many to be as well conditioned.
    """
    g = np.roots([1.0, *[0.0] * (dimensions - 1), -1.0, -1.0]).real.max()
    return (0.5 + np.outer(g ** -np.arange(1.0, dimensions + 1), np.arange(1, count + 1))) % 1.0
