"""Pictures and films of a run."""

from __future__ import annotations

import ctypes
import io
import os
import sys
from collections.abc import Iterable
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from mrs.output import run_directory
from mrs.output.atomic import replacing
from mrs.output.camera import Camera, Places, stage_of
from mrs.output.colors import colors_of
from mrs.output.drawing import picture
from mrs.output.frames import Frames, trajectories
from mrs.output.stored import stored_boundary
from mrs.output.trajectory import Trajectory

_FILMS = (".mp4", ".gif")
_RATE = 24  # pictures a second of a film


def render(
    directory: str | os.PathLike[str],
    destination: str | os.PathLike[str],
    *,
    frame: int | slice | None = None,
    color_by: str | None = None,
    camera: Camera | None = None,
    size: tuple[int, int] = (1280, 800),
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
    camera : (position, focal point, up), optional
        Three points each; by default all frames fit into the picture.
    size : (width, height), optional
        In pixels.

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
    """
    destination = Path(destination)
    wanted = _wanted(frame, destination)
    with trajectories(directory) as bodies:
        frames = _frames(bodies, wanted)
        colors = colors_of(bodies, frames, color_by)
        first = bodies[0]
        times = [first.times[places[0]] for places in frames]
        boundaries = [stored_boundary(first.meta, time) for time in times]
        stage = stage_of(bodies, frames, camera, size, boundaries)
        require_opengl()
        destination.parent.mkdir(parents=True, exist_ok=True)
        run_directory.note_made(directory, destination)
        pictures = (
            picture(bodies, places, colors, stage, boundary)
            for places, boundary in zip(frames, boundaries, strict=True)
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


def _frames(bodies: list[Trajectory], wanted: int | slice) -> list[Places]:
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


def _write(destination: Path, pictures: Iterable[np.ndarray]) -> None:
    if destination.suffix == ".mp4":
        _write_mp4(destination, pictures)
        return
    import imageio.v3 as imageio

    content = io.BytesIO()
    options = {"duration": 1000 / _RATE, "loop": 0} if destination.suffix == ".gif" else {}
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
