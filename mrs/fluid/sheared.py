"""Periodic boxes that a shear flow carries along.

A linear flow, of velocity G x besides a constant, moves the lattice with the fluid. If it is along
one of the lattice vectors everywhere, another vector a becomes a + t G a. Multiples of the one can
be taken off it: there is a basis that is never inclined by more than half a box (A. W. Lees &
S. F. Edwards, J. Phys. C 5, 1972). Other flows turn boxes, or draw them out ever longer.
"""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import TypeGuard

import numpy as np

from mrs.fluid.flows import Flow, QuadraticFlow
from mrs.fluid.mobility import Boundary
from treecode import Periodic

_ROUNDING = 1e-9  # part of the largest velocity that may be across the lattice vector


def carried(boundary: Boundary, flow: Flow | None, time: float) -> Boundary:
    """Return a boundary where a background flow has carried it since time 0.

    Only periodic boxes in a linear flow move. At the times when lattice vectors are changed for
    others the lattice is the same.

    Parameters
    ----------
    boundary : Boundary
    flow : Flow, optional
        One that `require_carried` allows.
    time : float
    """
    if not isinstance(boundary, Periodic) or not is_linear(flow):
        return boundary
    axis, rates = _shear(boundary, flow)
    if not rates.any():  # a slab that the flow is along, and which is across its gradient
        return boundary
    shift = rates * time
    shift -= np.rint(shift + _inclination(boundary, axis))
    return _inclined(boundary, axis, shift)


def narrowest(boundary: Boundary, flow: Flow | None) -> Boundary:
    """Return a boundary at the time when its cell is the lowest; arguments as for `carried`."""
    if not isinstance(boundary, Periodic) or not is_linear(flow):
        return boundary
    axis, rates = _shear(boundary, flow)
    inclination = _inclination(boundary, axis)
    # The area of a face is a convex function of inclinations: it is largest at a corner.
    reduced = inclination - np.rint(inclination)
    ends = [(-0.5, 0.5) if rate else (x,) for rate, x in zip(rates, reduced, strict=True)]
    cells = [_inclined(boundary, axis, end - inclination) for end in itertools.product(*ends)]
    return min(cells, key=lambda cell: float(cell.heights.min()))


def is_linear(flow: Flow | None) -> TypeGuard[QuadraticFlow]:
    """Tell whether a flow is linear, and not the same everywhere."""
    return (
        isinstance(flow, QuadraticFlow)
        and bool(flow.gradient.any())
        and not bool(flow.quadratic.any())
    )


def require_carried(flow: QuadraticFlow, box: Periodic) -> None:
    """Refuse a linear flow that does not shear a box along one of its vectors."""
    try:
        _shear(box, flow)
    except LookupError:
        raise ValueError(
            "background must be a shear along one of the lattice vectors, or boxes would turn or "
            f"become ever longer, got gradient {flow.gradient.tolist()} and {box}"
        ) from None


def _shear(box: Periodic, flow: QuadraticFlow) -> tuple[int, np.ndarray]:
    """Return which lattice vector the flow is along, and how many of it the others gain, (n,).

    The rates are per time; that of the vector itself is 0, since the flow is free of divergence.
    """
    vectors = box.vectors
    velocities = vectors @ flow.gradient.T
    for axis, along in enumerate(vectors):
        rates = velocities @ along / (along @ along)
        across = velocities - np.outer(rates, along)
        if np.abs(across).max() <= _ROUNDING * np.abs(velocities).max():
            rates[axis] = 0.0
            return axis, rates
    raise LookupError


def _inclination(box: Periodic, axis: int) -> np.ndarray:
    """Return how far each lattice vector is inclined along one of them, (n,), in parts of it."""
    along = box.vectors[axis]
    inclination = box.vectors @ along / (along @ along)
    inclination[axis] = 0.0
    return np.asarray(inclination)


def _inclined(box: Periodic, axis: int, shift: np.ndarray) -> Periodic:
    """Return a box with multiples of one lattice vector added to each, (n,)."""
    return replace(box, cell=box.vectors + np.outer(shift, box.vectors[axis]))
