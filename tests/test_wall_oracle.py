"""The oracle of the no-slip wall is right by itself: physics.md 3, and Blake (1971)."""

import numpy as np
import pytest

from tests.cases import wall_oracle

EPSILON, MU = 0.2, 0.7
STEP = 1e-30  # of complex steps: what they leave out is its square
LEVI_CIVITA = np.zeros((3, 3, 3))
LEVI_CIVITA[[0, 1, 2], [1, 2, 0], [2, 0, 1]] = 1.0
LEVI_CIVITA[[0, 1, 2], [2, 0, 1], [1, 2, 0]] = -1.0
FORCE, TORQUE = slice(0, 3), slice(3, 6)
each_load = pytest.mark.parametrize("columns", [FORCE, TORQUE], ids=["force", "torque"])


def case(columns=slice(0, 6), lift=0.0):
    """Return targets and sources in a cube on the wall, and loads of which `columns` act."""
    rng = np.random.default_rng(0)
    targets, sources = rng.random((20, 3)), rng.random((8, 3))
    sources[:, 2] += lift
    loads = np.zeros((8, 6))
    loads[:, columns] = rng.uniform(-1.0, 1.0, (8, 6))[:, columns]
    return targets, sources, loads


def gradient(field, x):
    """Return d field_c / dx_d by complex steps, axes d, point, c."""
    return np.array([field(x + 1j * STEP * axis).imag / STEP for axis in np.eye(3)])


def scaled(matrix):
    """Scale to a unit diagonal: torques move particles eps^-2 times more than forces."""
    scale = 1.0 / np.sqrt(np.diag(matrix))
    return scale[:, None] * matrix * scale


@each_load
def test_nothing_moves_on_the_wall(columns):
    """There the fluid neither flows nor turns about the normal; it turns about the other axes."""
    targets, sources, loads = case(columns)
    motion = wall_oracle.flow(targets * [1.0, 1.0, 0.0], sources, loads, EPSILON)
    above = wall_oracle.flow(targets, sources, loads, EPSILON)
    assert np.abs(motion[:, :3]).max() <= 1e-14 * np.abs(above[:, :3]).max()
    assert np.abs(motion[:, 5]).max() <= 1e-14 * np.abs(above[:, 5]).max()
    assert (np.abs(motion[:, 3:5]).max(axis=0) > 0.1 * np.abs(above[:, 3:5]).max()).all()


@each_load
def test_no_divergence_and_half_the_curl(columns):
    """In the blobs too: div u = 0 and w = 1/2 curl u."""
    targets, sources, loads = case(columns)
    slope = gradient(lambda x: wall_oracle.flow(x, sources, loads, EPSILON)[:, :3], targets)
    w = wall_oracle.flow(targets, sources, loads, EPSILON)[:, 3:]
    scale = np.abs(slope).max()
    assert np.abs(np.einsum("dmd->m", slope)).max() <= 1e-13 * scale
    half_curl = 0.5 * np.einsum("cde,dme->mc", LEVI_CIVITA, slope)
    np.testing.assert_allclose(half_curl, w, rtol=0, atol=1e-13 * scale)


def test_the_matrix_is_that_of_the_flow():
    targets, sources, loads = case()
    matrix = wall_oracle.mobility(targets, sources, EPSILON, MU)
    motion = wall_oracle.flow(targets, sources, loads, EPSILON, MU)
    by_matrix = (matrix @ loads.ravel()).reshape(motion.shape)
    np.testing.assert_allclose(by_matrix, motion, rtol=0, atol=1e-14 * np.abs(motion).max())


def test_the_mobility_is_symmetric():
    """At any height: Lorentz reciprocity of forces and torques with velocities of both kinds."""
    _, sources, _ = case()
    matrix = scaled(wall_oracle.mobility(sources, sources, EPSILON))
    np.testing.assert_allclose(matrix, matrix.T, rtol=0, atol=1e-14)


def test_the_mobility_is_positive_definite():
    """Of points half an epsilon and more above the wall."""
    _, sources, _ = case(lift=0.5 * EPSILON)
    matrix = scaled(wall_oracle.mobility(sources, sources, EPSILON))
    assert np.linalg.eigvalsh(matrix).min() > 1e-3


@pytest.mark.parametrize(("height", "definite"), [(0.18, True), (0.16, False)])
def test_torques_within_their_blob_of_the_wall(height, definite):
    """Images of blobs keep the symmetry, not the sign: one point loses it at 0.1714 epsilon."""
    point = np.array([[0.3, -0.2, height * EPSILON]])
    matrix = wall_oracle.mobility(point, point, EPSILON)
    assert (np.linalg.eigvalsh(scaled(matrix)).min() > 0.0) == definite
    assert np.linalg.eigvalsh(matrix[:3, :3]).min() > 0.0


def test_self_mobility():
    """At a height of 5, epsilon 0.23, over 1 / (4 pi mu epsilon) of free space (physics.md 3)."""
    point = np.array([[1.0, 2.0, 5.0]])
    matrix = wall_oracle.mobility(point, point, 0.23, MU)
    relative = np.diag(matrix)[:3] * 4.0 * np.pi * MU * 0.23
    # Half a unit of the last digit given.
    np.testing.assert_allclose(relative, [0.98276, 0.98276, 0.96552], rtol=0, atol=0.5e-5)


def test_blake_on_the_wall_and_reciprocity():
    targets, sources, loads = case()
    forces = loads[:, :3]
    above = wall_oracle.blake(targets, sources, forces)
    on_wall = wall_oracle.blake(targets * [1.0, 1.0, 0.0], sources, forces)
    assert np.abs(on_wall).max() <= 1e-13 * np.abs(above).max()
    others = np.random.default_rng(1).uniform(-1.0, 1.0, targets.shape)
    back = wall_oracle.blake(sources, targets, others)
    work = others * above
    assert abs(work.sum() - (forces * back).sum()) <= 1e-13 * np.abs(work).sum()


def blake_of(columns, targets, sources, loads):
    """Return 8 pi mu u of Blake's forces, or of torques: half the curl of their density."""
    if columns == FORCE:
        return wall_oracle.blake(targets, sources, loads[:, :3])
    # Of a torque n_k these are dipoles, forces 1/2 eps_jek n_k whose points move along j.
    pairs = zip(np.eye(3), np.einsum("jek,nk->jne", LEVI_CIVITA, loads[:, 3:]), strict=True)
    flows = [wall_oracle.blake(targets, sources + 1j * STEP * axis, f) for axis, f in pairs]
    return 0.5 * np.sum(flows, axis=0).imag / STEP


@each_load
def test_points_are_the_limit_of_blobs(columns):
    """The flow over the wall tends to that of Blake's images as epsilon^2."""
    targets, sources, loads = case(columns, lift=1.0)
    targets[:, 0] += 3.0
    limit = blake_of(columns, targets, sources, loads)

    def error(epsilon):
        u = 8.0 * np.pi * wall_oracle.flow(targets, sources, loads, epsilon)[:, :3]
        return np.linalg.norm(u - limit) / np.linalg.norm(limit)

    errors = np.array([error(epsilon) for epsilon in (0.08, 0.04, 0.02)])
    # The next term is a relative eps^2/r^2 of the first, r some 2 to 3.
    np.testing.assert_allclose(np.log2(errors[:-1] / errors[1:]), 2.0, atol=0.01)
    assert error(1e-8) <= 1e-13
