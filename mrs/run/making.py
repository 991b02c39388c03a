"""Commands that make files: a new scene; pictures, curves, fields and exports of a run."""

from __future__ import annotations

import argparse
from importlib import resources
from pathlib import Path

from mrs.run.velocity import write_field, write_line

_TEMPLATE = "my_scene.py"


def new(options: argparse.Namespace) -> None:
    """Write a scene to begin with."""
    path: Path = options.file
    if path.suffix != ".py":
        raise ValueError(f"FILE.py must end in .py, got {str(path)!r}")
    text = resources.files("mrs.run").joinpath(_TEMPLATE).read_text("utf-8")
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(text.replace(_TEMPLATE, path.name))
    except FileExistsError:
        raise FileExistsError(f"{path} is there already; nothing was written") from None
    print(f"{path}; begin with\n  mrs run {path} --quick --picture")


def export(options: argparse.Namespace) -> None:
    """Write all frames in another format."""
    from mrs.output.export import export

    files = export(options.directory, options.format, options.output)
    print(f"{len(files)} files in {files[0].parent}")


def render(options: argparse.Namespace) -> None:
    """Draw a picture or a film."""
    from mrs.output.render import render

    destination = options.output or options.directory / "picture.png"
    camera = (
        None if options.camera is None else [tuple(options.camera[i : i + 3]) for i in (0, 3, 6)]
    )
    render(
        options.directory,
        destination,
        frame=options.frame,
        color_by=options.color_by,
        color_range=options.color_range,
        camera=camera,
        size=options.size,
        trails=options.trails,
        scale_bar=options.scale_bar,
        transparent=options.transparent,
    )
    print(destination)


def plot(options: argparse.Namespace) -> None:
    """Draw columns of the log."""
    from mrs.output.plot import COLUMNS, plot

    destination = options.output or options.directory / "log.png"
    print(plot(options.directory, destination, options.columns or COLUMNS))


def field(options: argparse.Namespace) -> None:
    """Write the flow on a grid or along a line, and print its errors."""
    common = (options.frame, options.resolution, options.output)
    of_grid = options.plane, options.box, options.seeds
    if options.line is None:
        plane, box, seeds = of_grid
        found = write_field(options.directory, *common, plane, options.also, box, seeds)
    elif any(option is not None for option in of_grid):
        raise ValueError("--line is in place of a grid, and takes no --plane, --box or --seed")
    else:
        found = write_line(options.directory, options.line, *common, options.also)
    print(*found.paths, sep="\n")
    print(
        f"t = {found.time:g}; relative error of the velocity: {found.error.sums:.1e} by sums, "
        f"{found.error.rounding:.1e} by stored single precision; "
        f"{found.error.at_bodies:.1e} beside the velocities stored with the frame"
    )
    for name, error in found.errors.items():
        print(
            f"relative error of the {name}: {error.sums:.1e} by sums, "
            f"{error.rounding:.1e} by stored single precision"
        )
