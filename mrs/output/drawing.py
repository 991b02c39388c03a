"""A frame of all bodies as pixels."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from mrs.fluid import Periodic
from mrs.fluid.mobility import Boundary
from mrs.output.camera import ANGLE, TIP, Places, Stage, cell_corners
from mrs.output.colors import Colors, field_at_points, magnitude
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
_COLOR_MAP = "viridis"
_PAPER, _INK, _WALL = "white", "#303030", "#d4d4ce"
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
_Shapes = list[tuple[Any, dict[str, Any]]]  # meshes, and how to draw them


def picture(
    bodies: list[Trajectory],
    places: Places,
    colors: Colors,
    stage: Stage,
    boundary: Boundary | None,
) -> np.ndarray:
    """Return a frame as pixels, (height, width, 3) uint8.

    Parameters
    ----------
    bodies : list of Trajectory
    places : list of int
        Of the frame in the file of each body.
    colors : Colors
    stage : Stage
    boundary : Boundary or None
        Of this frame; a box is drawn.
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
        if isinstance(boundary, Periodic):
            _add_cell(plotter, (cell_corners(boundary) - stage.center) / stage.extent)
        for body, i in zip(bodies, places, strict=True):
            if body.topology.cells:
                _add_body(plotter, body, i, colors, stage)
        _add_legend(plotter, f"t = {bodies[0].times[places[0]]:.4g}", colors)
        plotter.camera_position = [tuple(map(float, point)) for point in stage.camera]
        plotter.camera.view_angle = ANGLE
        plotter.camera.SetWindowCenter(0, -stage.foot)
        plotter.camera_set = True
        plotter.renderer.reset_camera_clipping_range()
        return np.asarray(plotter.screenshot(return_img=True))
    finally:
        plotter.close()


def _add_wall(plotter: pv.Plotter, corners: np.ndarray) -> None:
    """Draw a piece of wall as it is seen from the fluid: from behind it would hide the bodies."""
    import pyvista as pv

    wall = pv.PolyData(corners, faces=[4, 0, 1, 2, 3])
    plotter.add_mesh(wall, color=_WALL, culling="back", lighting=False, render=False)


def _add_cell(plotter: pv.Plotter, corners: np.ndarray) -> None:
    """Draw the edges of a periodic box, or of the cell of a slab at z = 0."""
    import pyvista as pv

    steps = (1, 2, 4)[: len(corners) // 4 + 1]
    pairs = [(i, i | step) for i in range(len(corners)) for step in steps if not i & step]
    lines = np.insert(pairs, 0, 2, axis=1)  # the number of points before each
    plotter.add_mesh(pv.PolyData(corners, lines=lines), color=_INK, line_width=1, render=False)


def _add_body(plotter: pv.Plotter, body: Trajectory, i: int, colors: Colors, stage: Stage) -> None:
    kind = str(body.meta.get("kind"))
    shapes = SHAPES.get(kind, _tubes if body.topology.lines else _dots)
    for mesh, look in shapes(_mesh(body, i, colors.field, stage)):
        if "color" in mesh.point_data:
            look |= {"scalars": "color", "clim": colors.range, "cmap": _COLOR_MAP}
        else:
            look |= {"color": _COLORS.get(kind, _COLORS["rods"])}
        plotter.add_mesh(mesh, show_scalar_bar=False, **_MATERIAL, **look)


def _add_legend(plotter: Any, time: str, colors: Colors) -> None:
    """Write the time and the meaning of the colours, in letters that fit the picture."""
    import pyvista as pv

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
            color=_INK,
        )
        bar.SetBarRatio(0.02 / (0.03 + 1.2 * letter / height))
        bar.SetTextPositionToSucceedScalarBar()
    for words, side, place in texts:
        text = pv.Text(words, position=place)
        text.prop.font_size, text.prop.color = letter, _INK
        text.prop.justification_horizontal = side
        plotter.add_actor(text, render=False)


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
