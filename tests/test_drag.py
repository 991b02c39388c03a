"""Drag of rigid bodies, solved for with the simulator's own mobility (numbers of physics.md 7)."""

import numpy as np
import pytest
from scipy.sparse.linalg import LinearOperator, cg

from mrs import Periodic
from mrs.fluid.mobility import Backend, Mobility

X, Y, Z = np.eye(3)
DIRECT, EWALD = Backend("direct"), Backend("ewald", tolerance=1e-8)
THICK = np.exp(0.5)  # epsilon of a line of blobs with the drag of a rod of radius 1


def resistance(points, epsilon, velocity, backend=DIRECT, boundary=None):
    """Return the forces, (N, 3), with which the points move at `velocity`, mu = 1.

    The mobility is symmetric and positive definite, and forces are wanted only in products with
    velocities: conjugate gradients to a residual of 1e-6 give those to some 1e-8 (energy norm).
    """
    n = len(points)
    no = np.zeros(n, bool)
    some = np.full(n, epsilon), ~no, no, no, no.astype(int)
    mobility = Mobility(1.0, *some, backend, boundary)
    matrix = LinearOperator(
        (3 * n, 3 * n), lambda f: mobility(points, f.reshape(n, 3)).ravel(), dtype=float
    )
    forces, failed = cg(matrix, np.broadcast_to(velocity, (n, 3)).ravel(), rtol=1e-6)
    assert not failed
    return forces.reshape(n, 3)


def spin_about(axis, points):
    return np.cross(axis, points)


def fibonacci_sphere(n):
    i = np.arange(n)
    z = 1.0 - (2 * i + 1) / n
    angle, rho = i * np.pi * (3.0 - np.sqrt(5.0)), np.sqrt(1.0 - z**2)
    return np.column_stack([rho * np.cos(angle), rho * np.sin(angle), z])


def sphere_blob(n):
    return 0.4 * np.sqrt(4.0 * np.pi / n)


@pytest.mark.parametrize(
    ("n", "drag", "torque"),
    [(200, 1.00670, 1.03765), (400, 1.00431, 1.02649), (800, 1.00277, 1.01868)],
)
def test_sphere(n, drag, torque):
    """Resistance over Stokes' 6 pi mu a U and 8 pi mu a^3 W."""
    points = fibonacci_sphere(n)
    force = resistance(points, sphere_blob(n), Z).sum(axis=0)
    turning = resistance(points, sphere_blob(n), spin_about(Z, points))
    couple = np.cross(points, turning).sum(axis=0)
    # Half a unit of the last digit given.
    assert force[2] / (6.0 * np.pi) == pytest.approx(drag, abs=0.5e-5)
    assert couple[2] / (8.0 * np.pi) == pytest.approx(torque, abs=0.5e-5)


def test_sphere_tends_to_stokes():
    """The error of the drag falls with the size of the blobs, which falls as 1/sqrt(N)."""
    errors = []
    for n in (200, 800):
        points = fibonacci_sphere(n)
        errors.append(resistance(points, sphere_blob(n), Z).sum(axis=0)[2] / (6.0 * np.pi) - 1.0)
    # Four times as many points are blobs of half the size; the blob's own error is of order 1 to 2.
    assert 1.0 <= np.log2(errors[0] / errors[1]) <= 2.0


def array_drag(n, fraction):
    """Return the drag of a cubic array of spheres, over 6 pi mu a U, with a the radius by drag.

    U is the velocity relative to the mean of the whole cell, spheres and fluid.
    """
    points, epsilon = fibonacci_sphere(n), sphere_blob(n)
    radius = resistance(points, epsilon, Z)[:, 2].sum() / (6.0 * np.pi)
    edge = radius * (4.0 * np.pi / (3.0 * fraction)) ** (1.0 / 3.0)
    forces = resistance(points, epsilon, Z, EWALD, Periodic((edge, edge, edge)))
    return forces[:, 2].sum() / (6.0 * np.pi * radius)


def test_a_dilute_array_of_spheres_is_hasimotos():
    """H. Hasimoto (J. Fluid Mech. 5, 1959), to the square of the fraction c.

    How the blobs fill the sphere shows in its next images only, which are some 1e-4.
    """
    c = 1e-3
    expected = 1.0 / (1.0 - 1.7601 * c ** (1.0 / 3.0) + c - 1.5593 * c**2)
    assert array_drag(200, c) == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize(
    ("fraction", "drag", "within"),
    [(0.027, 2.008, 5e-4), (0.064, 2.810, 1e-3), (0.125, 4.292, 3e-3)],
)
def test_an_array_of_spheres(fraction, drag, within):
    """A. A. Zick & G. M. Homsy (J. Fluid Mech. 115, 1982), table 2, to four digits.

    The error falls with the size of the blobs. The value for none, by the parabola through three
    sizes, leaves terms of third order, which grow as gaps between spheres narrow.
    """
    counts = np.array([100, 200, 400])
    values = np.array([array_drag(n, fraction) for n in counts])
    errors = np.abs(values / drag - 1.0)
    assert (errors[1:] < 0.8 * errors[:-1]).all()
    without = np.polyfit(counts**-0.5, values, 2)[-1]
    assert without == pytest.approx(drag, rel=within)


@pytest.mark.parametrize(
    ("p", "parallel", "normal", "rotation"),
    [(20, 2.292, 3.389, 0.4688), (50, 1.713, 2.689, 0.3253), (100, 1.434, 2.329, 0.2640)],
)
def test_straight_rod(p, parallel, normal, rotation):
    """In units of mu L U and mu L^3 W, L = 1; p = L / 2a."""
    epsilon = THICK / (2.0 * p)
    n = int(1.0 / (0.3 * epsilon))
    points = np.zeros((n, 3))
    points[:, 2] = (np.arange(n) + 0.5) / n - 0.5
    along = resistance(points, epsilon, Z).sum(axis=0)[2]
    across = resistance(points, epsilon, X).sum(axis=0)[0]
    turning = resistance(points, epsilon, spin_about(X, points))
    couple = np.cross(points, turning).sum(axis=0)[0]
    # One unit of the last digit given: 0.3 eps does not divide L, and one node more or less (81
    # instead of 80 for p = 20) changes the rotation by four such units, the others by half a one.
    assert along == pytest.approx(parallel, abs=1e-3)
    assert across == pytest.approx(normal, abs=1e-3)
    assert couple == pytest.approx(rotation, abs=1e-4)


def helix(pitch, length, a):
    """Return a right-handed helix of radius 1, nodes 0.6 eps apart, and its epsilon.

    Nodes 0.3 eps apart give the same to 1e-3 and take minutes.
    """
    epsilon, k = THICK * a, 2.0 * np.pi / pitch
    n = round(length * np.hypot(1.0, k) / (0.6 * epsilon))
    z = (np.arange(n) + 0.5) / n * length
    return np.column_stack([np.cos(k * z), np.sin(k * z), z]), epsilon


@pytest.mark.parametrize(
    ("pitch", "thrust", "torque", "drag"), [(10, 12.094, 90.80, 42.81), (8, 13.178, 95.797, 45.917)]
)
def test_rigid_helix(pitch, thrust, torque, drag):
    """Within 2 % of Rodenborn et al. (2013), whose program has other blobs along the helix."""
    points, epsilon = helix(pitch, 30.8, 0.04)
    turning = resistance(points, epsilon, spin_about(Z, points))
    pulled = resistance(points, epsilon, Z)
    # A right-handed helix that turns about +z pushes the fluid to -z.
    assert turning.sum(axis=0)[2] == pytest.approx(-thrust, rel=0.02)
    assert np.cross(points, turning).sum(axis=0)[2] == pytest.approx(torque, rel=0.02)
    assert pulled.sum(axis=0)[2] == pytest.approx(drag, rel=0.02)
    # Reciprocity: the couple on a helix that is pulled is the thrust of one that turns. 1e-5: the
    # residual of either solution, here times forces that are not its own, times 40.
    couple = np.cross(points, pulled).sum(axis=0)[2]
    assert couple == pytest.approx(turning.sum(axis=0)[2], rel=1e-5)


@pytest.mark.parametrize(
    ("pitch", "thrust"),
    [(2.226, 6.26), (3.677, 9.60), (6.509, 11.03), (9.811, 9.57), (15.241, 7.84)],
)
def test_helix_in_experiment(pitch, thrust):
    """Within 12 % of the experiment of Rodenborn et al. (2013): 6.3 mm by 130 mm, a = R/16."""
    points, epsilon = helix(pitch, 130.0 / 6.3, 1.0 / 16.0)
    force = resistance(points, epsilon, spin_about(Z, points)).sum(axis=0)
    assert -force[2] == pytest.approx(thrust, rel=0.12)


@pytest.mark.parametrize(("distance", "factor"), [(4.0, 0.7423), (6.0, 0.8047), (10.0, 0.8706)])
def test_two_spheres(distance, factor):
    """Stimson & Jeffery: two spheres that follow each other along their line of centres."""
    n = 400
    one = fibonacci_sphere(n)
    two = np.concatenate([one, one + distance * Z])
    alone = resistance(one, sphere_blob(n), Z).sum(axis=0)[2]
    together = resistance(two, sphere_blob(n), Z)
    # Spheres of 400 blobs have the drag of ones that are 0.0043 larger. The factor, about
    # 1 - 3a/2d, then changes by 0.0043 a d(factor)/da: between 4e-4 and 1.2e-3 here.
    larger = 0.0043 * 1.5 / distance
    assert together[:n].sum(axis=0)[2] / alone == pytest.approx(factor, abs=larger)
    # The other sphere sees the same; its points are not the mirror image: 1e-3 of a drag is a
    # quarter of what replacing a sphere by 400 blobs does.
    assert together[n:].sum(axis=0)[2] == pytest.approx(together[:n].sum(axis=0)[2], rel=1e-3)
