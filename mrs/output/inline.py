"""Pictures that notebooks show below a cell."""

from __future__ import annotations

import os
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from mrs.output.formats import FORMATS
from mrs.output.render import render

if TYPE_CHECKING:
    from mrs.run.simulation import Simulation


class Picture:
    """A picture, which a notebook shows.

    Parameters
    ----------
    png : bytes
        The content of a .png file.
    """

    def __init__(self, png: bytes) -> None:
        self.png = png

    def _repr_png_(self) -> bytes:
        return self.png

    def __repr__(self) -> str:
        return f"<Picture: {len(self.png)} bytes of .png>"


def picture_of(directory: str | os.PathLike[str], **options: Any) -> Picture:
    """Return a picture of a run; options are those of `render`."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "picture.png"
        return Picture(render(directory, path, **options).read_bytes())


def picture_now(sim: Simulation, **options: Any) -> Picture:
    """Return a picture of the present state; options are those of `render`."""
    with TemporaryDirectory() as folder:
        for body in sim.bodies:
            file = FORMATS["vtkhdf"](Path(folder), body)
            file.cut(sim)
            file.write(sim)
            file.finish()
        return picture_of(folder, **options)
