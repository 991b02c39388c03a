"""A kernel in a file of the user's own: the Rotne-Prager-Yamakawa tensor."""

from pathlib import Path

import numpy as np
import pytest

import treecode as tc
from tests.cases import rotne_prager
from tests.cases.rotne_prager import RotnePrager

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


def test_page_shows_the_tested_file():
    page = Path(__file__).parents[1] / "docs" / "add-a-kernel.md"
    source = Path(rotne_prager.__file__).read_text()
    assert f"```python\n{source}```" in page.read_text()
