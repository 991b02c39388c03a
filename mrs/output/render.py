"""Pictures and films of a run."""

from __future__ import annotations

import ctypes
import io
import os
import sys
from collections.abc import Iterable
from contextlib import closing
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mrs import check
from mrs.output import run_directory
from mrs.output.atomic import replacing
from mrs.output.camera import Camera, Places, stage_of
from mrs.output.colors import colors_of
from mrs.output.drawing import Marks, picture
from mrs.output.frames import Frames, trajectories
from mrs.output.stored import stored_boundary
from mrs.output.trajectory import Trajectory

_FILMS = (".mp4", ".gif")
_RATE = 24  # pictures a second of a film
_DPI = 300  # of a picture in print


def render(
    directory: str | os.PathLike[str],
    destination: str | os.PathLike[str],
    *,
    frame: int | slice | None = None,
    color_by: str | None = None,
    color_range: tuple[float, float] | None = None,
    camera: Camera | None = None,
    size: tuple[int, int] = (1280, 800),
    trails: int = 0,
    scale_bar: str | None = None,
    transparent: bool = False,
) -> Path:
    """Draw a run: rods as tubes, swimmers as arrows with spheres, tracers as points, a wall.

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
    color_range : (low, high), optional
        Of the values; by default that of all frames that are drawn, but for a transient.
    camera : (position, focal point, up), optional
        Three points each; by default all frames fit into the picture.
    size : (width, height), optional
        In pixels. A .png is 300 of them an inch in print.
    trails : int, optional
        Frames before, through which a line leads to where each tracer is.
    scale_bar : str, optional
        A unit of length, which may be empty: draws a bar of a round length. The scale is that of
        things as far away as the focal point of the camera.
    transparent : bool, optional
        Whether a .png has no paper behind the bodies.

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
        If the suffix does not fit, no body has the array to colour by, or the range of colours is
        empty.
    RuntimeError
        If the machine has no library to draw with.
    """
    destination = Path(destination)
    wanted = _wanted(frame, destination)
    check.integer("trails", trails, 0)
    if color_range is not None and not color_range[0] < color_range[1]:
        raise ValueError(f"color_range must be a lower and a higher number, got {color_range}")
    if transparent and destination.suffix != ".png":
        raise ValueError(f"transparent: only a .png can be, got {destination.name!r}")
    with trajectories(directory) as bodies:
        shots = _shots(bodies, wanted, trails)
        colors = colors_of(bodies, [shot.places for shot in shots], color_by, color_range)
        first = bodies[0]
        times = [first.times[shot.places[0]] for shot in shots]
        boundaries = [stored_boundary(first.meta, time) for time in times]
        seen = {tuple(places): places for shot in shots for places in (*shot.past, shot.places)}
        stage = stage_of(bodies, list(seen.values()), camera, size, boundaries)
        marks = Marks(scale_bar, transparent)
        require_opengl()
        destination.parent.mkdir(parents=True, exist_ok=True)
        run_directory.note_made(directory, destination)
        pictures = (
            picture(bodies, shot.places, colors, stage, boundary, shot.past, marks)
            for shot, boundary in zip(shots, boundaries, strict=True)
        )
        with replacing(destination) as temporary:
            _write(temporary, pictures)
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


class _Shot(NamedTuple):
    """A frame that is drawn, and those before it that trails lead through."""

    places: Places
    past: list[Places]


def _shots(bodies: list[Trajectory], wanted: int | slice, trails: int) -> list[_Shot]:
    """Return the frames to draw, of those that all bodies have."""
    common = Frames(bodies)
    place = {number: i for i, number in enumerate(common.numbers)}
    if not place:
        raise IndexError(f"no frames in {bodies[0].path.parent} yet")
    if isinstance(wanted, slice):
        chosen = [number for number in range(len(common.times))[wanted] if number in place]
    else:
        chosen = [common.number(wanted)]
    if not chosen:
        raise IndexError(f"frame: there are {len(place)} frames, none in {_typed(wanted)}")
    all_places = [common.places(number) for number in common.numbers]
    ends = [place[number] for number in chosen]
    return [_Shot(all_places[end], all_places[max(0, end - trails) : end]) for end in ends]


def _typed(frame: int | slice) -> str:
    """Return a frame or a range of them as it is typed."""
    if not isinstance(frame, slice):
        return str(frame)
    ends = (frame.start, frame.stop, *([] if frame.step is None else [frame.step]))
    return ":".join("" if end is None else str(end) for end in ends)


def _write(destination: Path, pictures: Iterable[np.ndarray]) -> None:
    if destination.suffix == ".mp4":
        _write_mp4(destination, pictures)
        return
    import imageio.v3 as imageio

    content = io.BytesIO()
    film = {"duration": 1000 / _RATE, "loop": 0}
    options = film if destination.suffix == ".gif" else {"dpi": (_DPI, _DPI)}
    with imageio.imopen(content, "w", extension=destination.suffix) as file:
        for picture in pictures:
            file.write(picture, **options)
    destination.write_bytes(content.getvalue())


def _write_mp4(destination: Path, pictures: Iterable[np.ndarray]) -> None:
    import imageio.v2 as imageio

    writer: Any = imageio.get_writer(destination, fps=_RATE, quality=8, macro_block_size=2)
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
