"""A naive oracle of physics.md 3, the flow over the no-slip wall z = 0, and Blake's images.

Shares nothing with treecode. Points may be complex: a complex step gives derivatives to rounding.
"""

import numpy as np

E3 = np.array([0.0, 0.0, 1.0])
DL = np.array([1.0, 1.0, -1.0])  # the diagonal of the reflection in the wall


def _dot(a, b):
    return (a * b).sum(axis=-1, keepdims=True)


def _free(x, y, f, n, e):
    """Return 8 pi mu times u and w in free space (physics.md 2)."""
    r = x - y
    r2 = _dot(r, r)
    R2 = r2 + e**2
    R3, R5, R7 = R2**1.5, R2**2.5, R2**3.5
    Q = (5 * e**2 + 2 * r2) / R5
    D1 = (10 * e**4 - 7 * e**2 * r2 - 2 * r2**2) / R7
    D2 = (21 * e**2 + 6 * r2) / R7
    u = (f * (2 * e**2 + r2) + _dot(f, r) * r) / R3 + Q * np.cross(n, r) / 2
    w = Q * np.cross(f, r) / 2 + D1 * n / 4 + D2 * _dot(n, r) * r / 4
    return u, w


def _images_of_force(X, h, x3, f, e):
    """Return 8 pi mu u and 16 pi mu w of the images of forces."""
    R2 = _dot(X, X) + e**2
    R3, R5, R7 = R2**1.5, R2**2.5, R2**3.5
    b = 1 / R3 - 3 * e**2 / R5
    g, f3, Xg = DL * f, f[..., 2:], _dot(X, DL * f)
    u = -((R2 + e**2) * f + _dot(X, f) * X) / R3
    u = u + 2 * h * (Xg * E3 + f3 * X) / R3 - 2 * h * x3 * (b * g - 3 * X * Xg / R5)
    w = (1 / R3 + 3 * e**2 / R5) * np.cross(X, f)
    w = w + (np.cross(DL * X, g) + 2 * f3 * np.cross(X, E3) + 2 * x3 * np.cross(E3, f)) / R3
    w = w - 2 * h * b * np.cross(E3, f) - 12 * h * np.cross(X, E3) * Xg / R5
    w = w - 30 * e**2 * h * x3 * np.cross(X, g) / R7
    return u, w


def _images_of_torque(X, h, x3, n, e):
    """Return 16 pi mu u and 32 pi mu w of the images of torques."""
    R2 = _dot(X, X) + e**2
    R3, R5, R7, R9 = R2**1.5, R2**2.5, R2**3.5, R2**4.5
    b = 1 / R3 - 3 * e**2 / R5
    p, n3, npar = np.cross(E3, n), n[..., 2:], n * [1.0, 1.0, 0.0]
    pX, XxE3, Xxp, XxDn = _dot(p, X), np.cross(X, E3), np.cross(X, p), np.cross(X, DL * n)
    nxDX = np.cross(n, DL * X)
    u = -(1 / R3 + 3 * e**2 / R5) * nxDX + DL * np.cross(X, n) / R3
    u = u - 2 * pX * E3 / R3 - 2 * h * p / R3 + 2 * x3 * b * p
    u = u - 12 * x3 * X * pX / R5 + 30 * e**2 * h * x3 * DL * nxDX / R7
    w = (3 / R5 + 15 * e**2 / R7) * np.cross(X, nxDX) - 2 * (1 / R3 + 3 * e**2 / R5) * n3 * E3
    w = w - 3 * np.cross(X, np.cross(DL * n, DL * X)) / R5 - 2 * n3 * E3 / R3 - 2 * npar / R3
    w = w + 6 * pX * XxE3 / R5 + 6 * h * Xxp / R5 - 2 * b * npar
    w = w + 2 * x3 * (-3 / R5 + 15 * e**2 / R7) * Xxp + 12 * pX * XxE3 / R5 + 12 * x3 * Xxp / R5
    last = np.cross(E3, XxDn) / R7 - 7 * x3 * np.cross(X, XxDn) / R9 - 2 * x3 * DL * n / R7
    return u, w + 30 * e**2 * h * last


def _velocities(x, y, f, n, e):
    """Return 8 pi mu times u and w over the wall, of points and loads of shapes (..., 3)."""
    X, h, x3 = x - DL * y, y[..., 2:], x[..., 2:]
    u, w = _free(x, y, f, n, e)
    uf, wf = _images_of_force(X, h, x3, f, e)
    un, wn = _images_of_torque(X, h, x3, n, e)
    return u + uf + un / 2, w + wf / 2 + wn / 4


def mobility(targets, sources, epsilon, viscosity=1.0):
    """Return the matrix from forces and torques to velocities and angular velocities, (6M, 6N)."""
    unit = np.eye(6)[:, None, None]
    x, y = targets[:, None], sources[None]
    motion = np.concatenate(_velocities(x, y, unit[..., :3], unit[..., 3:], epsilon), axis=-1)
    matrix = motion.transpose(1, 3, 2, 0) / (8 * np.pi * viscosity)
    return matrix.reshape(6 * len(targets), 6 * len(sources))


def flow(targets, sources, loads, epsilon, viscosity=1.0):
    """Return u and w, (M, 6), of forces and torques, (N, 6)."""
    f, n = loads[:, :3], loads[:, 3:]
    motion = np.concatenate(_velocities(targets[:, None], sources, f, n, epsilon), axis=-1)
    return motion.sum(axis=1) / (8 * np.pi * viscosity)


def _outer(a, b):
    return a[..., :, None] * b[..., None, :]


def _distance(a):
    """Return |a|, with infinity where it is zero: such pairs are left out."""
    d = np.sqrt(_dot(a, a))[..., None]
    return np.where(d == 0.0, np.inf, d)


def blake(targets, sources, forces):
    """Return 8 pi mu u, (M, 3), of point forces over the wall (Blake 1971, his image system).

    The image of a force F_j at height h is the opposite force with a source doublet and a Stokes
    doublet, the derivatives d/dR_k of a source and of a Stokeslet along the normal; each has the
    strength 2 h F_j (d_j1 d_1k + d_j2 d_2k - d_j3 d_3k), and the source doublet h times as much.
    """
    x, y = targets[:, None], sources[None]
    r, R, h = x - y, x - DL * y, y[..., 2:, None]
    r1, R1, R3 = _distance(r), _distance(R), R[..., 2:, None]
    one = np.eye(3)
    stokeslet = one / r1 + _outer(r, r) / r1**3
    image = one / R1 + _outer(R, R) / R1**3
    source_doublet = one / R1**3 - 3 * _outer(R, R) / R1**5  # d/dR_k of R_i / R^3
    stokes_doublet = (one * R3 + _outer(R, E3) - _outer(E3, R)) / R1**3
    stokes_doublet = stokes_doublet - 3 * R3 * _outer(R, R) / R1**5  # of d_i3 / R + R_i R_3 / R^3
    tensor = stokeslet - image + 2 * h * (h * source_doublet - stokes_doublet) * DL
    return np.einsum("mnij,nj->mi", tensor, forces)
