"""The command line: new, run, resume, info, export, render, plot, field, check."""

from __future__ import annotations

import argparse
import json
import os
import sys
import traceback
from pathlib import Path
from typing import Any

from mrs import check
from mrs.output.stored import QUANTITIES
from mrs.output.trackers import Tracker
from mrs.run import argument_types, making, scenario_files, signals
from mrs.run.info import info
from mrs.run.reports import ProfileTable, Progress
from mrs.run.resuming import resume, scenario_of
from mrs.run.scenario import Scenario
from mrs.run.simulation import Simulation
from treecode.ranks import ranks_of, world
from treecode.version import __version__

_EPILOG = """\
examples:
  mrs new my_scene.py                              a rod and tracers, to change
  mrs run cilia_array --quick                      a small version, ends within seconds
  mrs run swimmer_suspension --set count=200 --set stroke=puller --output outputs/pullers
  mrs run my_scene.toml --max-walltime 3600        stops in good order after an hour
  mrs resume outputs/pullers                       goes on from the last checkpoint
  mrs render outputs/pullers --output movie.mp4

exit status: 0 done, or stopped by --max-walltime; 1 refused, failed, or the checked number FAILED;
2 no such command; 128 + its number when stopped by a signal (130 by ctrl-C)
"""
_FILES = {"bash": "_shtab_compgen_files", "zsh": "_files", "tcsh": "f"}  # as shtab takes it
_READER_GONE = 141  # as shells report a program that SIGPIPE ends
# Errors told in one line. Other errors are the program's own, and their tracebacks are wanted.
_TOLD = (
    ArithmeticError,
    EOFError,
    ImportError,
    IndexError,
    MemoryError,
    OSError,
    RuntimeError,
    TypeError,
    ValueError,
)


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; return the exit status.

    Started by mpirun, it is one of several ranks: those that run share the sums, rank 0 writes and
    speaks, and does alone all that is no run.
    """
    comm = world()
    ranks = ranks_of(comm)
    if ranks.rank:
        sys.stdout = sys.stderr = open(os.devnull, "w")  # noqa: PTH123, SIM115
    options = _parsed(arguments)
    options.comm = comm
    idle = ranks.rank and options.action not in (_run, _resume, _check)
    try:
        # Ranks that a signal stops in the midst of a message would wait for each other.
        with signals.stopping() if ranks.size == 1 else ranks.together():
            status = 0 if idle else options.action(options) or 0
            sys.stdout.flush()
            return status
    except KeyboardInterrupt as stop:
        going = getattr(options, "going", None)
        advice = f"; go on with `mrs resume {going}`" if going else ""
        print(f"{str(stop) or 'stopped'}{advice}", file=sys.stderr)
        if not isinstance(stop, signals.Stopped):  # by default, anywhere
            ranks.abort(128 + signals.CTRL_C)
        return 128 + getattr(stop, "number", signals.CTRL_C)
    except _TOLD as error:
        if isinstance(error, BrokenPipeError) and _reader_is_gone():
            return _READER_GONE
        if _in_users_file(error):
            raise
        print(f"mrs: {_said(error)}", file=sys.stderr)
        return 1


def _said(error: BaseException) -> str:
    text = str(error) or type(error).__name__
    return f"not enough memory: {text}" if isinstance(error, MemoryError) else text


def _reader_is_gone() -> bool:
    """Return whether the reader of the output, such as `head`, has ended; then print no more."""
    try:
        print(flush=True)  # another pipe may be broken, such as the one to the encoder of a film
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return True
    return False


def _in_users_file(error: Exception) -> bool:
    """Return whether the error came out of a scenario in a file of the user's: show where."""
    frames = (frame for frame, _ in traceback.walk_tb(error.__traceback__))
    modules = (frame.f_globals.get("__name__", "") for frame in frames)
    return any(module.startswith(scenario_files.FILE_PREFIX) for module in modules)


def _parsed(arguments: list[str] | None) -> argparse.Namespace:
    """Return the options; leave with status 2 if there is no such one, and name the nearest."""
    options, unknown = parser().parse_known_args(arguments)
    if unknown:
        names = [word for flags in _COMMANDS[options.command][2] for word in flags.split()]
        near = check.nearest(unknown[0].partition("=")[0], names)
        options.parser.error(f"unrecognized arguments: {' '.join(unknown)}{near}")
    return options


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line; shtab makes completions of a shell from it."""
    parser = argparse.ArgumentParser(
        prog="mrs",
        description="Elastic rods and swimmers in very viscous fluid, by regularized Stokeslets.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"%(prog)s {__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND", dest="command")
    for name, (action, text, arguments) in _COMMANDS.items():
        command = commands.add_parser(name, help=text, description=text.capitalize() + ".")
        command.set_defaults(action=action, parser=command)
        for flags, settings in arguments.items():
            argument: Any = command.add_argument(*flags.split(), **settings)
            if settings.get("type") is Path or flags == "scene":
                argument.complete = _FILES
    return parser


def _run(options: argparse.Namespace) -> int:
    name = options.scene
    values: dict[str, Any] = {}
    if Path(name).suffix.lower() == ".toml":
        name, values = scenario_files.read_input(name)
    for item in options.set:
        scenario_files.assign(values, item)
    scene = scenario_files.make(name, values, quick=options.quick)
    if options.options:
        _print_options(scene)
        return 0
    directory = options.output or Path("outputs") / Path(options.scene).stem
    sim = scene.simulation(directory, overwrite=options.overwrite, comm=options.comm)
    sim.trackers.extend(_trackers(options))
    options.going = directory
    sim.run(scene.t_end, max_walltime=options.max_walltime)
    options.going = None
    passed = _report(sim, scene, directory)
    if options.picture and sim.ranks.rank == 0:
        from mrs.output.render import render

        render(directory, directory / "picture.png")
        print(directory / "picture.png")
    return 0 if passed else 1


def _trackers(options: argparse.Namespace) -> list[Tracker]:
    return [Progress(), ProfileTable()] if options.profile else [Progress()]


def _print_options(scene: Scenario) -> None:
    values = scene.model_dump(mode="json")
    for name, field in type(scene).model_fields.items():
        print(f"{name} = {json.dumps(values[name])}\n    {field.description or ''}")


def _report(sim: Simulation, scene: Scenario, directory: Path) -> bool:
    """Print the state of a run; return False if it is at its end with a wrong number."""
    names = ", ".join(sorted(set(map(str, sim.scene.choices)))) or "no sums"
    print(
        f"{directory}: t = {sim.time:g}, {sim.stepper.steps} steps, "
        f"{sim.stepper.rejections} rejected, {sim.scene.evaluations} evaluations by {names}"
    )
    if sim.time < sim.t_end:
        return True
    result = scene.check(sim)
    print(result)
    return result.passed


def _resume(options: argparse.Namespace) -> int:
    options.going = options.directory
    sim = resume(
        options.directory,
        options.t_end,
        _trackers(options),
        max_walltime=options.max_walltime,
        changes=options.changes,
        renew_files=options.renew_files,
        comm=options.comm,
    )
    options.going = None
    passed = _report(sim, scenario_of(options.directory), options.directory)
    return 0 if passed else 1


def _info(options: argparse.Namespace) -> None:
    found = info(options.directory)
    if options.json:
        print(json.dumps(found, indent=2))
        return
    saved = found["checkpoint"] or {"error": "no checkpoint yet"}
    state = "finished" if found["finished"] else "not finished"
    print(
        f"{found.get('scenario', 'script')}: t = {found['time']:g} of {found['run']['t_end']:g}, "
        f"{found['steps']} steps, {state}; "
        + saved.get("error", f"checkpoint at t = {saved.get('time', 0.0):g}")
    )
    for name, file in found["files"].items():
        until = "" if file.get("time") is None else f", the last at t = {file['time']:g}"
        told = file.get("error") or f"{file['frames']} frames of {file['points']} points{until}"
        print(f"  {name}: {told}")
    if "error" in found["log"]:
        print(f"  log.csv: {found['log']['error']}")


def _check(options: argparse.Namespace) -> int:
    names = [options.scene] if options.scene else scenario_files.known()
    passed = True
    for name in names:
        scene = scenario_files.make(name, {}, quick=not options.full)
        result = scene.check(scene.simulation(comm=options.comm).run(scene.t_end))
        print(f"{name}: {result}", flush=True)
        passed &= result.passed
    return 0 if passed else 1


_DIRECTORY = {"directory": {"type": Path, "help": "run directory"}}
_GOING: dict[str, dict[str, Any]] = {
    "--max-walltime": {
        "type": float,
        "metavar": "SECONDS",
        "help": "stop in good order after that",
    },
    "--profile": {"action": "store_true", "help": "print a table of where the time went"},
}

# name: (action, help, arguments as argparse takes them)
_COMMANDS: dict[str, tuple[Any, str, dict[str, dict[str, Any]]]] = {
    "new": (
        making.new,
        "write a scene to begin with, as a Python file",
        {"file": {"type": Path, "metavar": "FILE.py"}},
    ),
    "run": (
        _run,
        "begin a run",
        {
            "scene": {
                "metavar": "SCENARIO|FILE.toml|FILE.py[:CLASS]",
                "help": f"one of {', '.join(scenario_files.known())}; or a file",
            },
            "--quick": {"action": "store_true", "help": "a small version that ends within seconds"},
            "--output": {
                "type": Path,
                "metavar": "DIR",
                "help": "run directory (default outputs/SCENARIO)",
            },
            "--overwrite": {"action": "store_true", "help": "delete an earlier run there"},
            "--set": {
                "action": "append",
                "default": [],
                "metavar": "KEY=VALUE",
                "help": "an option, such as t_end=2 or backend.name=kitc",
            },
            "--options": {"action": "store_true", "help": "list the options and stop"},
            "--picture": {"action": "store_true", "help": "draw the last frame when done"},
            **_GOING,
        },
    ),
    "resume": (
        _resume,
        "go on from the last checkpoint",
        {
            **_DIRECTORY,
            "--t-end": {"type": float, "help": "a new end of simulated time"},
            "--changes": {
                "action": "store_true",
                "help": "go on with other physics than before, after options were edited in "
                "config.toml",
            },
            "--renew-files": {
                "action": "store_true",
                "help": "begin files anew that are missing, damaged or of another scene; "
                "damaged ones are kept beside",
            },
            **_GOING,
        },
    ),
    "info": (
        _info,
        "show the contents of a run directory",
        {**_DIRECTORY, "--json": {"action": "store_true", "help": "for programs"}},
    ),
    "check": (
        _check,
        "run a scenario and compare its one checked number",
        {
            "scene": {
                "metavar": "SCENARIO",
                "nargs": "?",
                "help": "all that come with the project by default",
            },
            "--full": {"action": "store_true", "help": "not the quick version"},
        },
    ),
    "export": (
        making.export,
        "convert frames for other programs",
        {
            **_DIRECTORY,
            "--format": {
                "default": "vtp",
                "help": "vtp, vtu, xdmf, vtk or med (default %(default)s)",
            },
            "--output": {"type": Path, "metavar": "DIR", "help": "default DIRECTORY/FORMAT"},
        },
    ),
    "render": (
        making.render,
        "draw a picture (.png) or a film (.mp4, .gif)",
        {
            **_DIRECTORY,
            "--output": {
                "type": Path,
                "metavar": "FILE",
                "help": "default DIRECTORY/picture.png; the suffix chooses picture or film",
            },
            "--frame": {
                "type": argument_types.frames,
                "metavar": "N|A:B",
                "help": "of a picture, the number of its frame (default the last; --frame=-2 from "
                "the end); of a film, frames as Python counts, such as 10:20 or ::2 (default all)",
            },
            "--color-by": {
                "metavar": "FIELD",
                "help": "a field at points or rods, such as velocity or tension",
            },
            "--color-range": {
                "type": argument_types.interval,
                "metavar": "LOW,HIGH",
                "help": "values of the first and the last colour (default of all frames drawn)",
            },
            "--camera": {
                "type": argument_types.camera,
                "metavar": "X,Y,Z,...",
                "help": "nine numbers: position, focal point, up",
            },
            "--size": {
                "type": argument_types.size,
                "default": (1280, 800),
                "metavar": "W,H",
                "help": "in pixels (default 1280,800); a .png has 300 an inch",
            },
            "--trails": {
                "type": int,
                "default": 0,
                "metavar": "N",
                "help": "lines through the places of tracers in the N frames before",
            },
            "--scale-bar": {
                "nargs": "?",
                "const": "",
                "metavar": "UNIT",
                "help": "draw a bar of a round length, with the unit of length",
            },
            "--transparent": {"action": "store_true", "help": "no paper behind a .png"},
        },
    ),
    "plot": (
        making.plot,
        "draw columns of the log over time",
        {
            **_DIRECTORY,
            "--columns": {
                "nargs": "+",
                "metavar": "NAME",
                "help": "of log.csv (default elastic_energy max_speed dt)",
            },
            "--output": {
                "type": Path,
                "metavar": "FILE",
                "help": "a .png, .svg or .pdf (default DIRECTORY/log.png)",
            },
        },
    ),
    "field": (
        making.field,
        "velocity on a grid or along a line, and streamlines",
        {
            **_DIRECTORY,
            "--frame": {
                "type": int,
                "default": -1,
                "help": "number of the frame (default the last)",
            },
            "--plane": {
                "type": argument_types.plane,
                "metavar": "AXIS=PLACE",
                "help": "a plane such as z=0.5 in place of a box, without streamlines",
            },
            "--box": {
                "type": argument_types.ends,
                "metavar": "X,Y,Z,X,Y,Z",
                "help": "two opposite corners of the grid, as in --box=-1,-1,0,1,1,2 (default "
                "around the bodies)",
            },
            "--line": {
                "type": argument_types.ends,
                "metavar": "X,Y,Z,X,Y,Z",
                "help": "two ends of a line, in place of a grid: writes line.csv",
            },
            "--seed": {
                "action": "append",
                "dest": "seeds",
                "type": argument_types.point,
                "metavar": "X,Y,Z",
                "help": "a point that a streamline goes through; may be given again (default a "
                "regular pattern)",
            },
            "--also": {
                "nargs": "+",
                "default": [],
                "choices": QUANTITIES[1:],
                "help": "further arrays: vorticity, and in free space pressure",
            },
            "--resolution": {
                "type": int,
                "default": 40,
                "help": "points along the longest side, or the line (default %(default)s)",
            },
            "--output": {"type": Path, "metavar": "DIR", "help": "default DIRECTORY"},
        },
    ),
}


if __name__ == "__main__":
    sys.exit(main())
