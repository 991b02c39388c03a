"""A scenario is a class of options that can build its simulation, run it and check one number."""

from __future__ import annotations

import difflib
import importlib
import importlib.machinery
import importlib.util
import pkgutil
import re
import sys
import typing
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, ClassVar, NamedTuple

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from mrs import check
from mrs.mobility import Backend
from mrs.simulation import Simulation
from mrs.stepper import Integrator
from mrs.trackers import Output

FILE_PREFIX = "file_"  # of the module made of a scenario in a file
PACKAGE = "scenarios"  # where those that come with the project are; found by name, not imported


class ScenarioError(ValueError):
    """An unknown scenario, an unknown option, or a value that an option does not take."""


class Check(NamedTuple):
    """One number that a run must give."""

    name: str
    value: float
    expected: float
    tolerance: float
    """Relative to `expected`, absolute if that is zero."""

    @property
    def passed(self) -> bool:
        """Whether the value is within the tolerance."""
        return abs(self.value - self.expected) <= self.tolerance * (abs(self.expected) or 1.0)

    def __str__(self) -> str:
        verdict = "ok" if self.passed else "FAILED"
        kind = "relative" if self.expected else "absolute"
        expected = f"expected {self.expected:.6g} to {self.tolerance:g} ({kind})"
        return f"{self.name}: {self.value:.6g}, {expected}: {verdict}"


# A text stands for the name alone, as in Python: backend = "fmm".
_BY_NAME = BeforeValidator(lambda value: {"name": value} if isinstance(value, str) else value)


class Scenario(BaseModel):
    """Options of a scene; a subclass adds its own, and says how to build it.

    Subclasses state in `quick` the options of a version that ends within seconds.

    Raises
    ------
    ScenarioError
        The message names each option, its value and what is allowed, and the nearest known option.
    """

    model_config = ConfigDict(extra="forbid", validate_default=True, allow_inf_nan=False)
    quick: ClassVar[dict[str, Any]] = {}

    t_end: float = Field(1.0, gt=0, description="simulated time")
    interval: float = Field(0.1, gt=0, description="simulated time between frames")
    backend: Annotated[Backend, _BY_NAME] = Field(
        Backend(), description="how velocities are summed"
    )
    integrator: Annotated[Integrator, _BY_NAME] = Field(
        Integrator(), description="how time is stepped"
    )
    checkpoint_seconds: float = Field(30.0, ge=0, description="real time between checkpoints")
    live: bool = Field(False, description="write .vtp and .pvd as well")

    def __init__(self, **options: Any) -> None:
        try:
            super().__init__(**options)
        except ValidationError as error:
            lines = [_explain(type(self), item) for item in error.errors()]
            raise ScenarioError("\n".join(lines)) from None

    def build(self, **common: Any) -> Simulation:
        """Return the simulation; `common` goes to `Simulation` as it is."""
        raise NotImplementedError

    def check(self, sim: Simulation) -> Check:
        """Return the number that a finished run is judged by."""
        raise NotImplementedError

    def simulation(
        self, directory: str | Path | None = None, *, overwrite: bool = False
    ) -> Simulation:
        """Return the simulation, writing to `directory` if that is given.

        A scenario that `find` does not find again (of a notebook, or of the script that runs) is
        not named in config.toml; the run goes on with ``mrs.restart(scenario.simulation(directory))
        .run(t_end)``.
        """
        output = None
        if directory is not None:
            output = Output(directory, self.interval, self.checkpoint_seconds, overwrite, self.live)
        name = name_of(type(self))
        recipe = {} if name is None else {"scenario": name}
        return self.build(
            backend=self.backend,
            integrator=self.integrator,
            output=output,
            recipe=recipe | {"options": self.model_dump(mode="json", exclude_none=True)},
        )


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
        return _only(_import_file(Path(in_file[1])), name, in_file[2])
    if name == "scene":
        return _only(importlib.import_module("mrs.scene"), name)
    if name not in known():
        raise ScenarioError(
            f"scenario: {name!r} is not known{check.nearest(name, known())}; "
            f"there are {', '.join(known())}"
        )
    return _only(importlib.import_module(f"{PACKAGE}.{name}"), name)


def name_of(scenario: type[Scenario]) -> str | None:
    """Return what `find` finds it by; None for a class that only its own program can make.

    The main program counts as such, although it has a file: to import a script is to run it again.
    """
    package, _, module = scenario.__module__.rpartition(".")
    if package in (PACKAGE, "mrs"):
        return module
    found = sys.modules.get(scenario.__module__)
    path = getattr(found, "__file__", None)
    if (
        scenario.__module__ == "__main__"
        or path is None
        or vars(found).get(scenario.__name__) is not scenario
    ):
        return None
    return f"{Path(path).resolve()}:{scenario.__name__}"


def make(name: str, options: dict[str, Any], *, quick: bool = False) -> Scenario:
    """Return the scenario with options, which override those of its quick version.

    Raises
    ------
    ScenarioError
        The message names each option, its value and what is allowed, and the nearest known option.
    """
    scenario = find(name)
    return scenario(**(scenario.quick if quick else {}) | options)


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


def _import_file(path: Path) -> Any:
    if not path.is_file():
        raise ScenarioError(f"scenario: there is no file {str(path)!r}")
    loader = importlib.machinery.SourceFileLoader(FILE_PREFIX + path.stem, str(path))
    spec = importlib.util.spec_from_loader(loader.name, loader)
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # annotations are looked up there
    loader.exec_module(module)
    return module


def _explain(scenario: type[Scenario], item: Any) -> str:
    """Say what pydantic has found wrong in the words of the other refusals."""
    place = ".".join(map(str, item["loc"]))
    if item["type"] in ("extra_forbidden", "unexpected_keyword_argument"):
        return f"{place}: no such option{_suggestion(scenario, item['loc'])}"
    if item["type"] == "missing":
        return f"{place}: must be given"
    if item["type"] == "value_error":  # of a class that checks itself, which says what it got
        return f"{place}: {item['ctx']['error']}"
    return f"{place}: {item['msg'].lower()}, got {item['input']!r}"


def _suggestion(scenario: type[Scenario], place: tuple[int | str, ...]) -> str:
    """Return the option meant at a place, or the nearest place that has one of that name."""
    *before, last = place
    models: list[Any] = [scenario]
    path: list[str] = []
    for word in before:
        parts = [part for model in models for part in _parts(model).get(str(word), ())]
        if parts:
            models, path = parts, [*path, str(word)]
        else:  # which of several classes, as pydantic calls it, or a number in a list
            models = [model for model in models if model.__name__ == word] or models
    options = sorted(_paths(scenario), key=len, reverse=True)
    choices = [[(*path, name) for model in models for name in _parts(model)]]
    for depth in range(len(path), -1, -1):
        choices.append([option for option in options if list(option[:depth]) == path[:depth]])
    for choice in choices:
        names = {option[-1]: ".".join(option) for option in choice}  # the shortest path wins
        close = difflib.get_close_matches(str(last), names, n=1)
        if close:
            return f"; did you mean {names[close[0]]!r}?"
    return ""


def _parts(model: Any) -> dict[str, list[type]]:
    """Return the options of a model, each with the classes that its value may be of."""
    fields = getattr(model, "model_fields", None) or getattr(model, "__dataclass_fields__", {})
    return {
        name: list(_classes(getattr(field, "annotation", None))) for name, field in fields.items()
    }


def _paths(model: Any) -> Iterator[tuple[str, ...]]:
    """Yield the options of a model, those of its parts included."""
    for name, parts in _parts(model).items():
        yield (name,)
        for part in parts:
            for path in _paths(part):
                yield (name, *path)


def _classes(annotation: Any) -> Iterator[type]:
    """Yield the classes in an annotation such as ``list[A | B]``."""
    if isinstance(annotation, type):
        yield annotation
    for part in typing.get_args(annotation):
        yield from _classes(part)
