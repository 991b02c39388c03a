"""A frame of all bodies as pixels."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mrs.fluid import Periodic
from mrs.fluid.mobility import Boundary
from mrs.output.camera import ANGLE, TIP, Places, Stage, cell_corners
from mrs.output.colors import Colors, field_at_points, magnitude
from mrs.output.legend import COLOR_MAP, INK, add_legend
from mrs.output.trajectory import Trajectory
from mrs.output.vtp import polydata

if TYPE_CHECKING:
    import pyvista as pv

_COLORS = {
    "rods": "#3b6ea5",
    "rigid": "#7a6a9b",
    "prescribed": "#4f8f6f",
    "swimmers": "#c8553d",
    "tracers": "#8a8f98",
}
_PAPER, _WALL = "white", "#d4d4ce"
_HEIGHT = 800  # of a picture, in pixels, of which widths of lines and points are given
_LIGHTS = (((-1, 1, 2), 0.75), ((2, 0.5, 1), 0.35), ((0, -1, 1), 0.2))  # positions, intensities
_SHARP = {"smooth_shading": True, "split_sharp_edges": True}
_MATERIAL: dict[str, Any] = {
    "render": False,
    "ambient": 0.25,
    "diffuse": 0.8,
    "specular": 0.15,
    "specular_power": 20,
}
_FACETS = 2_000_000  # of all spheres together, at most


class Marks(NamedTuple):
    """What is on a picture beside the bodies."""

    scale_bar: str | None = None
    """Unit of length beside a bar of a round length; None for no bar."""
    transparent: bool = False
    """Whether there is no paper behind the bodies."""


_Shapes = list[tuple[Any, dict[str, Any]]]  # meshes, and how to draw them


def picture(
    bodies: list[Trajectory],
    places: Places,
    colors: Colors,
    stage: Stage,
    boundary: Boundary | None,
    past: list[Places],
    marks: Marks,
) -> np.ndarray:
    """Return a frame as pixels, (height, width, 3) uint8, or 4 if the paper is transparent.

    Parameters
    ----------
    bodies : list of Trajectory
    places : list of int
        Of the frame in the file of each body.
    colors : Colors
    stage : Stage
    boundary : Boundary or None
        Of this frame; a box is drawn.
    past : list of list of int
        Frames before this one, in order, that trails of tracers lead through.
    marks : Marks
    """
    import pyvista as pv

    plotter: Any = pv.Plotter(off_screen=True, window_size=list(stage.size), lighting="none")
    try:
        plotter.set_background(_PAPER)
        plotter.enable_anti_aliasing("ssaa")
        for position, intensity in _LIGHTS:
            light = pv.Light(position=position, light_type="camera light", intensity=intensity)
            plotter.add_light(light)
        if stage.floor is not None:
            _add_wall(plotter, stage.floor)
        thick = max(1.0, stage.size[1] / _HEIGHT)
        if isinstance(boundary, Periodic):
            _add_cell(plotter, (cell_corners(boundary) - stage.center) / stage.extent, thick)
        for number, (body, i) in enumerate(zip(bodies, places, strict=True)):
            if body.topology.cells:
                _add_body(plotter, body, i, colors, stage, thick)
            if past and body.meta.get("kind") == "tracers":
                _add_trails(plotter, body, [*(before[number] for before in past), i], stage, thick)
        time = bodies[0].times[places[0]]
        add_legend(plotter, time, colors, stage, marks.scale_bar)
        plotter.camera_position = [tuple(map(float, point)) for point in stage.camera]
        plotter.camera.view_angle = ANGLE
        plotter.camera.SetWindowCenter(0, -stage.foot)
        plotter.camera_set = True
        plotter.renderer.reset_camera_clipping_range()
        options = {"transparent_background": marks.transparent}
        pixels = np.asarray(plotter.screenshot(return_img=True, **options))
        return _without_paper(pixels) if marks.transparent else pixels
    finally:
        plotter.close()


def _without_paper(pixels: np.ndarray) -> np.ndarray:
    """Return pixels, (height, width, 4), whose edges are not mixed with the white of the paper."""
    opaque = pixels[..., 3:] / 255.0
    white = 255.0 * (1.0 - opaque)
    colors = (pixels[..., :3] - white) / np.where(opaque > 0.0, opaque, 1.0)
    bare = np.concatenate([colors, pixels[..., 3:]], axis=-1)
    return bare.round().clip(0.0, 255.0).astype(np.uint8)


def _add_wall(plotter: pv.Plotter, corners: np.ndarray) -> None:
    """Draw a piece of wall as it is seen from the fluid: from behind it would hide the bodies."""
    import pyvista as pv

    wall = pv.PolyData(corners, faces=[4, 0, 1, 2, 3])
    plotter.add_mesh(wall, color=_WALL, culling="back", lighting=False, render=False)


def _add_cell(plotter: pv.Plotter, corners: np.ndarray, line_width: float) -> None:
    """Draw the edges of a periodic box, or of the cell of a slab at z = 0."""
    import pyvista as pv

    steps = (1, 2, 4)[: len(corners) // 4 + 1]
    pairs = [(i, i | step) for i in range(len(corners)) for step in steps if not i & step]
    lines = np.insert(pairs, 0, 2, axis=1)  # the number of points before each
    look: dict[str, Any] = {"color": INK, "line_width": line_width}
    plotter.add_mesh(pv.PolyData(corners, lines=lines), render=False, **look)


def _add_body(
    plotter: pv.Plotter, body: Trajectory, i: int, colors: Colors, stage: Stage, thick: float
) -> None:
    kind = str(body.meta.get("kind"))
    shapes = SHAPES.get(kind, _tubes if body.topology.lines else _dots)
    for mesh, look in shapes(_mesh(body, i, colors.field, stage)):
        if "color" in mesh.point_data:
            look |= {"scalars": "color", "clim": colors.range, "cmap": COLOR_MAP}
        else:
            look |= {"color": _COLORS.get(kind, _COLORS["rods"])}
        if "point_size" in look:
            look["point_size"] *= thick
        plotter.add_mesh(mesh, show_scalar_bar=False, **_MATERIAL, **look)


def _add_trails(
    plotter: pv.Plotter, body: Trajectory, frames: list[int], stage: Stage, thick: float
) -> None:
    """Draw lines through the places of tracers in some frames, but for leaps across a box."""
    import pyvista as pv

    points = np.stack([body.points(i).astype(np.float64) for i in frames])
    number = np.arange(points.shape[0] * points.shape[1]).reshape(points.shape[:2])
    steps = np.stack([number[:-1], number[1:]], axis=-1)
    if "image" in body.point_data(frames[0]):
        image = np.stack([body.point_data(i)["image"] for i in frames])
        steps = steps[(image[1:] == image[:-1]).all(axis=2)]
    lines = np.insert(steps.reshape(-1, 2), 0, 2, axis=1)  # the number of points before each
    if len(lines):
        mesh = pv.PolyData((points.reshape(-1, 3) - stage.center) / stage.extent, lines=lines)
        look: dict[str, Any] = {"color": _COLORS["tracers"], "line_width": 3.0 * thick}
        plotter.add_mesh(mesh, lighting=False, render=False, **look)


def _mesh(body: Trajectory, i: int, field: str | None, stage: Stage) -> pv.PolyData:
    """Return a frame in lengths of the scene, with the numbers to colour by."""
    data = body.point_data(i)
    arrays = {name: array for name, array in data.items() if name in ("radius", "orientation")}
    if "radius" in arrays:
        arrays["radius"] = arrays["radius"] / stage.extent
    values = None if field is None else field_at_points(body, i, field)
    if values is not None:
        arrays["color"] = magnitude(values)
    points = (body.points(i).astype(np.float64) - stage.center) / stage.extent
    return polydata(body.topology, points, arrays)


def _tubes(mesh: pv.PolyData) -> _Shapes:
    if "radius" in mesh.point_data:
        return [(mesh.tube(scalars="radius", absolute=True, n_sides=20), dict(_SHARP))]
    return [(mesh.tube(radius=0.004, n_sides=20), dict(_SHARP))]


def _tubes_and_spheres(mesh: pv.PolyData) -> _Shapes:
    """Draw lines as tubes, and points that are on no line as spheres."""
    shapes = _tubes(mesh) if mesh.n_lines else []
    if mesh.n_verts:
        shapes.append(_spheres(mesh.extract_points(mesh.verts[1::2], include_cells=False)))
    return shapes


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
    tip = TIP * radius
    arrow = pv.Arrow(
        start=(-0.5, 0, 0),
        scale=1 + tip,
        tip_length=tip / (1 + tip),
        tip_radius=0.95 * radius / (1 + tip),
        shaft_radius=0.35 * radius / (1 + tip),
        tip_resolution=24,
        shaft_resolution=16,
    )
    arrows = middle.glyph(orient="along", scale="length", factor=1.0, geom=arrow)
    return [(arrows, dict(_SHARP)), _spheres(mesh)]


def _spheres(mesh: Any) -> tuple[Any, dict[str, Any]]:
    """Return a sphere of the radius of each point."""
    import pyvista as pv

    facets = int(np.clip(np.sqrt(_FACETS / (2 * mesh.n_points)), 6, 24))
    sphere = pv.Sphere(radius=1.0, theta_resolution=facets, phi_resolution=facets)
    spheres = mesh.glyph(orient=False, scale="radius", factor=1.0, geom=sphere)
    return spheres, {"smooth_shading": True}


def _dots(mesh: pv.PolyData) -> _Shapes:
    return [(mesh, {"style": "points", "point_size": 10, "render_points_as_spheres": True})]


SHAPES: dict[str, Callable[[pv.PolyData], _Shapes]] = {
    "rods": _tubes,
    "rigid": _tubes_and_spheres,
    "prescribed": _tubes_and_spheres,
    "swimmers": _arrows_and_spheres,
    "tracers": _dots,
}
"""How a kind of body is drawn: meshes, each with the options of `pyvista.Plotter.add_mesh`."""
