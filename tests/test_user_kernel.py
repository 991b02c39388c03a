"""A kernel in a file of the user's own: the Rotne-Prager-Yamakawa tensor."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

import treecode as tc
from tests.cases import rotne_prager
from tests.cases.rotne_prager import RotnePrager
from treecode.choice import search

RADIUS, VISCOSITY = 0.07, 1.3
KERNEL = RotnePrager(RADIUS, VISCOSITY)


def mobility(points):
    """The tensor from its definition by overlapping and separate spheres (Wajnryb et al. 2013)."""
    n, a = len(points), RADIUS
    out = np.empty((n, 3, n, 3))
    for i in range(n):
        for j in range(n):
            d = points[i] - points[j]
            r = np.linalg.norm(d)
            rr = np.outer(d, d) / r**2 if r > 0 else np.zeros((3, 3))
            if r > 2 * a:
                tensor = (1 + 2 * a**2 / (3 * r**2)) * np.eye(3) + (1 - 2 * a**2 / r**2) * rr
                out[i, :, j] = tensor / (8 * np.pi * VISCOSITY * r)
            else:
                tensor = (1 - 9 * r / (32 * a)) * np.eye(3) + 3 * r / (32 * a) * rr
                out[i, :, j] = tensor / (6 * np.pi * VISCOSITY * a)
    return out.reshape(3 * n, 3 * n)


@pytest.mark.interpreted
def test_direct_equals_the_tensor():
    points = np.random.default_rng(0).random((40, 3)) * 0.5
    forces = np.random.default_rng(1).standard_normal((40, 3))
    exact = (mobility(points) @ forces.ravel()).reshape(-1, 3)
    assert tc.relative_error(tc.evaluate(KERNEL, points, forces, backend="direct"), exact) < 1e-14


def test_mobility_is_positive_definite():
    points = np.random.default_rng(2).random((30, 3)) * 0.4
    matrix = np.empty((90, 90))
    plan = tc.Plan(KERNEL, "direct").set_points(points)
    for column, unit in enumerate(np.eye(90)):
        matrix[:, column] = plan.execute(unit.reshape(30, 3)).ravel()
    assert np.abs(matrix - matrix.T).max() < 1e-15 * np.abs(matrix).max()
    assert np.linalg.eigvalsh(matrix).min() > 0


def test_kitc_converges():
    """Two degrees more divide the error at least by 1/theta^2."""
    rng = np.random.default_rng(3)
    points, forces = rng.random((3000, 3)), rng.standard_normal((3000, 3))
    exact = tc.evaluate(KERNEL, points, forces, backend="direct")
    errors = []
    for degree in (1, 3, 5, 7):
        plan = tc.Plan(KERNEL, "kitc", theta=0.5, degree=degree, leaf_size=40).set_points(points)
        errors.append(tc.relative_error(plan.execute(forces), exact))
        assert degree > 5 or plan.info()["far_pairs"] > 0
    assert np.all(np.diff(np.log(errors)) < np.log(0.25))


def test_taylor_says_what_is_missing():
    with pytest.raises(TypeError, match=r"taylor.*RotnePrager.*kitc"):
        tc.Plan(KERNEL, "taylor")


class Plain(NamedTuple):
    """Without units."""

    strength_size = weight_size = value_size = 3

    def weights(self, q):
        return q

    def pair(self, dx, dy, dz, w, acc):
        return acc


@pytest.mark.parametrize("lengths", [None, (1, 1), (1, 1, 1, 1), 1])
@pytest.mark.parametrize("backend", ["auto", "direct", "fmm"])
def test_units_of_values_are_asked_for(backend, lengths):
    """One norm over velocities and angular velocities would hide one of them."""
    kind = type("Two", (Plain,), {} if lengths is None else {"value_lengths": lengths})
    with pytest.raises(TypeError, match=r"must have value_lengths, a tuple of 3.*\(1, 1, 1\).*got"):
        tc.Plan(kind(), backend)


class TwoUnits(RotnePrager):
    """Velocities, and the same a thousandth as large in another unit."""

    value_size = 6
    value_lengths = (1, 1, 1, 2, 2, 2)

    def pair(self, dx, dy, dz, w, acc):
        s = tc.inverse_sqrt(1e-4 + dx * dx + dy * dy + dz * dz)
        t = 1e-3 * s * s * s
        return (
            acc[0] + s * w[0],
            acc[1] + s * w[1],
            acc[2] + s * w[2],
            acc[3] + t * (w[1] * dz - w[2] * dy),
            acc[4] + t * (w[2] * dx - w[0] * dz),
            acc[5] + t * (w[0] * dy - w[1] * dx),
        )


def test_each_unit_of_a_user_kernel_keeps_the_tolerance(monkeypatch):
    monkeypatch.setattr(search, "FEW", 0)
    rng = np.random.default_rng(4)
    points, forces = rng.random((3000, 3)), rng.standard_normal((3000, 3))
    kernel = TwoUnits(0.01, 1.0)
    values = tc.evaluate(kernel, points, forces, tol=1e-3)
    exact = tc.evaluate(kernel, points, forces, backend="direct")
    for unit in (slice(0, 3), slice(3, 6)):
        assert 0.0 < tc.relative_error(values[:, unit], exact[:, unit]) <= 1e-3


def test_page_shows_the_tested_file():
    page = Path(__file__).parents[1] / "docs" / "add-a-kernel.md"
    source = Path(rotne_prager.__file__).read_text()
    assert f"```python\n{source}```" in page.read_text()
