"""Grids around bodies, seeds in them, and streamlines: geometry, units and files."""

import numpy as np
import pytest
import pyvista as pv

from mrs.output import field


def turning(points):
    """A rigid rotation about z, and nothing else."""
    return np.cross([0.0, 0.0, 1.0], points)


@pytest.mark.parametrize("count", [1, 2, 3, 7])
@pytest.mark.parametrize("size", [(4.0, 2.0, 1.0), (1.0, 1.0, 0.0), (0.0, 0.0, 5.0), (0, 0, 0)])
def test_seeds_are_inside_of_the_box(count, size):
    corners = 7.0 + np.array([np.zeros(3), size])
    seeds = field.seeds_in(corners, count)
    rim = np.minimum(seeds - corners[0], corners[1] - seeds)
    assert (rim[:, np.array(size) > 0] > 0).all()
    assert (rim[:, np.array(size) == 0] == 0).all()
    longest = np.argmax(size)
    assert len(np.unique(seeds[:, longest])) == (count if max(size) else 1)
    assert len(np.unique(seeds, axis=0)) == len(seeds)


def test_grid_holds_the_points():
    points = np.random.default_rng(0).random((50, 3)) * [4, 2, 1] + 7
    for resolution in (2, 21):
        grid = field.grid_around(points, resolution)
        nodes = grid.points
        assert nodes.shape == (np.prod(grid.dimensions), 3)
        size = points.max(axis=0) - points.min(axis=0)
        room = 0.2 * size.max()
        assert (nodes.min(axis=0) <= points.min(axis=0) - room + 1e-9).all()
        assert (nodes.max(axis=0) >= points.max(axis=0) + room - 1e-9).all()
        assert max(grid.dimensions) == resolution
        steps = [np.diff(np.unique(nodes[:, k].round(9))) for k in range(3)]
        np.testing.assert_allclose(np.concatenate(steps), grid.spacing, rtol=1e-6)


@pytest.mark.parametrize(
    ("points", "resolution", "message"),
    [
        (np.zeros((0, 3)), 5, r"points must have shape \(n, 3\)"),
        (np.ones((2, 3)), 5, "points must not coincide"),
        (np.eye(3), 1, "resolution must be at least 2, got 1"),
    ],
)
def test_grid_refuses(points, resolution, message):
    with pytest.raises(ValueError, match=message):
        field.grid_around(points, resolution)


def test_field_reads_back(tmp_path):
    grid = field.grid_around(np.eye(3), 5)
    velocity = turning(grid.points)
    arrays = {"velocity": velocity, "speed": np.linalg.norm(velocity, axis=1)}
    field.write_grid(tmp_path / "a.vti", grid, arrays, {"time": 0.1})
    image = pv.read(tmp_path / "a.vti")
    np.testing.assert_allclose(image.points, grid.points)
    for name, array in arrays.items():
        np.testing.assert_array_equal(image[name], array)
    assert image.field_data["time"] == [0.1]
    with pytest.raises(ValueError, match="velocity must have a row for each of 125 points"):
        field.write_grid(tmp_path / "b.vti", grid, {"velocity": np.zeros((3, 3))})


def test_streamlines_of_a_rotation_are_circles(tmp_path):
    corners = np.array([[-1.0, -1, -0.2], [1, 1, 0.2]])
    grid = field.grid_around(corners, 15)
    seeds = np.array([[0.3, 0, 0], [0, 0.6, 0.1]])
    field.streamlines(tmp_path / "a.vtp", grid, turning(grid.points), seeds)
    lines = pv.read(tmp_path / "a.vtp")
    radius = np.linalg.norm(lines.points[:, :2], axis=1)
    assert np.minimum(abs(radius - 0.3), abs(radius - 0.6)).max() < 1e-6
    np.testing.assert_allclose(lines["speed"], radius, rtol=1e-5)
    assert lines.n_lines >= 2
    angle = np.arctan2(lines.points[:, 1], lines.points[:, 0]) - np.where(
        radius < 0.45, 0, np.pi / 2
    )
    np.testing.assert_allclose(np.exp(1j * angle), np.exp(1j * lines["IntegrationTime"]), atol=1e-5)


def test_streamlines_do_not_depend_on_units(tmp_path):
    """Bit by bit, in units that are powers of two, from micrometres to megametres."""
    corners = np.array([[-1.0, -1, -0.2], [1, 1, 0.2]])
    seeds = np.random.default_rng(0).uniform(-0.5, 0.5, (20, 3)) * [1, 1, 0.2]

    def lines_in(length, duration):
        grid = field.grid_around(length * corners, 15)
        x = grid.points / length
        u = np.stack([x[:, 1], -x[:, 0] + 0.3 * x[:, 2], 0.1 * np.sin(5 * x[:, 0])], axis=1)
        field.streamlines(tmp_path / "a.vtp", grid, u * length / duration, length * seeds)
        return pv.read(tmp_path / "a.vtp")

    one = lines_in(1.0, 1.0)
    assert one.n_lines == 40
    for length in (2.0**-20, 2.0**20):
        for duration in (2.0**-20, 2.0**20):
            other = lines_in(length, duration)
            np.testing.assert_array_equal(other.lines, one.lines)
            np.testing.assert_array_equal(other.points / length, one.points)
            unit = {"IntegrationTime": duration}
            for name in ("velocity", "speed", "IntegrationTime"):
                scaled = other[name] / unit.get(name, length / duration)
                np.testing.assert_array_equal(scaled, one[name])


def test_no_streamlines_are_explained(tmp_path):
    grid = field.grid_around(np.eye(3), 5)
    rest = np.zeros((len(grid.points), 3))
    with pytest.warns(UserWarning, match="no streamlines through 3 seeds: the fluid is at rest"):
        field.streamlines(tmp_path / "a.vtp", grid, rest, np.eye(3) / 2)
    assert pv.read(tmp_path / "a.vtp").n_lines == 0
    with pytest.warns(UserWarning, match="they leave the grid at once"):
        field.streamlines(tmp_path / "a.vtp", grid, rest + 1.0, [[1e3, 0, 0]])
