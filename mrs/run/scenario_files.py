"""Scenarios by name: those that come with the project, those in Python files, TOML files."""

from __future__ import annotations

import importlib
import importlib.machinery
import importlib.util
import pkgutil
import re
import sys
from pathlib import Path
from typing import Any

from mrs import check
from mrs.output import run_directory
from mrs.run.scenario import PACKAGE, Scenario, ScenarioError

FILE_PREFIX = "file_"  # of the module made of a scenario in a file


def known() -> list[str]:
    """Return the names of the scenarios that come with the project."""
    package = importlib.import_module(PACKAGE)
    return [module.name for module in pkgutil.iter_modules(package.__path__)]


def find(name: str) -> type[Scenario]:
    """Return the scenario called `name`, or the one in a Python file.

    Parameters
    ----------
    name : str
        Of one that comes with the project; or "FILE.py"; or, of a file with several,
        "FILE.py:CLASS".

    Raises
    ------
    ScenarioError
        If there is none; the message names the nearest one.
    """
    in_file = re.fullmatch(r"(.+\.py)(?::(\w+))?", name, re.IGNORECASE)
    if in_file:
        return _only(import_file("scenario", Path(in_file[1])), name, in_file[2])
    if name == "scene":
        from mrs.run.toml_scene import scene  # its models take a while to make

        return scene()
    if name not in known():
        raise ScenarioError(
            f"scenario: {name!r} is not known{check.nearest(name, known())}; "
            f"there are {', '.join(known())}"
        )
    return _only(importlib.import_module(f"{PACKAGE}.{name}"), name)


def make(name: str, options: dict[str, Any], *, quick: bool = False) -> Scenario:
    """Return the scenario with options, which override the options of its quick version.

    Raises
    ------
    ScenarioError
        The message names each option, its value and the allowed values, or the nearest option.
    """
    options = _beside(Path(), options)
    load_plugins(options)
    scenario = find(name)
    return scenario(**(scenario.quick if quick else {}) | options)


def assign(options: dict[str, Any], item: str) -> None:
    """Put "a.b=value" into nested tables of options; a value is read as TOML, else it is text.

    Raises
    ------
    ScenarioError
        If it is not of this form, or a table is asked for where there is a value.
    """
    path, separator, text = item.partition("=")
    if not separator:
        raise ScenarioError(f"--set: {item!r} must be KEY=VALUE")
    *groups, last = path.strip().split(".")
    for group in groups:
        options = options.setdefault(group, {})
        if not isinstance(options, dict):
            raise ScenarioError(f"--set: {item!r}, but {group!r} has a value already")
    try:
        options[last] = run_directory.tomllib.loads(f"value = {text}")["value"]
    except run_directory.tomllib.TOMLDecodeError:
        options[last] = text.strip()


def load_plugins(options: dict[str, Any]) -> None:
    """Import the files that the option `plugins` names: they register what they define.

    Raises
    ------
    ScenarioError
        If there is no such file.
    """
    files = options.get("plugins")
    for file in files if isinstance(files, list) else ():
        import_file("plugins", Path(str(file)))


def _beside(folder: Path, options: dict[str, Any]) -> dict[str, Any]:
    """Return options in which the plugins that are named relative to a folder have whole paths."""
    files = options.get("plugins")
    if not isinstance(files, list):  # refused with the other options
        return options
    return options | {"plugins": [str((folder / str(file)).resolve()) for file in files]}


def _only(module: Any, name: str, wanted: str | None = None) -> type[Scenario]:
    """Return the scenario that a module defines; the `wanted` one of several."""
    found = {
        value.__name__: value
        for value in vars(module).values()
        if isinstance(value, type)
        and issubclass(value, Scenario)
        and value.__module__ == module.__name__
    }
    if wanted is None and len(found) == 1:
        return next(iter(found.values()))
    if wanted in found:
        return found[wanted]
    names = ", ".join(found) or "none"
    if wanted is None and found:
        raise ScenarioError(
            f"scenario: {name!r} defines several ({names}); say which: {name}:{next(iter(found))}"
        )
    raise ScenarioError(
        f"scenario: {name!r} must define {wanted or 'a class derived from mrs.Scenario'}, "
        f"it has {names}"
    )


def import_file(option: str, path: Path) -> Any:
    """Return the module of a Python file, which is executed.

    Parameters
    ----------
    option : str
        That names the file, for the message.
    path : Path

    Raises
    ------
    ScenarioError
        If there is no such file.
    """
    if not path.is_file():
        raise ScenarioError(f"{option}: there is no file {str(path)!r}")
    loader = importlib.machinery.SourceFileLoader(FILE_PREFIX + path.stem, str(path))
    spec = importlib.util.spec_from_loader(loader.name, loader)
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # annotations are looked up there
    loader.exec_module(module)
    return module


def read_input(path: str | Path) -> tuple[str, dict[str, Any]]:
    """Return scenario and options of a TOML file: one of one's own, or the config.toml of a run.

    Raises
    ------
    ScenarioError
        If it is not TOML, or has keys besides `scenario`, `options`, and the keys that a run adds.
    """
    content = run_directory.load_toml(path)
    unknown = set(content) - {"scenario", "options", "run", "versions"}
    if unknown or "scenario" not in content:
        what = f"unknown {', '.join(sorted(unknown))}" if unknown else "no scenario"
        raise ScenarioError(
            f"{path}: {what}; a run made from a scenario, and an input file, have "
            '`scenario = "name"` and a table [options]'
        )
    scenario, options = content["scenario"], content.get("options", {})
    if not isinstance(scenario, str) or not isinstance(options, dict):
        raise ScenarioError(f"{path}: scenario must be a text and options a table")
    return scenario, _beside(Path(path).parent, options)
