"""What is written on a picture: the time, the meaning of the colours, a bar of known length."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from mrs.output.camera import ANGLE, Stage
from mrs.output.colors import Colors

INK = "#303030"
COLOR_MAP = "viridis"
_LONGEST = 0.16  # of the picture's width, that a bar of known length may take


def add_legend(
    plotter: Any, time: float, colors: Colors, stage: Stage, scale_bar: str | None
) -> None:
    """Write on a picture, in letters that fit it.

    Parameters
    ----------
    plotter : pyvista.Plotter
    time : float
    colors : Colors
    stage : Stage
    scale_bar : str or None
        Unit of length, beside a bar of a round length; None for no bar.
    """
    import pyvista as pv

    width, height = stage.size
    letter = max(12, round(height / 40))
    texts = [(f"t = {time:.4g}", "left", (letter, letter))]
    if colors.field is not None:
        texts.append((colors.title, "center", (width // 2, round(0.03 * height + 2.0 * letter))))
        _add_color_bar(plotter, colors, height, letter)
    if scale_bar is not None:
        length, pixels = round_length(stage)
        left, bottom = width - letter - pixels, 2.4 * letter
        _add_bar(plotter, (left, bottom), pixels, max(2, letter // 6))
        words = f"{length:.4g} {scale_bar}".rstrip()
        texts.append((words, "center", (round(left + 0.5 * pixels), letter)))
    for words, side, place in texts:
        text = pv.Text(words, position=place)
        text.prop.font_size, text.prop.color = letter, INK
        text.prop.justification_horizontal = side
        plotter.add_actor(text, render=False)


def round_length(stage: Stage) -> tuple[float, float]:
    """Return a length of 1, 2 or 5 times a power of ten, and how many pixels it is.

    Things that are as far from the camera as its focal point have this scale.
    """
    position, focus = np.asarray(stage.camera[0]), np.asarray(stage.camera[1])
    seen = 2.0 * np.linalg.norm(position - focus) * math.tan(math.radians(ANGLE / 2))
    pixel = float(seen) * stage.extent / stage.size[1]
    longest = _LONGEST * stage.size[0] * pixel
    power = 10.0 ** math.floor(math.log10(longest))
    length = power * max(n for n in (0.5, 1, 2, 5) if n * power <= longest)
    return length, length / pixel


def _add_bar(plotter: Any, corner: tuple[float, float], length: float, thickness: float) -> None:
    """Draw a bar, in pixels from the lower left corner of the picture."""
    import pyvista as pv
    from vtkmodules.vtkRenderingCore import vtkActor2D, vtkPolyDataMapper2D

    left, bottom = corner
    right, top = left + length, bottom + thickness
    corners = [[left, bottom, 0], [right, bottom, 0], [right, top, 0], [left, top, 0]]
    mapper = vtkPolyDataMapper2D()
    mapper.SetInputData(pv.PolyData(np.array(corners, float), faces=[4, 0, 1, 2, 3]))
    bar = vtkActor2D()
    bar.SetMapper(mapper)
    bar.GetProperty().SetColor(pv.Color(INK).float_rgb)
    plotter.add_actor(bar, render=False)


def _add_color_bar(plotter: Any, colors: Colors, height: int, letter: int) -> None:
    """Draw the colours and their numbers."""
    import pyvista as pv

    key = pv.DataSetMapper()
    key.lookup_table = pv.LookupTable(COLOR_MAP, scalar_range=colors.range)
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
        color=INK,
    )
    bar.SetBarRatio(0.02 / (0.03 + 1.2 * letter / height))
    bar.SetTextPositionToSucceedScalarBar()
