"""Derivatives of the rates of a simulation by its local coordinates."""

import numpy as np
from scipy.sparse.linalg import LinearOperator, eigs

_STEP = 1e-5  # largest change of a coordinate, in differences


def local_rates(sim):
    """Return f(z) in local coordinates about the present state, as a function of flat z."""
    state, shape = sim.state, sim.state.coordinates().shape

    def rates(z):
        z = z.reshape(shape)
        return state.local_rates(z, sim.scene.rates(sim.time, state.moved(z))).ravel()

    return rates


def derivative(sim, direction):
    """Return the derivative of the rates along a direction, by central differences."""
    largest = abs(direction).max()
    if largest == 0.0:
        return np.zeros_like(direction)
    rates, z = local_rates(sim), sim.state.coordinates().ravel()
    h = _STEP / largest * direction
    return (rates(z + h) - rates(z - h)) * (0.5 * largest / _STEP)


def jacobian(sim):
    """Return the derivative of the rates by local coordinates, a matrix."""
    size = sim.state.coordinates().size
    return np.array([derivative(sim, column) for column in np.eye(size)]).T


def spectral_radius(sim):
    """Return the largest absolute value of the eigenvalues, by Arnoldi's method."""
    size = sim.state.coordinates().size
    matrix = LinearOperator((size, size), matvec=lambda v: derivative(sim, v.ravel()))
    start = np.random.default_rng(0).normal(size=size)
    values = eigs(matrix, k=1, which="LM", tol=1e-7, v0=start, return_eigenvectors=False)
    return abs(values[0])
