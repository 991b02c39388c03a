"""Unit quaternions for many triads at once, stored (x, y, z, w) as in scipy's ``Rotation``.

A quaternion q turns the axes of space into a triad: D_i = q e_i q*. Plain array arithmetic, since
scipy's product of 34,000 rotations takes 50 ms, thirty times as long as this one.
"""

from __future__ import annotations

import numpy as np

IDENTITY = np.array([0.0, 0.0, 0.0, 1.0])


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the cross products of rows, (N, 3); np.cross takes twice as long.

    Examples
    --------
    >>> import mrs
    >>> import numpy as np
    >>> x, y, z = np.eye(3)
    >>> print(mrs.rotations.cross(x, y))
    [0. 0. 1.]
    """
    out = np.empty(np.broadcast_shapes(a.shape, b.shape))
    out[..., 0] = a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1]
    out[..., 1] = a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2]
    out[..., 2] = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return out


def multiply(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Return the products p q, (N, 4): first q turns, then p.

    Examples
    --------
    >>> import mrs
    >>> import numpy as np
    >>> x, y, z = np.eye(3)
    >>> quarter = mrs.rotations.exponential(0.5 * np.pi * z)
    >>> print(mrs.rotations.rotate(mrs.rotations.multiply(quarter, quarter), x).round(6) + 0.0)
    [-1.  0.  0.]
    """
    out = np.empty(np.broadcast_shapes(p.shape, q.shape))
    px, py, pz, pw = np.moveaxis(p, -1, 0)
    qx, qy, qz, qw = np.moveaxis(q, -1, 0)
    out[..., 0] = pw * qx + px * qw + py * qz - pz * qy
    out[..., 1] = pw * qy - px * qz + py * qw + pz * qx
    out[..., 2] = pw * qz + px * qy - py * qx + pz * qw
    out[..., 3] = pw * qw - px * qx - py * qy - pz * qz
    return out


def conjugate(q: np.ndarray) -> np.ndarray:
    """Return the inverse rotations, (N, 4).

    Examples
    --------
    >>> import mrs
    >>> import numpy as np
    >>> q = mrs.rotations.exponential(np.array([0.1, 0.2, 0.3]))
    >>> print(mrs.rotations.multiply(q, mrs.rotations.conjugate(q)).round(6) + 0.0)
    [0. 0. 0. 1.]
    """
    return q * np.array([-1.0, -1.0, -1.0, 1.0])


def normalize(q: np.ndarray) -> np.ndarray:
    """Return unit quaternions, (N, 4).

    Examples
    --------
    >>> import mrs
    >>> import numpy as np
    >>> print(mrs.rotations.normalize(np.array([[0.0, 0.0, 3.0, 4.0]])))
    [[0.  0.  0.6 0.8]]
    """
    return q / np.sqrt(np.einsum("...i,...i->...", q, q))[..., None]


def rotate(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return the vectors v, (N, 3), turned by q, (N, 4).

    Examples
    --------
    >>> import mrs
    >>> import numpy as np
    >>> x, y, z = np.eye(3)
    >>> quarter = mrs.rotations.exponential(0.5 * np.pi * z)
    >>> print(mrs.rotations.rotate(quarter, x).round(6) + 0.0)
    [0. 1. 0.]
    """
    u = q[..., :3]
    twice = 2.0 * cross(u, v)
    return v + q[..., 3:] * twice + cross(u, twice)


def exponential(phi: np.ndarray) -> np.ndarray:
    """Return the quaternions of rotation vectors phi, (N, 3): about phi by its length.

    Examples
    --------
    >>> import mrs
    >>> import numpy as np
    >>> print(mrs.rotations.exponential(np.array([0.0, 0.0, 0.5 * np.pi])).round(6))  # about z
    [0.       0.       0.707107 0.707107]
    """
    half = 0.5 * np.sqrt(np.einsum("...i,...i->...", phi, phi))[..., None]
    return np.concatenate([0.5 * np.sinc(half / np.pi) * phi, np.cos(half)], axis=-1)


def logarithm(q: np.ndarray) -> np.ndarray:
    """Return the rotation vectors of quaternions, (N, 3), the short way round.

    Examples
    --------
    >>> import mrs
    >>> import numpy as np
    >>> quarter = mrs.rotations.exponential(0.5 * np.pi * np.eye(3)[2])
    >>> print(mrs.rotations.logarithm(quarter).round(4))
    [0.     0.     1.5708]
    """
    q = np.where(q[..., 3:] < 0.0, -q, q)
    sine = np.sqrt(np.einsum("...i,...i->...", q[..., :3], q[..., :3]))[..., None]
    half = np.arctan2(sine, q[..., 3:])
    return 2.0 * q[..., :3] / np.sinc(half / np.pi)


def local_rate(phi: np.ndarray, spin: np.ndarray) -> np.ndarray:
    """Return phi' for D = exp(phi) D_n with D' = spin x D, (N, 3).

    The series of the inverse differential of exp up to phi^2; the next term is of fourth order, so
    methods up to order four keep their order.

    Examples
    --------
    >>> import mrs
    >>> import numpy as np
    >>> phi, spin = np.array([[0.1, 0.0, 0.0]]), np.array([[0.0, 0.0, 1.0]])
    >>> print(mrs.rotations.local_rate(phi, spin).round(5) + 0.0)
    [[0.      0.05    0.99917]]
    """
    once = cross(phi, spin)
    return spin - 0.5 * once + cross(phi, once) / 12.0


def relative(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Return the rotations that take p to q, in the axes of p, the short way round, (N, 4).

    Examples
    --------
    >>> import mrs
    >>> import numpy as np
    >>> p = mrs.rotations.exponential(np.array([[0.0, 0.0, 0.1]]))
    >>> q = mrs.rotations.exponential(np.array([[0.0, 0.0, 0.4]]))
    >>> print((2.0 * np.arcsin(mrs.rotations.relative(p, q)[0, 2])).round(6))  # the angle
    0.3
    """
    turn = multiply(conjugate(p), q)
    return np.where(turn[..., 3:] < 0.0, -turn, turn)


def halved(q: np.ndarray) -> np.ndarray:
    """Return the rotations by half the angle, (N, 4); the scalar part of q must not be negative.

    Examples
    --------
    >>> import mrs
    >>> import numpy as np
    >>> q = mrs.rotations.exponential(np.array([[0.0, 0.0, 0.6]]))
    >>> print((2.0 * np.arcsin(mrs.rotations.halved(q)[0, 2])).round(6))  # the angle
    0.3
    """
    return normalize(q + IDENTITY)


def axes(q: np.ndarray) -> np.ndarray:
    """Return the triads, (N, 3, 3): out[k, i] is D_{i+1} of quaternion k.

    Examples
    --------
    >>> import mrs
    >>> import numpy as np
    >>> quarter = mrs.rotations.exponential(np.array([[0.0, 0.0, 0.5 * np.pi]]))
    >>> print(mrs.rotations.axes(quarter)[0].round(6) + 0.0)  # D1, D2, D3
    [[ 0.  1.  0.]
     [-1.  0.  0.]
     [ 0.  0.  1.]]
    """
    return np.stack([rotate(q, np.broadcast_to(e, (*q.shape[:-1], 3))) for e in np.eye(3)], -2)


def between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the shortest rotations that take unit vectors a to b, not opposite, (N, 4).

    Examples
    --------
    >>> import mrs
    >>> import numpy as np
    >>> x, y, z = np.eye(3)
    >>> print(mrs.rotations.rotate(mrs.rotations.between(x, y), x).round(6) + 0.0)
    [0. 1. 0.]
    """
    cosine = np.einsum("...i,...i->...", a, b)[..., None]
    return normalize(np.concatenate([cross(a, b), 1.0 + cosine], axis=-1))
