"""Explicit Runge-Kutta methods as Butcher tableaus that check themselves.

Hairer, Norsett & Wanner, Solving Ordinary Differential Equations I, sections II.1-II.5.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations_with_replacement
from math import prod
from typing import Any

import numpy as np

from mrs.time.integrators.base import Problem, Step
from mrs.time.state import Arrays

Tree = tuple[Any, ...]  # a rooted tree: the tuple of the trees at its root


def rooted_trees(order: int) -> Iterator[Tree]:
    """Yield the rooted trees with `order` nodes: one order condition each."""

    def forests(nodes: int, largest: int) -> Iterator[Tree]:
        if nodes == 0:
            yield ()
        for size in range(min(nodes, largest), 0, -1):
            for count in range(1, nodes // size + 1):
                for group in combinations_with_replacement(tuple(rooted_trees(size)), count):
                    for rest in forests(nodes - count * size, size - 1):
                        yield group + rest

    yield from forests(order - 1, order - 1)


def _size(tree: Tree) -> int:
    return 1 + sum(map(_size, tree))


def _density(tree: Tree) -> int:
    return _size(tree) * prod(map(_density, tree))


@dataclass(frozen=True)
class Tableau:
    """An explicit Runge-Kutta method.

    Parameters
    ----------
    name : str
    order : int
        Of the method; checked.
    a : tuple of tuple of float
        Row i has i numbers.
    b : tuple of float
    embedded : tuple of float, optional
        Weights of a second solution, one order lower, whose difference estimates the error.

    Raises
    ------
    ValueError
        If a shape is wrong or an order condition (one for each rooted tree) fails.
    """

    name: str
    order: int
    a: tuple[tuple[float, ...], ...]
    b: tuple[float, ...]
    embedded: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        if [len(row) for row in self.a] != list(range(len(self.b))):
            raise ValueError(f"{self.name}: row i of a must have i numbers, as many rows as b")
        self._check(self.b, self.order)
        if self.embedded is not None:
            if len(self.embedded) != len(self.b):
                raise ValueError(f"{self.name}: embedded must be as long as b")
            self._check(self.embedded, self.order - 1)

    @property
    def error_order(self) -> int | None:
        """Order of the embedded solution."""
        return None if self.embedded is None else self.order - 1

    @cached_property
    def matrix(self) -> np.ndarray:
        """a as a square matrix."""
        size = len(self.b)
        return np.array([row + (0.0,) * (size - len(row)) for row in self.a])

    @cached_property
    def nodes(self) -> np.ndarray:
        """c, the sums of the rows of a."""
        return self.matrix.sum(axis=1)

    def _check(self, weights: tuple[float, ...], order: int) -> None:
        def elementary(tree: Tree) -> np.ndarray:
            factors = [self.matrix @ elementary(branch) for branch in tree]
            return np.prod([np.ones(len(self.b)), *factors], axis=0)

        for size in range(1, order + 1):
            for tree in rooted_trees(size):
                defect = weights @ elementary(tree) - 1.0 / _density(tree)
                if abs(defect) > 1e-14:
                    raise ValueError(
                        f"{self.name}: not of order {order}; the condition of tree {tree} "
                        f"fails by {defect:.1e}"
                    )

    def stability_interval(self) -> float:
        """Return the first x at which |R(-x)| = 1, with R(z) = 1 + sum_k z^k b A^{k-1} 1."""
        return self._stability_interval

    @cached_property
    def _stability_interval(self) -> float:
        power, coefficients = np.ones(len(self.b)), [1.0]
        for _ in self.b:
            coefficients.append(float(self.b @ power))
            power = self.matrix @ power
        signs = (-1.0) ** np.arange(len(coefficients))
        polynomial = np.polynomial.Polynomial(np.array(coefficients) * signs)
        roots = np.concatenate([(polynomial - 1.0).roots(), (polynomial + 1.0).roots()])
        return float(min(r.real for r in roots if abs(r.imag) < 1e-9 and r.real > 1e-9))

    def init(self, z: np.ndarray) -> Arrays:
        """Return nothing to remember."""
        return {}

    def step(self, problem: Problem, t: float, z: np.ndarray, h: float, memory: Arrays) -> Step:
        """Return the step, with the difference of the embedded solution if there is one."""
        k = [problem.rates]
        for c, row in zip(self.nodes[1:], self.a[1:], strict=True):
            k.append(problem.f(t + c * h, z + h * _combined(row, k)))
        new = z + h * _combined(self.b, k)
        if self.embedded is None:
            return Step(new)
        return Step(new, h * _combined(tuple(np.subtract(self.b, self.embedded)), k))


def _combined(weights: tuple[float, ...], vectors: list[np.ndarray]) -> Any:
    return sum(w * v for w, v in zip(weights, vectors, strict=True) if w != 0.0)


EULER = Tableau("euler", 1, ((),), (1.0,))
HEUN = Tableau("heun", 2, ((), (1.0,)), (0.5, 0.5))
RK4 = Tableau("rk4", 4, ((), (0.5,), (0.0, 0.5), (0.0, 0.0, 1.0)), (1 / 6, 1 / 3, 1 / 3, 1 / 6))
BOGACKI_SHAMPINE = Tableau(
    "bs32",
    3,
    ((), (1 / 2,), (0.0, 3 / 4), (2 / 9, 1 / 3, 4 / 9)),
    (2 / 9, 1 / 3, 4 / 9, 0.0),
    embedded=(7 / 24, 1 / 4, 1 / 3, 1 / 8),
)
"""Bogacki & Shampine (1989); its last stage is the first one of the next step."""
