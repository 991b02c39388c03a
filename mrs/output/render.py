"""Pictures and films of a run."""

from __future__ import annotations

import ctypes
import io
import os
import sys
from collections.abc import Iterable, Sequence
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mrs.output import run_directory
from mrs.output.atomic import replacing
from mrs.output.frames import Frames, trajectories
from mrs.output.vtkhdf import Trajectory
from mrs.output.vtp import polydata

if TYPE_CHECKING:
    import pyvista as pv

_FILMS = (".mp4", ".gif")
_COLORS = {"rods": "#3b6ea5", "swimmers": "#c8553d", "tracers": "#8a8f98"}
_COLOR_MAP = "viridis"
_VIEW = np.array([0.5, -1.0, 0.45])  # from where one looks at the scene
_DEFAULT_FIELD = "velocity"
_ANGLE = 30.0  # degrees that the camera sees, up
_LIGHTS = (((-1, 1, 2), 0.75), ((2, 0.5, 1), 0.35), ((0, -1, 1), 0.2))  # positions, intensities
_SHARP = {"smooth_shading": True, "split_sharp_edges": True}
_MATERIAL: dict[str, Any] = {
    "render": False,
    "ambient": 0.25,
    "diffuse": 0.8,
    "specular": 0.15,
    "specular_power": 20,
}
_TIP = 2.6  # radii from the centre of a swimmer's head to the tip of its arrow
_MARGIN = 0.06  # of the picture, free on each side
_FOOT = 0.12  # of the picture, free for the bar of colours
_SAMPLE = 1_000_000  # points that say what the picture must hold
_FACETS = 2_000_000  # of all spheres together, at most
_TRANSIENT = 2.0  # times as far as three quarters of the frames reach

Camera = Sequence[Any]
_Shapes = list[tuple[Any, dict[str, Any]]]  # meshes, and how to draw them
_Places = list[int]  # of one frame in the file of each body


class _Colors(NamedTuple):
    """What is coloured, alike in all frames."""

    field: str | None
    range: tuple[float, float]
    title: str


class _Stage(NamedTuple):
    """Where the bodies stand, alike in all frames.

    What is drawn is measured from the centre of the scene, in lengths of its longest side: singles,
    which graphics computes with, serve any unit of length, and any distance from the origin.
    """

    center: np.ndarray
    extent: float
    camera: Camera
    foot: float  # of the picture, free for the bar
    size: tuple[int, int]
    background: str


def render(
    directory: str | os.PathLike[str],
    destination: str | os.PathLike[str],
    *,
    frame: int | slice | None = None,
    color_by: str | None = None,
    camera: Camera | None = None,
    size: tuple[int, int] = (1280, 800),
    background: str = "white",
    fps: int = 24,
) -> Path:
    """Draw a run: rods as tubes, swimmers as arrows with spheres, tracers as points.

    Parameters
    ----------
    directory : path
        Of the run.
    destination : path
        A .png for one frame; a .mp4 or .gif for several. It appears when it is complete.
    frame : int or slice, optional
        Which one of a picture, the last by default; which of a film, all by default. Negative ones
        count from the end.
    color_by : str, optional
        An array at points or cells; vectors by their length. By default "velocity", if there is
        such an array. Bodies without it have a colour of their own.
    camera : (position, focal point, up), optional
        Three points each; by default all frames fit into the picture.
    size : (width, height), optional
        In pixels.
    background : str, optional
        A colour.
    fps : int, optional
        Frames a second of a film.

    Returns
    -------
    Path
        The destination.

    Raises
    ------
    FileNotFoundError
        If there are no trajectories.
    IndexError
        If there is no such frame.
    ValueError
        If the suffix does not fit, or no body has the array to colour by.
    RuntimeError
        If the machine has no library to draw with.

    Notes
    -----
    The colours of a film span what its frames reach, but for a transient: a frame that reaches more
    than twice as far as three quarters of the frames do is left out, and the bar says how far it
    reaches.
    """
    destination = Path(destination)
    wanted = _wanted(frame, destination)
    with trajectories(directory) as bodies:
        frames = _frames(bodies, wanted)
        colors = _colors(bodies, frames, color_by)
        stage = _stage(bodies, frames, camera, size, background)
        require_opengl()
        destination.parent.mkdir(parents=True, exist_ok=True)
        run_directory.note_made(directory, destination)
        pictures = (_picture(bodies, places, colors, stage) for places in frames)
        with replacing(destination) as temporary:
            _write(temporary, pictures, fps)
    return destination


def require_opengl() -> None:
    """Make sure that VTK can draw without a screen, for it crashes if it cannot.

    Raises
    ------
    RuntimeError
        If there is neither a screen nor EGL nor OSMesa; it names the packages to install.
    """
    if not sys.platform.startswith("linux") or os.environ.get("DISPLAY"):
        return
    if _loads("libEGL.so.1"):
        os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow")
    elif not any(map(_loads, ("libOSMesa.so", "libOSMesa.so.8", "libOSMesa.so.6"))):
        raise RuntimeError(
            "no library to draw without a screen; on Debian or Ubuntu: apt install libegl1 libgl1"
        )


def _loads(library: str) -> bool:
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True


def _wanted(frame: int | slice | None, destination: Path) -> int | slice:
    if destination.suffix not in (".png", *_FILMS):
        raise ValueError(f"destination must end in .png, .mp4 or .gif, got {destination.name!r}")
    film = destination.suffix in _FILMS
    if frame is None:
        return slice(None) if film else -1
    if isinstance(frame, slice) != film:
        holds = "a film: a range of frames such as 0:20 or ::2" if film else "one frame: a number"
        raise ValueError(f"frame: {destination.suffix} holds {holds}, got {_typed(frame)}")
    return frame


def _frames(bodies: list[Trajectory], wanted: int | slice) -> list[_Places]:
    """Return the frames to draw, of those that all bodies have."""
    common = Frames(bodies)
    if not common.numbers:
        raise IndexError(f"no frames in {bodies[0].path.parent} yet")
    if not isinstance(wanted, slice):
        return [common.places(common.number(wanted))]
    known = set(common.numbers)
    chosen = [number for number in range(len(common.times))[wanted] if number in known]
    if not chosen:
        raise IndexError(f"frame: there are {len(common.numbers)} frames, none in {_typed(wanted)}")
    return [common.places(number) for number in chosen]


def _typed(frame: int | slice) -> str:
    """Return a frame or a range of them as it is typed."""
    if not isinstance(frame, slice):
        return str(frame)
    ends = (frame.start, frame.stop, *([] if frame.step is None else [frame.step]))
    return ":".join("" if end is None else str(end) for end in ends)


def _colors(bodies: list[Trajectory], frames: list[_Places], color_by: str | None) -> _Colors:
    """Find the range of colours of all frames."""
    field = _DEFAULT_FIELD if color_by is None else color_by
    ranges, vector = [], False
    for places in frames:
        fields = [_field(body, i, field) for body, i in zip(bodies, places, strict=True)]
        known = [values for values in fields if values is not None and np.isfinite(values).any()]
        vector |= any(values.ndim == 2 for values in known)
        if known:
            values = np.concatenate([_magnitude(values) for values in known])
            ranges.append((0.0 if vector else np.nanmin(values), np.nanmax(values)))
    if not ranges and color_by is not None:
        data = [d for body in bodies for d in (body.point_data(-1), body.cell_data(-1))]
        names = ", ".join(sorted({name for arrays in data for name in arrays}))
        raise ValueError(f"color_by must be one of {names}, got {color_by!r}")
    if not ranges:
        return _Colors(None, (0.0, 0.0), "")
    low, high = _without_transient(np.array(ranges))
    title = field.replace("_", " ") + (" (magnitude)" if vector else "")
    beyond = max(top for _, top in ranges)
    return _Colors(field, (low, high), title + (f", up to {beyond:.3g}" if beyond > high else ""))


def _without_transient(ranges: np.ndarray) -> tuple[float, float]:
    """Return the least and largest value in most frames.

    Often the first frames have by far the largest values, where loads are let go at the start, and
    would leave all others in one colour. Quantiles of all values would cut the tips of every
    frame as well.

    Parameters
    ----------
    ranges : (frames, 2) float ndarray
        Least and largest value of each.
    """
    reach = np.abs(ranges).max(axis=1)
    most = np.quantile(reach, 0.75, method="lower")
    kept = ranges[reach <= _TRANSIENT * most] if most else ranges
    return float(kept[:, 0].min()), float(kept[:, 1].max())


def _field(body: Trajectory, i: int, name: str) -> np.ndarray | None:
    """Return an array at points; one at cells is carried to the points of each cell."""
    at_points, at_cells = body.point_data(i), body.cell_data(i)
    if name in at_points or name not in at_cells:
        return at_points.get(name)
    values = at_cells[name].astype(np.float64)
    result = np.full((len(body.points(i)), *values.shape[1:]), np.nan)
    vertices, lines = body.topology
    result[vertices] = values[: len(vertices)]
    for line, value in zip(lines, values[len(vertices) :], strict=True):
        result[line] = value
    return result


def _points(bodies: list[Trajectory], frames: list[_Places]) -> np.ndarray:
    """Return points of all frames, (n, 3): all of them, or a fair sample if there are many."""
    pairs = [pair for places in frames for pair in zip(bodies, places, strict=True)]
    total = len(frames) * sum(len(body.points(i)) for body, i in pairs[: len(bodies)])
    every = 1 + total // _SAMPLE
    return np.concatenate([body.points(i)[::every] for body, i in pairs]).astype(np.float64)


def _magnitude(values: np.ndarray) -> np.ndarray:
    values = values.astype(np.float64)  # squares of large singles are beyond their range
    return np.linalg.norm(values, axis=1) if values.ndim == 2 else values


def _stage(
    bodies: list[Trajectory],
    frames: list[_Places],
    camera: Camera | None,
    size: tuple[int, int],
    background: str,
) -> _Stage:
    """Set up the camera; without one given, all frames fit into the picture above the bar."""
    points, reach = _points(bodies, frames), _reach(bodies)
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    extent = float(np.ptp(points, axis=0).max()) or reach or 1.0
    if camera is not None:
        *places, up = np.asarray(camera, np.float64)
        view = [*((place - middle) / extent for place in places), up]
        return _Stage(middle, extent, view, 0.0, size, background)
    towards = _VIEW / np.linalg.norm(_VIEW)
    slope = np.tan(np.radians(_ANGLE / 2)) * (1 - _MARGIN)
    slopes = np.array([slope * size[0] / size[1], slope * (1 - _FOOT)])
    center, distance = _fit((points - middle) / extent, towards, slopes, reach / extent)
    view = [center + distance * towards, center, (0, 0, 1)]
    return _Stage(middle, extent, view, _FOOT, size, background)


def _reach(bodies: list[Trajectory]) -> float:
    """Return how far bodies reach beyond their points; the tips of arrows are the longest."""
    radii = [body.point_data(-1).get("radius", np.zeros(1)) for body in bodies]
    return _TIP * max(float(radius.max(initial=0.0)) for radius in radii)


def _fit(
    points: np.ndarray, towards: np.ndarray, slopes: np.ndarray, reach: float
) -> tuple[np.ndarray, float]:
    """Return focal point and distance from which the points just fill a picture.

    Parameters
    ----------
    points : (n, 3) float ndarray
    towards : (3,) float ndarray
        Unit vector towards the camera.
    slopes : (2,) float ndarray
        Of the sides of the picture, across and up.
    reach : float
        Room to leave around every point.
    """
    right = np.cross((0, 0, 1), towards)
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(towards, right)])
    center, distance = (points.min(axis=0) + points.max(axis=0)) / 2, 1.0
    for _ in range(5):  # to move the center changes what is near, and so what is at the rim
        depth, seen = (points - center) @ towards, (points - center) @ axes.T
        distance = np.max(depth[:, None] + reach + (np.abs(seen) + reach) / slopes) or 1.0
        rim = seen / np.maximum(distance - depth, 1e-6 * distance)[:, None]
        center = center + distance * (rim.min(axis=0) + rim.max(axis=0)) / 2 @ axes
    return center, float(distance)


def _write(destination: Path, pictures: Iterable[np.ndarray], fps: int) -> None:
    if destination.suffix == ".mp4":
        _write_mp4(destination, pictures, fps)
        return
    import imageio.v3 as imageio

    content = io.BytesIO()
    options = {"duration": 1000 / fps, "loop": 0} if destination.suffix == ".gif" else {}
    with imageio.imopen(content, "w", extension=destination.suffix) as file:
        for picture in pictures:
            file.write(picture, **options)
    destination.write_bytes(content.getvalue())


def _write_mp4(destination: Path, pictures: Iterable[np.ndarray], fps: int) -> None:
    import imageio.v2 as imageio

    writer: Any = imageio.get_writer(destination, fps=fps, quality=8, macro_block_size=2)
    count = 0
    with closing(writer):  # its own `with` leaves ffmpeg at work after an error
        for picture in pictures:
            writer.append_data(picture)
            count += 1
    if _length(destination) != count:
        raise OSError(f"{destination.name}: ffmpeg could not write it; is there room on the disk?")


def _length(film: Path) -> int:
    """Return how many pictures a film holds; ffmpeg fails without a word."""
    import imageio_ffmpeg

    try:
        return imageio_ffmpeg.count_frames_and_secs(film)[0]
    except RuntimeError:
        return 0


def _picture(
    bodies: list[Trajectory], places: _Places, colors: _Colors, stage: _Stage
) -> np.ndarray:
    """Return a frame as pixels."""
    import pyvista as pv

    plotter: Any = pv.Plotter(off_screen=True, window_size=list(stage.size), lighting="none")
    try:
        plotter.set_background(stage.background)
        plotter.enable_anti_aliasing("ssaa")
        for position, intensity in _LIGHTS:
            light = pv.Light(position=position, light_type="camera light", intensity=intensity)
            plotter.add_light(light)
        for body, i in zip(bodies, places, strict=True):
            if body.topology.cells:
                _add_body(plotter, body, i, colors, stage)
        _add_legend(plotter, f"t = {bodies[0].times[places[0]]:.4g}", colors)
        plotter.camera_position = [tuple(map(float, point)) for point in stage.camera]
        plotter.camera.view_angle = _ANGLE
        plotter.camera.SetWindowCenter(0, -stage.foot)
        plotter.camera_set = True
        plotter.renderer.reset_camera_clipping_range()
        return np.asarray(plotter.screenshot(return_img=True))
    finally:
        plotter.close()


def _add_body(
    plotter: pv.Plotter, body: Trajectory, i: int, colors: _Colors, stage: _Stage
) -> None:
    kind = str(body.meta.get("kind"))
    shapes = {"rods": _tubes, "swimmers": _arrows_and_spheres, "tracers": _dots}
    for mesh, look in shapes.get(kind, _tubes)(_mesh(body, i, colors.field, stage)):
        if "color" in mesh.point_data:
            look |= {"scalars": "color", "clim": colors.range, "cmap": _COLOR_MAP}
        else:
            look |= {"color": _COLORS.get(kind, _COLORS["rods"])}
        plotter.add_mesh(mesh, show_scalar_bar=False, **_MATERIAL, **look)


def _add_legend(plotter: Any, time: str, colors: _Colors) -> None:
    """Say what the time is and what the colours mean, in letters that fit the picture."""
    import pyvista as pv

    ink = "#303030" if sum(pv.Color(plotter.background_color).int_rgb) > 380 else "#e8e8e8"
    width, height = plotter.window_size
    letter = max(12, round(height / 40))
    texts = [(time, "left", (letter, letter))]
    if colors.field is not None:
        texts.append((colors.title, "center", (width // 2, round(0.03 * height + 2.0 * letter))))
        key = pv.DataSetMapper()
        key.lookup_table = pv.LookupTable(_COLOR_MAP, scalar_range=colors.range)
        bar = plotter.add_scalar_bar(
            "",  # its own title would run into the labels
            mapper=key,
            n_labels=3,
            fmt="%.3g",
            width=0.26,
            height=0.03 + 1.2 * letter / height,
            position_x=0.37,
            position_y=0.02,
            label_font_size=round(0.9 * letter),
            unconstrained_font_size=True,
            color=ink,
        )
        bar.SetBarRatio(0.02 / (0.03 + 1.2 * letter / height))
        bar.SetTextPositionToSucceedScalarBar()
    for words, side, place in texts:
        text = pv.Text(words, position=place)
        text.prop.font_size, text.prop.color = letter, ink
        text.prop.justification_horizontal = side
        plotter.add_actor(text, render=False)


def _mesh(body: Trajectory, i: int, field: str | None, stage: _Stage) -> pv.PolyData:
    """Return a frame in lengths of the scene, with the numbers to colour by."""
    data = body.point_data(i)
    arrays = {name: array for name, array in data.items() if name in ("radius", "orientation")}
    if "radius" in arrays:
        arrays["radius"] = arrays["radius"] / stage.extent
    values = None if field is None else _field(body, i, field)
    if values is not None:
        arrays["color"] = _magnitude(values)
    points = (body.points(i).astype(np.float64) - stage.center) / stage.extent
    return polydata(body.topology, points, arrays)


def _tubes(mesh: pv.PolyData) -> _Shapes:
    if "radius" in mesh.point_data:
        return [(mesh.tube(scalars="radius", absolute=True, n_sides=20), dict(_SHARP))]
    return [(mesh.tube(radius=0.004, n_sides=20), dict(_SHARP))]


def _arrows_and_spheres(mesh: pv.PolyData) -> _Shapes:
    import pyvista as pv

    pairs = mesh.lines.reshape(-1, 3)[:, 1:]
    head, tail = mesh.points[pairs[:, 0]], mesh.points[pairs[:, 1]]
    length = np.linalg.norm(head - tail, axis=1)
    if "radius" not in mesh.point_data:
        mesh["radius"] = np.full(mesh.n_points, 0.15 * length.mean())
    middle = pv.PolyData((head + tail) / 2)
    middle["length"] = length
    along = head - tail
    middle["along"] = (
        mesh["orientation"][pairs[:, 0]] if "orientation" in mesh.array_names else along
    )
    if "color" in mesh.point_data:
        middle["color"] = mesh["color"][pairs[:, 0]]
    radius = float(np.mean(mesh["radius"]) / length.mean())  # all in lengths of a pair
    tip = _TIP * radius
    arrow = pv.Arrow(
        start=(-0.5, 0, 0),
        scale=1 + tip,
        tip_length=tip / (1 + tip),
        tip_radius=0.95 * radius / (1 + tip),
        shaft_radius=0.35 * radius / (1 + tip),
        tip_resolution=24,
        shaft_resolution=16,
    )
    facets = int(np.clip(np.sqrt(_FACETS / (2 * mesh.n_points)), 6, 24))
    sphere = pv.Sphere(radius=1.0, theta_resolution=facets, phi_resolution=facets)
    arrows = middle.glyph(orient="along", scale="length", factor=1.0, geom=arrow)
    spheres = mesh.glyph(orient=False, scale="radius", factor=1.0, geom=sphere)
    return [(arrows, dict(_SHARP)), (spheres, {"smooth_shading": True})]


def _dots(mesh: pv.PolyData) -> _Shapes:
    return [(mesh, {"style": "points", "point_size": 10, "render_points_as_spheres": True})]
