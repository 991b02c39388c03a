"""The fibre of `sedimenting_fibre` against a second solver: planar formulas, dense sums, scipy."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from mrs.run import scenario_files

NODES, LENGTH, WEIGHT, BENDING, SHEARING = 13, 2.0, 10.0, 1.0, 50.0
EPSILON = 2.0 * LENGTH / (NODES - 1)  # that of the scenario
DS = LENGTH / (NODES - 1)


def cross(a, b):
    """Return the cross product of vectors in the plane, a number each."""
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def loads(X, angle):
    """Return forces and torques of nodes at X, (N, 2), with D3 at an angle from x towards z.

    Physics.md 4 in a plane: the rotation over a segment is the difference of two angles.
    """
    half = 0.5 * (angle[1:] + angle[:-1])
    along = np.column_stack([np.cos(half), np.sin(half)])
    across = np.column_stack([-np.sin(half), np.cos(half)])
    step = np.diff(X, axis=0)
    stretch = (step * along).sum(axis=1, keepdims=True) / DS - 1.0
    shear = (step * across).sum(axis=1, keepdims=True) / DS
    F = SHEARING * (stretch * along + shear * across)
    N = BENDING * 2.0 * np.sin(0.5 * np.diff(angle)) / DS
    couple = 0.5 * cross(step, F)
    force, torque = np.zeros((NODES, 2)), np.zeros(NODES)
    force[:-1] += F
    force[1:] -= F
    torque[:-1] += N + couple
    torque[1:] += couple - N
    force[:, 1] -= WEIGHT / NODES
    return force, torque


def motion(X, force, torque):
    """Return velocities and angular velocities by the formulas of physics.md 2, viscosity 1."""
    r = X[:, None] - X
    r2 = (r**2).sum(axis=2)
    R = np.sqrt(r2 + EPSILON**2)
    H1, H2 = (2 * EPSILON**2 + r2) / R**3, 1 / R**3
    Q = (5 * EPSILON**2 + 2 * r2) / R**5
    D1 = (10 * EPSILON**4 - 7 * EPSILON**2 * r2 - 2 * r2**2) / R**7
    turned = np.stack([-r[..., 1], r[..., 0]], axis=2)  # a unit torque times r
    pull = (r * force).sum(axis=2)
    u = np.einsum("ij,jk->ik", H1, force) + np.einsum("ij,ijk->ik", H2 * pull, r)
    u += 0.5 * np.einsum("ij,ijk->ik", Q * torque, turned)
    w = (0.5 * Q * cross(force, r) + 0.25 * D1 * torque).sum(axis=1)
    return u / (8 * np.pi), w / (8 * np.pi)


def rates(t, y):
    X, angle = y[: 2 * NODES].reshape(-1, 2), y[2 * NODES :]
    u, w = motion(X, *loads(X, angle))
    return np.concatenate([u.ravel(), w])


def solved(times):
    """Return places, (N, 2), and velocities at some times."""
    level = np.column_stack([np.linspace(-0.5 * LENGTH, 0.5 * LENGTH, NODES), np.zeros(NODES)])
    start = np.concatenate([level.ravel(), np.zeros(NODES)])
    options = {"method": "BDF", "rtol": 1e-8, "atol": 1e-10, "t_eval": times}
    found = solve_ivp(rates, (0.0, times[-1]), start, **options)
    for t, y in zip(found.t, found.y.T, strict=True):
        yield tuple(part[: 2 * NODES].reshape(-1, 2) for part in (y, rates(t, y)))


def simulated():
    """Return the simulation of the same fibre."""
    options = {
        "nodes": NODES,
        "length": LENGTH,
        "weight": WEIGHT,
        "bending": BENDING,
        "shearing": SHEARING,
        "backend": "direct",
        "integrator": {"name": "rkc2", "dt": 0.05},
    }
    return scenario_files.make("sedimenting_fibre", options).simulation()


def test_the_fibre_falls_as_a_u():
    """Shape and speed on the way and at rest in itself.

    On the way the error is that of steps of 0.05 of second order. At rest there is none of it; what
    is left is what has not decayed, the same in both.
    """
    sim = simulated()
    (moving, falling), (still, steady) = solved([0.5, 14.0])
    sim.run(0.5)
    np.testing.assert_allclose(sim.state.positions[:, ::2], moving, rtol=0, atol=1e-4 * LENGTH)
    np.testing.assert_allclose(sim.now.motion[:, :3:2], falling, rtol=0, atol=1e-3)
    sim.run(14.0)
    places, velocity = sim.state.positions[:, ::2], sim.now.motion[:, :3:2]
    shape = places - places.mean(axis=0)
    np.testing.assert_allclose(shape, still - still.mean(axis=0), rtol=0, atol=1e-5 * LENGTH)
    np.testing.assert_allclose(velocity, steady, rtol=0, atol=1e-5)
    assert velocity[:, 1].mean() == pytest.approx(steady[:, 1].mean(), rel=1e-6)
    assert np.ptp(velocity, axis=0).max() < 1e-5 * abs(velocity).max()
    assert shape[0, 1] - shape[NODES // 2, 1] > 0.15 * LENGTH
    np.testing.assert_allclose(sim.state.positions[:, 1], 0.0, atol=1e-9)
