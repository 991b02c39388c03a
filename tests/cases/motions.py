"""Motions that the tests of time stepping follow: points with a triad, and a bent rod."""

import numpy as np
from scipy.spatial.transform import Rotation

import mrs
from mrs.time.state import State
from mrs.time.system import System
from tests.cases import rod_oracle as oracle


class Coupled(System):
    """Two points and a triad that drive each other, nonlinearly and in time."""

    error_scale = np.ones((3, 1))
    perturbation = 1e-6 * np.ones((3, 1))

    @staticmethod
    def motion(t, X, D):
        """Return velocities, (2, 3), and the angular velocity, (1, 3)."""
        u0 = D[0, 2] + 0.5 * np.sin(2 * t) * X[1]
        u1 = np.cross(D[0, 0], X[0]) - 0.3 * X[1] * (X[0] @ X[0])
        w = X[0] + 2.0 * np.cos(t) * D[0, 1] + (X[1] @ D[0, 2]) * D[0, 0]
        return np.array([u0, u1]), np.array([w])

    def rates(self, t, state, near=None):
        return np.concatenate(self.motion(t, state.positions, oracle.triads(state.quaternions)))

    def refusal(self, time, state):
        return None

    @staticmethod
    def start():
        x = np.array([[0.3, -0.2, 0.5], [0.1, 0.4, -0.6]])
        return State(x, Rotation.from_rotvec([[0.4, -0.3, 0.8]]).as_quat())

    def exact(self, t):
        start = self.start()
        return oracle.integrate(self.motion, start.positions, oracle.triads(start.quaternions), t)


def advance(stepper, problem, state, t_end):
    """Return the state at the end of steps from time 0."""
    t = 0.0
    while t < t_end:
        t, state = stepper.step(problem, t, state, t_end)
    return state


ROD = {"bending": 0.02, "twisting": 0.03, "shearing": 0.3, "stretching": 0.4}
STRAIN = np.array([1.0, 0.0, 2.0])


def small_rod(nodes, integrator, noise, seed=0):
    """Return a simulation of a straight rod that wants to be a helix, displaced by `noise`."""
    line = mrs.geometry.straight(0.2 * (nodes - 1), nodes)
    rod = mrs.Rods(line, intrinsic_curvature=STRAIN, **ROD)
    sim = mrs.Simulation(mrs.Fluid(1.0, 0.3), [rod], backend="direct", integrator=integrator)
    rng = np.random.default_rng(seed)
    turned = Rotation.from_rotvec(noise * rng.normal(size=(nodes, 3))).as_quat()
    sim.state = State(line.nodes + 0.2 * noise * rng.normal(size=(nodes, 3)), turned)
    return sim
