"""Slow periodic sums: lattice sums, and sums over waves. Shares nothing with treecode."""

import itertools

import numpy as np
from scipy.special import erfc, kv


def _free(d, force, torque, epsilon):
    """Return the flow and the spin of K eq. (7.3), viscosity 1, at distances (..., 3)."""
    e2 = epsilon**2
    r2 = (d**2).sum(axis=-1, keepdims=True)
    R = np.sqrt(r2 + e2)
    H1, H2 = (2.0 * e2 + r2) / R**3, 1.0 / R**3
    Q, D2 = (5.0 * e2 + 2.0 * r2) / R**5, (21.0 * e2 + 6.0 * r2) / R**7
    D1 = (10.0 * e2**2 - 7.0 * e2 * r2 - 2.0 * r2**2) / R**7
    u = force * H1 + (force * d).sum(axis=-1, keepdims=True) * d * H2 + Q / 2 * np.cross(torque, d)
    w = Q / 2 * np.cross(force, d) + torque * D1 / 4
    w = w + (torque * d).sum(axis=-1, keepdims=True) * d * D2 / 4
    return np.concatenate([u, w], axis=-1) / (8.0 * np.pi)


def lattice_sum(epsilon, cell, points, strengths, targets, radius, width):
    """Return the sum of the free kernels over all images, cut off smoothly, without a net force.

    An image at r has the weight ``erfc((r - radius) / width) / 2``. The spins are then those in a
    large sphere of images, whose mean is 4 pi / 3 times the torque in a volume, here left out.

    Parameters
    ----------
    cell : (3, 3) float64
        Lattice vectors in rows.
    strengths : (N, 6) float64
        Forces and torques.
    """
    cell = np.asarray(cell)
    most = radius + 6.2 * width + np.linalg.norm(cell, axis=1).sum()
    counts = (most * np.linalg.norm(np.linalg.inv(cell), axis=0)).astype(int) + 1
    images = np.array(list(itertools.product(*(range(-n, n + 1) for n in counts)))) @ cell
    images = images[(images**2).sum(axis=1) < most**2]
    total = np.zeros((len(targets), 6))
    for x, out in zip(targets, total, strict=True):
        for y, q in zip(points, strengths, strict=True):
            d = x - y + images
            weight = 0.5 * erfc((np.linalg.norm(d, axis=1) - radius) / width)
            out += weight @ _free(d, q[:3], q[3:], epsilon)
    volume = abs(np.linalg.det(cell))
    total[:, 3:] -= 4.0 * np.pi / 3.0 * strengths[:, 3:].sum(axis=0) / volume / (8.0 * np.pi)
    return total


def plane_sum(epsilon, cell, points, strengths, targets, radius):
    """Return the sum of the free kernels over a plane of images, without a net force.

    Images at a distance in the plane have the weight of `lattice_sum`. What is left out falls like
    odd powers of 1 / radius, of which two are taken off by sums to two and four times as far.

    Parameters
    ----------
    cell : (2, 3) float64
        Lattice vectors in rows, across z; other arguments as above.
    """

    def within(radius):
        width = 0.15 * radius
        most = radius + 6.2 * width + np.linalg.norm(cell, axis=1).sum()
        counts = (most * np.linalg.norm(np.linalg.pinv(cell), axis=0)).astype(int) + 1
        images = np.array(list(itertools.product(*(range(-n, n + 1) for n in counts)))) @ cell
        total = np.zeros((len(targets), 6))
        for x, out in zip(targets, total, strict=True):
            for y, q in zip(points, strengths, strict=True):
                d = x - y + images
                weight = 0.5 * erfc((np.hypot(d[:, 0], d[:, 1]) - radius) / width)
                out += weight @ _free(d, q[:3], q[3:], epsilon)
        return total

    one, two, four = (within(scale * radius) for scale in (1.0, 2.0, 4.0))
    first, second = 2.0 * two - one, 2.0 * four - two
    return (8.0 * second - first) / 7.0


def wave_sum(epsilon, cell, points, strengths, targets, digits=17.0):
    """Return the sum over the waves of the blob itself, for large blobs; arguments as above."""
    cell = np.asarray(cell)
    largest = (digits * np.log(10.0) + 6.0) / epsilon
    counts = (largest * np.linalg.norm(cell, axis=1) / (2.0 * np.pi)).astype(int) + 1
    numbers = np.array(list(itertools.product(*(range(-n, n + 1) for n in counts))))
    k = 2.0 * np.pi * numbers[numbers.any(axis=1)] @ np.linalg.inv(cell).T
    size = np.linalg.norm(k, axis=1)
    k, size = k[size < largest], size[size < largest]
    x = epsilon * size
    chi = (0.25 * x**2 * kv(2, x) / size**2 / abs(np.linalg.det(cell)))[:, None]
    loads = np.exp(-1j * k @ points.T) @ strengths
    force, torque = loads[:, :3], loads[:, 3:]
    unit = k / size[:, None]
    across = force - unit * (unit * force).sum(axis=1, keepdims=True)
    u = chi * (2.0 * across + 1j * np.cross(k, torque))
    spin = torque - unit * (unit * torque).sum(axis=1, keepdims=True)
    w = chi * (1j * np.cross(k, force) + 0.5 * size[:, None] ** 2 * spin)
    return (np.exp(1j * targets @ k.T) @ np.concatenate([u, w], axis=1)).real
