"""Pictures show what there is, and films keep their scale."""

import ctypes
import sys

import imageio.v3 as iio
import numpy as np
import pytest

from mrs.output import render as module
from mrs.output import vtkhdf
from mrs.output.render import render
from mrs.output.vtkhdf import Topology, Trajectory

SIZE = (320, 200)


def rods(directory, frames=3, name="rods"):
    """Write four upright rods that lean over, faster and faster, with radius."""
    n, z = 20, np.linspace(0, 1, 20)
    lines = list(np.arange(4 * n).reshape(4, n))
    at_points = {"radius": np.full(4 * n, 0.05)}
    at_cells = {"rod_id": np.arange(4)}
    path = directory / f"{name}.vtkhdf"
    vtkhdf.create(path, Topology(np.empty(0, int), lines), at_points, at_cells, {"kind": "rods"})
    foot = np.repeat([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], n, axis=0)
    for i in range(frames):
        lean = np.stack([0.3 * i * z, 0 * z, z], axis=1)
        speed = np.stack([(1 + i) * z, 0 * z, 0 * z], axis=1)
        arrays = {"velocity": np.tile(speed, (4, 1)), "arclength": np.tile(z, 4)}
        vtkhdf.append(path, 0.5 * i, foot + np.tile(lean, (4, 1)), arrays)


def swimmers(directory, arrays=True):
    """Write three swimmers, one frame."""
    path = directory / "swimmers.vtkhdf"
    topology = Topology(np.arange(6), [np.array([i, i + 3]) for i in range(3)])
    radius = {"radius": np.full(6, 0.1)} if arrays else {}
    vtkhdf.create(path, topology, radius, {}, {"kind": "swimmers"})
    head = np.array([[0.0, 0, 0], [2, 0, 0], [0, 2, 1]])
    orientation = {"orientation": np.tile([1.0, 0, 0], (6, 1))} if arrays else {}
    vtkhdf.append(path, 0.0, np.concatenate([head, head - [0.5, 0, 0]]), orientation)


def tracers(directory):
    """Write a cloud of tracers, one frame."""
    path = directory / "tracers.vtkhdf"
    vtkhdf.create(path, Topology(np.arange(50), []), meta={"kind": "tracers"})
    vtkhdf.append(path, 0.0, np.random.default_rng(0).random((50, 3)))


def pixels(path):
    return iio.imread(path)[..., :3].astype(int)


def colorful(image):
    """Pixels that are neither background, nor ink, nor between the two."""
    return (np.ptp(image, axis=-1) > 40).sum()


def test_rods(tmp_path):
    rods(tmp_path)
    assert render(tmp_path, tmp_path / "a.png", size=SIZE) == tmp_path / "a.png"
    image = pixels(tmp_path / "a.png")
    assert image.shape == (200, 320, 3)
    assert (image[0, 0] == 255).all()
    assert len(np.unique(image.reshape(-1, 3), axis=0)) > 200
    above_bar = image[:160]
    assert colorful(above_bar) > 1000
    assert colorful(above_bar[:, :80]) < colorful(above_bar[:, 80:240])


def test_frames_differ_and_the_last_is_the_default(tmp_path):
    rods(tmp_path)
    for name, options in {"first": {"frame": 0}, "last": {"frame": 2}, "default": {}}.items():
        render(tmp_path, tmp_path / f"{name}.png", size=SIZE, **options)
    images = {name: pixels(tmp_path / f"{name}.png") for name in ("first", "last", "default")}
    assert (images["last"] == images["default"]).all()
    assert (images["first"] != images["last"]).any()


@pytest.mark.parametrize("color_by", ["arclength", "rod_id", "velocity"])
def test_color_by(tmp_path, color_by):
    """At points, at cells, and vectors; the bar spans the range."""
    rods(tmp_path)
    render(tmp_path, tmp_path / "a.png", color_by=color_by, size=SIZE)
    assert colorful(pixels(tmp_path / "a.png")[:160]) > 1000
    with Trajectory(tmp_path / "rods.vtkhdf") as body:
        colors = module._colors([body], [0, 1, 2], color_by)
    assert colors.range == {"arclength": (0, 1), "rod_id": (0, 3), "velocity": (0, 3)}[color_by]


def test_bodies_of_all_kinds(tmp_path):
    swimmers(tmp_path)
    tracers(tmp_path)
    render(tmp_path, tmp_path / "a.png", size=SIZE)
    image = pixels(tmp_path / "a.png")
    red = (image[..., 0] - image[..., 2] > 60).sum()  # swimmers have a colour of their own
    assert red > 100
    rods(tmp_path, frames=1)
    render(tmp_path, tmp_path / "b.png", size=SIZE)
    assert (pixels(tmp_path / "b.png") != image).any()


def test_without_radius_and_orientation(tmp_path):
    swimmers(tmp_path, arrays=False)
    path = tmp_path / "fibres.vtkhdf"
    vtkhdf.create(path, Topology(np.empty(0, int), [np.arange(3)]), meta={"kind": "rods"})
    vtkhdf.append(path, 0.0, np.eye(3))
    render(tmp_path, tmp_path / "a.png", size=SIZE)
    assert colorful(pixels(tmp_path / "a.png")) > 300


@pytest.mark.parametrize("suffix", ["mp4", "gif"])
def test_film(tmp_path, suffix):
    rods(tmp_path)
    path = render(tmp_path, tmp_path / f"new folder/a.{suffix}", size=SIZE)
    images = iio.imread(path)[..., :3].astype(int)
    assert images.shape == (3, 200, 320, 3)
    assert all(colorful(image[:160]) > 1000 for image in images)
    assert np.abs(images[0] - images[2]).max() > 100
    bars = images[:, 184:, 120:200]  # the same range of colours, and so the same bar
    assert np.abs(bars[0] - bars[2]).mean() < 5  # a .gif has a palette for each frame


def test_camera(tmp_path):
    rods(tmp_path, frames=1)
    away = [(100, 0, 0), (200, 0, 0), (0, 0, 1)]
    render(tmp_path, tmp_path / "a.png", camera=away, size=SIZE)
    assert colorful(pixels(tmp_path / "a.png")[:160]) == 0
    near = [(0.5, -4, 0.5), (0.5, 0, 0.5), (0, 0, 1)]
    render(tmp_path, tmp_path / "b.png", camera=near, size=SIZE)
    assert colorful(pixels(tmp_path / "b.png")[:160]) > 1000


def test_everything_is_in_the_picture():
    """The camera sees all points, and they reach the rim one way or the other."""
    rng = np.random.default_rng(0)
    towards = np.array([0.6, -0.64, 0.48])
    right = np.cross((0, 0, 1), towards)
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(towards, right)])
    slopes = np.array([0.4, 0.25])
    for scale in ([1, 1, 1], [10, 1, 0.1], [0.01, 0.01, 3], [1e-6, 1e-6, 1e-6]):
        points = rng.random((500, 3)) * scale + 5
        center, distance = module._fit(points, towards, slopes, 0.0)
        ahead = distance - (points - center) @ towards
        rim = np.abs((points - center) @ axes.T / ahead[:, None]) / slopes
        assert rim.max() < 1.02
        assert rim.max() > 0.9


def test_dark_background(tmp_path):
    rods(tmp_path, frames=1)
    render(tmp_path, tmp_path / "a.png", background="#101010", size=SIZE)
    image = pixels(tmp_path / "a.png")
    assert (image[0, 0] < 30).all()
    assert (image[160:].min(axis=-1) > 150).any()  # light ink


def test_refusals(tmp_path):
    with pytest.raises(FileNotFoundError, match="no trajectories"):
        render(tmp_path, tmp_path / "a.png")
    rods(tmp_path, frames=0)
    with pytest.raises(IndexError, match="no frames"):
        render(tmp_path, tmp_path / "a.png")
    rods(tmp_path, name="others")
    (tmp_path / "rods.vtkhdf").unlink()
    with pytest.raises(IndexError, match="3 frames"):
        render(tmp_path, tmp_path / "a.png", frame=3)
    with pytest.raises(ValueError, match=r"\.jpg"):
        render(tmp_path, tmp_path / "a.jpg")
    with pytest.raises(ValueError, match="one frame"):
        render(tmp_path, tmp_path / "a.png", frame="all")
    with pytest.raises(ValueError, match="all frames"):
        render(tmp_path, tmp_path / "a.gif", frame=1)
    with pytest.raises(ValueError, match="arclength, radius, rod_id, velocity, got 'tension'"):
        render(tmp_path, tmp_path / "a.png", color_by="tension")
    assert not (tmp_path / "a.png").exists()


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="elsewhere there is a library")
def test_no_library_to_draw_with(tmp_path, monkeypatch):
    def missing(name):
        raise OSError(f"{name}: cannot open shared object file")

    rods(tmp_path, frames=1)
    monkeypatch.setattr(ctypes, "CDLL", missing)
    monkeypatch.delenv("DISPLAY", raising=False)
    with pytest.raises(RuntimeError, match="libegl1 libgl1"):
        render(tmp_path, tmp_path / "a.png")
