"""Pictures show what there is, and films keep their scale."""

import ctypes
import re
import subprocess
import sys

import h5py
import imageio.v3 as iio
import numpy as np
import pytest

import mrs
from mrs.output import camera, colors, vtkhdf
from mrs.output import render as module
from mrs.output.render import render
from mrs.output.stored import fluid_meta
from mrs.output.topology import Topology
from mrs.output.trajectory import Trajectory
from mrs.run import cli

SIZE = (320, 200)


def rods(directory, frames=3, name="rods", length=1.0, origin=0.0, wall=None):
    """Write four upright rods that lean over, faster and faster, with radius."""
    n, z = 17, np.linspace(0, 1, 17)
    lines = list(np.arange(4 * n).reshape(4, n))
    at_points = {"radius": np.full(4 * n, length / 16)}
    at_cells = {"rod_id": np.arange(4)}
    path = directory / f"{name}.vtkhdf"
    meta = {"kind": "rods"}
    if wall is not None:
        meta |= fluid_meta(mrs.Fluid(boundary=wall), tolerance=1e-4)
    vtkhdf.create(path, Topology(np.empty(0, int), lines), at_points, at_cells, meta)
    foot = np.repeat([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], n, axis=0)
    for i in range(frames):
        lean = np.stack([0.25 * i * z, 0 * z, z], axis=1)
        speed = np.stack([(1 + i) * z, 0 * z, 0 * z], axis=1)
        arrays = {"velocity": np.tile(speed, (4, 1)), "arclength": np.tile(z, 4)}
        points = length * (foot + np.tile(lean, (4, 1)) + origin)
        vtkhdf.append(path, 0.5 * i, points, arrays)


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
        found = colors.colors_of([body], [[0], [1], [2]], color_by)
    assert found.range == {"arclength": (0, 1), "rod_id": (0, 3), "velocity": (0, 3)}[color_by]


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


@pytest.mark.parametrize(
    ("typed", "frames"), [("1:", [1, 2]), (":-1", [0, 1]), ("::2", [0, 2]), ("2:0:-1", [2, 1])]
)
def test_frames_of_a_film(tmp_path, typed, frames):
    """As Python counts; every picture is that of its frame."""
    rods(tmp_path)
    drawn = []
    module_picture = module.picture

    def picture(bodies, places, *rest):
        drawn.append(places)
        return module_picture(bodies, places, *rest)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "picture", picture)
        path = str(tmp_path / "a.gif")
        size = ["--size", "64,64"]
        assert cli.main(["render", str(tmp_path), "--output", path, "--frame", typed, *size]) == 0
    assert drawn == [[i] for i in frames]
    assert len(iio.imread(path)) == len(frames)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--output", "a.mp4", "--frame", "1"], r"frame: \.mp4 holds a film: .* got 1\n"),
        (["--output", "a.png", "--frame", "0:2"], r"frame: \.png holds one frame: .* got 0:2\n"),
        (["--frame", "7"], r"frame: .* has 3 frames, none number 7"),
    ],
)
def test_a_frame_that_does_not_fit_is_refused_by_name(tmp_path, arguments, message, capsys):
    rods(tmp_path)
    output = [str(tmp_path / word) if word.startswith("a.") else word for word in arguments]
    assert cli.main(["render", str(tmp_path), *output]) == 1
    assert re.search(message, capsys.readouterr().err)
    assert [path.name for path in tmp_path.iterdir()] == ["rods.vtkhdf"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--frame", "a"], r"--frame: must be a number or a range such as 0:20, got 'a'"),
        (["--frame", "::0"], r"--frame: must be a number or a range such as 0:20, got '::0'"),
        (["--size", "a,b"], r"--size: must be two numbers from 16 to 10000, got 'a,b'"),
        (["--camera", "1,b"], r"--camera: must be nine numbers, got '1,b'"),
    ],
)
def test_what_the_command_line_refuses(arguments, message, capsys):
    with pytest.raises(SystemExit, match="2"):
        cli.main(["render", "run", *arguments])
    assert re.search(message, capsys.readouterr().err)


@pytest.mark.parametrize("error", [KeyboardInterrupt, OSError])
@pytest.mark.parametrize("suffix", ["mp4", "gif", "png"])
def test_what_is_interrupted_leaves_no_broken_file(tmp_path, error, suffix, capsys, monkeypatch):
    """A film that was there stays, and nobody is told to resume a run."""
    rods(tmp_path)
    drawn = []

    def picture(*arguments):
        drawn.append(arguments)
        if len(drawn) == 2 or suffix == "png":
            raise error("no more")
        return np.zeros((64, 64, 3), np.uint8)

    monkeypatch.setattr(module, "picture", picture)
    film = tmp_path / f"a.{suffix}"
    for before in ([], ["an earlier film"]):
        drawn.clear()
        for text in before:
            film.write_text(text)
        code = cli.main(["render", str(tmp_path), "--output", str(film)])
        assert code == (130 if error is KeyboardInterrupt else 1)
        assert [
            path.read_text() for path in tmp_path.glob("*a*") if path.suffix != ".vtkhdf"
        ] == before
        assert not list(tmp_path.glob(".*"))
        assert "resume" not in capsys.readouterr().err


@pytest.mark.skipif(sys.platform == "win32", reason="no limit of the size of files there")
@pytest.mark.parametrize("suffix", ["png", "gif", "mp4"])
def test_no_room_on_the_disk(tmp_path, suffix):
    """Said, and nothing is left that looks like a film; in a process of its own."""
    rods(tmp_path, frames=10)
    code = (
        "import resource, sys; from mrs.run import cli; "
        "resource.setrlimit(resource.RLIMIT_FSIZE, (4000, 4000)); sys.exit(cli.main(sys.argv[1:]))"
    )
    command = ["render", str(tmp_path), "--output", str(tmp_path / f"a.{suffix}")]
    done = subprocess.run([sys.executable, "-c", code, *command], capture_output=True, text=True)
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1].startswith("mrs: ")
    assert [path.name for path in tmp_path.iterdir()] == ["rods.vtkhdf"]


def test_a_transient_does_not_settle_the_colours():
    """What the first frames reach is said, and the others have all colours."""
    first = np.array([[0.0, 10.44], [0.0, 3.1], [0.0, 2.4], [0.0, 3.3], [0.0, 3.9]])
    assert colors._without_transient(first) == (0.0, 3.9)
    grows = np.array([[0.0, speed] for speed in range(1, 21)])
    assert colors._without_transient(grows) == (0.0, 20.0)
    signed = np.array([[-90.0, 1.0], [-2.0, 1.0], [-3.0, 2.0], [-2.5, 1.0]])
    assert colors._without_transient(signed) == (-3.0, 2.0)
    rarely = np.array([[0.0, 0.0]] * 9 + [[0.0, 1.0]])
    assert colors._without_transient(rarely) == (0.0, 1.0)
    assert colors._without_transient(first[:1]) == (0.0, 10.44)


def test_colours_of_a_film_with_a_transient(tmp_path):
    rods(tmp_path, frames=8)
    path = tmp_path / "rods.vtkhdf"
    with h5py.File(path, "r+") as file:
        file["VTKHDF/PointData/velocity"][:68] *= 100.0  # in frame 0
    with Trajectory(path) as body:
        film = colors.colors_of([body], [[i] for i in range(8)], None)
        assert film.range == (0.0, 8.0)
        assert film.title == "velocity (magnitude), up to 100"
        assert colors.colors_of([body], [[0]], None) == (
            "velocity", (0.0, 100.0), "velocity (magnitude)",
        )  # fmt: skip


@pytest.mark.parametrize(
    ("length", "origin"), [(2.0**-20, 0), (2.0**20, 0), (2.0**-70, 0), (2.0**70, 0), (1.0, 2.0**15)]
)
def test_pictures_do_not_depend_on_units_nor_on_the_origin(tmp_path, length, origin):
    """Not one pixel, from micrometres to megametres; singles hold the points exactly."""
    images = []
    for name, place in (("here", (1.0, 0.0)), ("there", (length, origin))):
        folder = tmp_path / name
        folder.mkdir()
        rods(folder, 1, "rods", *place)
        path = folder / "tracers.vtkhdf"
        vtkhdf.create(path, Topology(np.arange(8), []), meta={"kind": "tracers"})
        corners = np.stack(np.meshgrid(*[[0, 1]] * 3), axis=-1).reshape(-1, 3)
        vtkhdf.append(path, 0.0, place[0] * (corners + place[1]))
        render(folder, folder / "a.png", size=SIZE)
        images.append(pixels(folder / "a.png"))
    np.testing.assert_array_equal(*images)


def test_a_camera_far_from_the_origin(tmp_path):
    images = []
    for name, origin in (("here", 0.0), ("there", 2.0**15)):
        (tmp_path / name).mkdir()
        rods(tmp_path / name, 1, origin=origin)
        view = np.array([[0.5, -4, 0.5], [0.5, 0, 0.5]]) + origin
        camera = [*map(tuple, view), (0, 0, 1)]
        render(tmp_path / name, tmp_path / name / "a.png", camera=camera, size=SIZE)
        images.append(pixels(tmp_path / name / "a.png"))
    np.testing.assert_array_equal(*images)


def gray(image):
    """Pixels of the wall: as dark as no bar and as bright as no text, of no colour."""
    return ((np.ptp(image, axis=-1) < 10) & (abs(image.mean(axis=-1) - 210) < 6)).sum()


def drawn_over(folder, wall, name="rods", **options):
    folder.mkdir()
    rods(folder, 1, name, wall=wall)
    return pixels(render(folder, folder / "a.png", size=SIZE, **options))


def test_a_wall_is_drawn_under_the_bodies(tmp_path):
    """It is seen from the fluid, not from behind, and bodies hide parts of it."""
    without, over, far = (
        drawn_over(tmp_path / name, wall)
        for name, wall in (("a", None), ("b", mrs.Wall()), ("c", mrs.Wall([0.0, 0.0, -20.0])))
    )
    assert gray(without) < 200 < 3000 < gray(over)
    assert colorful(over[:160]) > 1000
    np.testing.assert_array_equal(far, without)
    for height, sign in ((2.0, 1), (-2.0, -1)):
        view = [(0.5, -4.0, 0.5 + height), (0.5, 0.5, 0.5), (0, 0, 1)]
        seen = drawn_over(tmp_path / f"at {height}", mrs.Wall(), camera=view)
        assert (gray(seen) > 3000) == (sign > 0)
        assert colorful(seen[:160]) > 1000


@pytest.mark.parametrize("normal", [(0, 0, 1), (0, 0, -1), (1, 0, 0), (0.3, -0.2, 0.5)])
def test_the_wall_lies_in_its_plane_under_all_points(normal):
    rng = np.random.default_rng(1)
    points = rng.random((50, 3)) * [3.0, 1.0, 0.5]
    wall = mrs.Wall((points @ normal).min() / np.dot(normal, normal) * np.array(normal), normal)
    corners = camera._floor(points, np.array(wall.point), wall.frame)
    np.testing.assert_allclose(wall.heights(corners), 0.0, atol=1e-14)
    sides = np.roll(corners, -1, axis=0) - corners
    assert (np.cross(sides, np.roll(sides, -1, axis=0)) @ wall.normal > 0.0).all()
    for point in points:  # inside of all four edges
        assert (np.cross(sides, point - corners) @ wall.normal > 0.0).all()


@pytest.mark.parametrize("place", [0.0, 1.0, 1e-6, 1e9])
def test_one_tracer(tmp_path, place):
    """Of no size at all, wherever it is."""
    path = tmp_path / "tracers.vtkhdf"
    vtkhdf.create(path, Topology(np.arange(1), []), meta={"kind": "tracers"})
    vtkhdf.append(path, 0.0, np.full((1, 3), place))
    render(tmp_path, tmp_path / "a.png", size=SIZE)
    above_text = pixels(tmp_path / "a.png")[:170]
    assert 10 < (above_text.min(axis=-1) < 200).sum() < 100


def test_edges_of_a_periodic_cell(tmp_path):
    """Twelve thin lines about a tracer, which fill the picture; across there is nothing else."""
    path = tmp_path / "tracers.vtkhdf"
    cell = [[2.0, 0.0, 0.0], [1.0, 2.0, 0.0], [0.0, 0.0, 2.0]]
    meta = {"kind": "tracers", "boundary kind": "periodic", "boundary cell": cell}
    vtkhdf.create(path, Topology(np.arange(1), []), meta=meta)
    vtkhdf.append(path, 0.0, np.array([[1.5, 1.0, 1.0]]))
    render(tmp_path, tmp_path / "a.png", size=SIZE)
    drawn = pixels(tmp_path / "a.png")[:170].min(axis=-1) < 220
    rows, columns = np.nonzero(drawn)
    assert np.ptp(rows) > 120
    assert np.ptp(columns) > 120
    assert 0.01 < drawn.mean() < 0.06


def test_bodies_are_drawn_at_one_time(tmp_path):
    """A file that was begun anew later has other numbers for the same times."""
    rods(tmp_path)
    path = tmp_path / "tracers.vtkhdf"
    vtkhdf.create(path, Topology(np.arange(50), []), meta={"kind": "tracers"})
    vtkhdf.append(path, 0.5, np.random.default_rng(0).random((50, 3)))
    with Trajectory(tmp_path / "rods.vtkhdf") as one, Trajectory(path) as other:
        assert module._shots([one, other], slice(None), 1) == [([1, 0], [])]
        assert module._shots([one, other], -1, 1) == [([1, 0], [])]
        with pytest.raises(IndexError, match=r"number 2, at t = 1, is not in .*tracers.vtkhdf$"):
            module._shots([one, other], 2, 1)


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
        center, distance = camera._fit(points, towards, slopes, 0.0)
        ahead = distance - (points - center) @ towards
        rim = np.abs((points - center) @ axes.T / ahead[:, None]) / slopes
        assert rim.max() < 1.02
        assert rim.max() > 0.9


def test_refusals(tmp_path):
    with pytest.raises(FileNotFoundError, match="no trajectories"):
        render(tmp_path, tmp_path / "a.png")
    rods(tmp_path, frames=0)
    with pytest.raises(IndexError, match="no frames"):
        render(tmp_path, tmp_path / "a.png")
    rods(tmp_path, name="others")
    (tmp_path / "rods.vtkhdf").unlink()
    with pytest.raises(IndexError, match="has 3 frames, none number 3"):
        render(tmp_path, tmp_path / "a.png", frame=3)
    with pytest.raises(ValueError, match=r"\.jpg"):
        render(tmp_path, tmp_path / "a.jpg")
    with pytest.raises(ValueError, match=r"frame: \.png holds one frame: a number, got 1:"):
        render(tmp_path, tmp_path / "a.png", frame=slice(1, None))
    with pytest.raises(ValueError, match=r"frame: \.gif holds a film: a range .* got 1"):
        render(tmp_path, tmp_path / "a.gif", frame=1)
    with pytest.raises(IndexError, match="frame: there are 3 frames, none in 3::2"):
        render(tmp_path, tmp_path / "a.gif", frame=slice(3, None, 2))
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
