"""Rigid bodies as one dense system, written out from physics.md 2. Shares nothing with mrs."""

import numpy as np


def stokeslets(points, epsilons, viscosity):
    """Return the matrix from forces to velocities at the same points, (3 n, 3 n)."""
    n = len(points)
    matrix = np.zeros((3 * n, 3 * n))
    for j in range(n):
        r = points - points[j]
        square = (r**2).sum(axis=1)
        bottom = 8 * np.pi * viscosity * (square + epsilons[j] ** 2) ** 1.5
        for a in range(3):
            for b in range(3):
                same = (square + 2 * epsilons[j] ** 2) * (a == b)
                matrix[a::3, 3 * j + b] = (same + r[:, a] * r[:, b]) / bottom
    return matrix


def rigid(points, centre):
    """Return the matrix from velocity and angular velocity to velocities of points, (3 n, 6)."""
    matrix = np.zeros((3 * len(points), 6))
    for k, point in enumerate(points):
        x, y, z = point - centre
        turning = [[0, z, -y], [-z, 0, x], [y, -x, 0]]  # omega x r
        matrix[3 * k : 3 * k + 3] = np.hstack([np.eye(3), turning])
    return matrix


def solve(points, epsilons, bodies, velocities, free, loads, viscosity=1.0):
    """Return forces, (n, 3), and the motion of the free bodies by their numbers.

    Parameters
    ----------
    points, velocities : (n, 3) ndarray
        The velocities are those besides the motion of free bodies, less the flow of others.
    epsilons : (n,) ndarray
    bodies : list of (rows, centre)
    free : list of int
    loads : dict
        Force and torque of the free bodies, (6,) each.
    """
    n = len(points)
    motion = np.zeros((3 * n, 6 * len(free)))
    right = np.zeros(6 * len(free))
    for k, number in enumerate(free):
        rows, centre = bodies[number]
        own = rigid(points[rows], centre)
        components = (3 * np.asarray(rows)[:, None] + np.arange(3)).ravel()
        motion[components, 6 * k : 6 * k + 6] = own
        right[6 * k : 6 * k + 6] = loads[number]
    matrix = stokeslets(points, epsilons, viscosity)
    system = np.block([[matrix, -motion], [motion.T, np.zeros((len(right), len(right)))]])
    solution = np.linalg.solve(system, np.concatenate([velocities.ravel(), right]))
    forces, turned = solution[: 3 * n].reshape(n, 3), solution[3 * n :].reshape(-1, 6)
    return forces, dict(zip(free, turned, strict=True))
