"""The point sets of the papers, as far as their text fixes them.

"K" is Wang, Krasny and Tlupova (2020), "T" is Wang, Tlupova and Krasny (2019). Their random
numbers are not available, so a set agrees with theirs in distribution, not point by point.
"""

from __future__ import annotations

import math

import numpy as np

CUBE_SIDE = 10.0  # K section 8.1
CUBE_DENSITY = 2500.0  # T section 6
ROD_SPACING = 16.0 / 15.0  # K section 8.2: 15 rods in 16, and 80 in "approximately 85"
ROD_POINTS = 151

UNEVEN = (
    "uniform cube",
    "rod array",
    "sphere surface",
    "half in a clump a thousandth as wide",
    "two clumps a thousand widths apart",
)


def organisms(
    n: int, length: float, seed: int, *, octant: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """Return microorganisms in a cube: pairs of particles with opposite unit forces, K section 8.1.

    The paper leaves open how positions and directions are drawn: here bodies are uniform in the
    cube [0, 10]^3 and the flagellum may stick out of it. Isotropic directions are the plain
    reading; with them the mean flow of the dipoles vanishes. Directions in one octant, of three
    random numbers from [0, 1] after normalisation, leave a mean flow. With them the errors agree
    with K tables 1 and 3 within some per cent.
    The order is body, flagellum, body, flagellum, ...

    Parameters
    ----------
    n : int
        Number of particles, even.
    length : float
        Distance of the two particles of an organism.
    seed : int
    octant : bool, optional
        Directions from [0, 1]^3, normalised, rather than uniform on the sphere.

    Returns
    -------
    points, forces : (n, 3) float64
    """
    if n % 2:
        raise ValueError(f"n must be even, two particles an organism, got {n}")
    rng = np.random.default_rng(seed)
    body = rng.uniform(0.0, CUBE_SIDE, (n // 2, 3))
    direction = rng.random((n // 2, 3)) if octant else rng.normal(size=(n // 2, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    points = np.stack([body, body - length * direction], axis=1)
    forces = np.stack([direction, -direction], axis=1)
    return points.reshape(n, 3), forces.reshape(n, 3)


def rods(rods_per_side: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return an array of helical rods with random forces and torques, K section 8.2.

    The paper leaves open where in the domain the grid of base points lies: here the rods stand
    at the centres of square cells of side 16/15.

    Parameters
    ----------
    rods_per_side : int
        15, 20, 30, 40, 60 or 80 in the paper.
    seed : int

    Returns
    -------
    points : (151 * rods_per_side^2, 3) float64
    strengths : (151 * rods_per_side^2, 6) float64
        Force and torque, each component uniform in [-1, 1].
    """
    base = ROD_SPACING * (np.arange(rods_per_side) - 0.5 * (rods_per_side - 1))
    z = np.linspace(0.0, 9.0, ROD_POINTS)
    helix = np.stack([0.3 * np.cos(2.0 * z), 0.3 * np.sin(2.0 * z), z], axis=1)
    points = np.zeros((rods_per_side, rods_per_side, ROD_POINTS, 3)) + helix
    points[..., 0] += base[:, None, None]
    points[..., 1] += base[None, :, None]
    points = points.reshape(-1, 3)
    return points, np.random.default_rng(seed).uniform(-1.0, 1.0, (len(points), 6))


def sphere(level: int, seed: int, *, outward: bool = True) -> tuple[np.ndarray, np.ndarray]:
    """Return Stokeslets and stresslets on the unit sphere, T section 6.1.1.

    Faces of an icosahedron are cut in four at the midpoints of their edges `level` times; the
    particles are their centroids, projected on the sphere. The paper leaves open whether the
    midpoints are projected too: here, as it is written, only the centroids are. It calls nu "a
    unit normal vector to a surface". The published program stores the outward normals and then
    sorts the points into the tree, but not the normals: each goes to some other point. With
    shuffled normals the errors of T table 1 come out, with outward ones they are 6 to 10 times
    larger: near neighbours then have small stresslets, and the sum is about 9 times smaller.

    Parameters
    ----------
    level : int
        6, 7 and 8 in the paper's table 1.
    seed : int
    outward : bool, optional
        Give every point its own normal; otherwise the normal of a random other point.

    Returns
    -------
    points : (20 * 4^level, 3) float64
    strengths : (20 * 4^level, 9) float64
        f and h, each component uniform in [-1, 1], and the unit normal nu.
    """
    faces = _icosahedron()
    for _ in range(level):
        a, b, c = faces[:, 0], faces[:, 1], faces[:, 2]
        ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
        quarters = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        faces = np.concatenate([np.stack(quarter, axis=1) for quarter in quarters])
    points = faces.mean(axis=1)
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    rng = np.random.default_rng(seed)
    weights = rng.uniform(-1.0, 1.0, (len(points), 6))
    normals = points if outward else rng.permutation(points)
    return points, np.concatenate([weights, normals], axis=1)


def cube(n: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return Stokeslets in a cube of number density 2500, T section 6.1.2.

    Parameters
    ----------
    n : int
    seed : int

    Returns
    -------
    points : (n, 3) float64
        Uniform in [0, L]^3 with n / L^3 = 2500.
    forces : (n, 3) float64
        Each component uniform in [-1, 1].
    """
    rng = np.random.default_rng(seed)
    side = (n / CUBE_DENSITY) ** (1.0 / 3.0)
    return rng.uniform(0.0, side, (n, 3)), rng.uniform(-1.0, 1.0, (n, 3))


def uneven(name: str, n: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return one of the sets `UNEVEN` with random forces.

    Parameters
    ----------
    name : str
    n : int
    seed : int

    Returns
    -------
    points : (n, 3) float64
    forces : (n, 3) float64
        Normally distributed.
    """
    rng = np.random.default_rng(seed)
    points = rng.uniform(-1.0, 1.0, (n, 3))
    kind = UNEVEN.index(name)
    if kind == 1:
        points = rods(math.ceil(math.sqrt(n / ROD_POINTS)), seed)[0][:n]
    elif kind == 2:
        points /= np.linalg.norm(points, axis=1, keepdims=True)
    elif kind == 3:
        points[::2] *= 1e-3
    elif kind == 4:
        points *= 1e-3
        points[::2] += 1.0
    return points, rng.standard_normal((n, 3))


def _icosahedron() -> np.ndarray:
    """Return the corners of the 20 faces, (20, 3 corners, 3).

    The vertices are the cyclic permutations of (0, +-1, +-golden); neighbours are 2 apart.
    """
    golden = 0.5 * (1.0 + np.sqrt(5.0))
    one = np.array([(0.0, s, t * golden) for s in (-1.0, 1.0) for t in (-1.0, 1.0)])
    vertices = np.concatenate([np.roll(one, shift, axis=1) for shift in range(3)])
    near = np.linalg.norm(vertices[:, None] - vertices, axis=2) < 2.1
    faces = [
        (i, j, k)
        for i in range(12)
        for j in range(i + 1, 12)
        for k in range(j + 1, 12)
        if near[i, j] and near[j, k] and near[k, i]
    ]
    return vertices[np.array(faces)]
