"""What pictures show beside the bodies: a bar of known length, trails, given colours, no paper."""

import imageio.v3 as iio
import numpy as np
import pytest
from PIL import Image

from mrs.output import camera, colors, legend, vtkhdf
from mrs.output.render import render
from mrs.output.topology import Topology
from mrs.output.trajectory import Trajectory
from mrs.run import cli

SIZE = (400, 240)
FRONT = [(0.0, -10.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 1.0)]  # x across, z up


def tracers(directory, frames, images=None, speed=None):
    """Write tracers at some places in each frame, (frames, n, 3)."""
    path = directory / "tracers.vtkhdf"
    vtkhdf.create(path, Topology(np.arange(len(frames[0])), []), meta={"kind": "tracers"})
    for i, points in enumerate(frames):
        arrays = {} if images is None else {"image": np.array(images[i])}
        if speed is not None:
            arrays["speed"] = np.full(len(points), speed[i])
        vtkhdf.append(path, 0.5 * i, np.array(points, float), arrays)
    return directory


def ink(path, rows=slice(None)):
    """Return the columns, of some rows of a picture, where something dark is drawn."""
    return np.flatnonzero((iio.imread(path)[rows, :, :3].min(axis=-1) < 190).any(axis=0))


def test_scale_bar(tmp_path):
    """As long as it says, beside tracers in the plane that the camera looks at."""
    apart = 4.0
    tracers(tmp_path, [[[-apart / 2, 0.0, 0.0], [apart / 2, 0.0, 0.0]]])
    path = render(tmp_path, tmp_path / "a.png", camera=FRONT, size=SIZE, scale_bar="mm")
    middle = ink(path, slice(110, 130))
    gap = np.flatnonzero(np.diff(middle) > 1)[0]
    first, second = middle[: gap + 1].mean(), middle[gap + 1 :].mean()
    bottom = ink(path, slice(200, 216))  # above the words
    stage = camera.Stage(np.zeros(3), apart, [np.array(p) / apart for p in FRONT], 0.0, SIZE, None)
    length, _ = legend.round_length(stage)
    assert length == 1.0
    bar = bottom[-1] - bottom[0] + 1
    assert bar == pytest.approx(length * (second - first) / apart, abs=1.5)  # pixels
    assert bottom[-1] > 0.9 * SIZE[0]
    with_words = ink(path, slice(216, 240))
    assert with_words[-1] - with_words[0] > 0.8 * SIZE[0], "the time on the left, 1 mm on the right"


@pytest.mark.parametrize("extent", [2.0**-60, 1e-3, 0.7, 1.0, 3e5])
def test_lengths_of_bars_are_round(extent):
    stage = camera.Stage(np.zeros(3), extent, FRONT, 0.0, SIZE, None)
    length, pixels = legend.round_length(stage)
    digits = f"{length:.12e}".split("e")[0].rstrip("0")
    assert digits in ("1.", "2.", "5.")
    assert 0.38 < pixels / (0.16 * SIZE[0]) <= 1.0  # two fifths at the least, from 2 to 5


def test_trails(tmp_path):
    """Through the frames before, and not across a box."""
    way = [[[-1.0 + 0.5 * i, 0.0, 0.0], [0.0, 0.0, -1.0]] for i in range(5)]
    images = [[[0, 0, 0], [0, 0, 0]]] * 3 + [[[1, 0, 0], [0, 0, 0]]] * 2
    for name, some in {"whole": None, "leaps": images}.items():
        (tmp_path / name).mkdir()
        tracers(tmp_path / name, way, some)
    seen = {}
    for name, trails in (("whole", 0), ("whole", 2), ("whole", 9), ("leaps", 9)):
        path = tmp_path / name / "a.png"
        render(tmp_path / name, path, camera=FRONT, size=SIZE, trails=trails)
        seen[name, trails] = len(ink(path, slice(110, 130)))
    unit = SIZE[1] / (20.0 * np.tan(np.radians(15.0)))  # pixels a length
    assert seen["whole", 0] < 15
    # A trail as long as the way in so many frames, and half a tracer.
    assert seen["whole", 2] == pytest.approx(1.0 * unit + 5, abs=4)
    assert seen["whole", 9] == pytest.approx(2.0 * unit + 5, abs=4)
    assert seen["leaps", 9] == pytest.approx(1.5 * unit + 5, abs=5)  # frames 2 to 3 are left out


def test_the_range_of_colours_is_given_or_that_of_all_frames(tmp_path):
    tracers(tmp_path, np.zeros((3, 1, 3)), speed=[1.0, 2.0, 3.0])
    with Trajectory(tmp_path / "tracers.vtkhdf") as body:
        frames = [[0], [1], [2]]
        assert colors.colors_of([body], frames, "speed").range == (1.0, 3.0)
        given = colors.colors_of([body], frames, "speed", (0.0, 2.5))
    assert given.range == (0.0, 2.5)
    assert given.title == "speed, up to 3"
    pictures = []
    for limits in ("1,3", "0,3"):
        options = ["--color-by", "speed", "--color-range", limits, "--frame", "0"]
        to = ["--output", str(tmp_path / "a.png"), "--size", "200,120"]
        assert cli.main(["render", str(tmp_path), *to, *options]) == 0
        pictures.append(iio.imread(tmp_path / "a.png").astype(int))
    assert np.abs(pictures[0] - pictures[1]).max() > 50


def test_no_paper(tmp_path):
    """A picture for print: transparent but for what is drawn, whose edges have its own colour."""
    tracers(tmp_path, [[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]])
    to = ["--output", str(tmp_path / "a.png"), "--size", "320,200"]
    assert cli.main(["render", str(tmp_path), *to, "--transparent", "--scale-bar"]) == 0
    with Image.open(tmp_path / "a.png") as image:
        assert image.mode == "RGBA"
        assert image.info["dpi"] == pytest.approx((300, 300), abs=0.01)
        pixels = np.asarray(image).astype(int)
    red, green, blue, opaque = np.moveaxis(pixels, -1, 0)
    assert (opaque == 0).mean() > 0.9
    edge = (opaque > 60) & (opaque < 200)
    assert edge.sum() > 10
    assert np.max([red, green, blue], axis=0)[edge].max() < 200, "not mixed with white"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"trails": -1}, "trails must be an integer from 0"),
        ({"color_range": (1.0, 1.0)}, "color_range must be a lower and a higher number"),
    ],
)
def test_refused(tmp_path, options, message):
    tracers(tmp_path, np.zeros((1, 1, 3)))
    with pytest.raises(ValueError, match=message):
        render(tmp_path, tmp_path / "a.png", **options)
    with pytest.raises(ValueError, match=r"transparent: only a .png can be, got 'a.gif'"):
        render(tmp_path, tmp_path / "a.gif", transparent=True)
