"""Simulations of the cases, and measures of their states."""

import numpy as np
from scipy.spatial.transform import Rotation

import mrs
from tests.cases.oracle import UNIT


def simulate(bodies, epsilon, integrator="rkc2", **options):
    """Return a simulation in a fluid of viscosity 1, by direct sums."""
    return mrs.Simulation(
        mrs.Fluid(1.0, epsilon), bodies, backend="direct", integrator=integrator, **options
    )


def rod_of(line, a, b, strain=(0.0, 0.0, 0.0), **options):
    """Return rods with moduli a and b but for those in `options`."""
    moduli = {"bending": a, "twisting": a, "shearing": b, "stretching": b}
    return mrs.Rods(line, intrinsic_curvature=strain, **(moduli | options))


def kicked(sim, z):
    """Put a simulation at local coordinates z about its present state."""
    start = sim.state.coordinates()
    sim.state = sim.state.moved(start + z.reshape(start.shape))


def offset(state, base):
    """Return the local coordinates of a state about another, less those of that one, flat."""
    turned = Rotation.from_quat(state.quaternions) * Rotation.from_quat(base.quaternions).inv()
    moved = state.positions - base.positions
    return np.concatenate([moved, turned.as_rotvec()]).ravel()


def imbalance(sim):
    """Return the net force, and torque, in roundings of the largest loads times nodes."""
    now = sim.now
    X, f, n = now.points, now.loads[:, :3], now.loads[:, 3:]
    force = abs(f.sum(axis=0)).max() / abs(f).max()
    torque = abs((np.cross(X, f) + n).sum(axis=0)).max()
    torque /= abs(X).max() * abs(f).max() + abs(n).max()
    return max(force, torque) / (UNIT * len(X))
