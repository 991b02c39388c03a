"""A scenario is a class of options that can build its simulation, run it and check one number."""

from __future__ import annotations

import difflib
import importlib
import importlib.util
import inspect
import pkgutil
import sys
import typing
from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from mrs.mobility import Backend
from mrs.simulation import Simulation
from mrs.stepper import Integrator
from mrs.trackers import Output

FILE_PREFIX = "file_"  # of the module made of a scenario in a file
PACKAGE = "mrs.scenarios"  # those that come with the project: found by name, not imported


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
        expected = f"expected {self.expected:.6g} to {self.tolerance:g}"
        return f"{self.name}: {self.value:.6g}, {expected}: {verdict}"


class Scenario(BaseModel):
    """Options of a scene; a subclass adds its own, and says how to build it.

    Subclasses state in `quick` the options of a version that ends within seconds.
    """

    model_config = ConfigDict(extra="forbid", validate_default=True, allow_inf_nan=False)
    quick: ClassVar[dict[str, Any]] = {}

    t_end: float = Field(1.0, gt=0, description="simulated time")
    interval: float = Field(0.1, gt=0, description="simulated time between frames")
    backend: Backend = Field(Backend(), description="how velocities are summed")
    integrator: Integrator = Field(Integrator(), description="how time is stepped")
    checkpoint_seconds: float = Field(30.0, ge=0, description="real time between checkpoints")
    live: bool = Field(False, description="write .vtp and .pvd as well")

    def build(self, **common: Any) -> Simulation:
        """Return the simulation; `common` goes to `Simulation` as it is."""
        raise NotImplementedError

    def check(self, sim: Simulation) -> Check:
        """Return the number that a finished run is judged by."""
        raise NotImplementedError

    def simulation(
        self, directory: str | Path | None = None, *, overwrite: bool = False
    ) -> Simulation:
        """Return the simulation, writing to `directory` if that is given."""
        output = None
        if directory is not None:
            output = Output(directory, self.interval, self.checkpoint_seconds, overwrite, self.live)
        options = self.model_dump(mode="json", exclude_none=True)
        return self.build(
            backend=self.backend,
            integrator=self.integrator,
            output=output,
            recipe={"scenario": name_of(type(self)), "options": options},
        )


def known() -> list[str]:
    """Return the names of the scenarios that come with the project."""
    package = importlib.import_module(PACKAGE)
    return [module.name for module in pkgutil.iter_modules(package.__path__)]


def find(name: str) -> type[Scenario]:
    """Return the scenario called `name`, or the one in the Python file `name`.

    Raises
    ------
    ScenarioError
        If there is none; the message names the nearest one.
    """
    if name.endswith(".py"):
        return _only(_import_file(Path(name)), name)
    if name == "scene":
        return _only(importlib.import_module("mrs.scene"), name)
    if name not in known():
        raise ScenarioError(
            f"scenario: {name!r} is not known{_nearest(name, known())}; "
            f"there are {', '.join(known())}"
        )
    return _only(importlib.import_module(f"{PACKAGE}.{name}"), name)


def name_of(scenario: type[Scenario]) -> str:
    """Return what `find` finds it by."""
    package, _, module = scenario.__module__.rpartition(".")
    return module if package in (PACKAGE, "mrs") else str(Path(inspect.getfile(scenario)).resolve())


def make(name: str, options: dict[str, Any], *, quick: bool = False) -> Scenario:
    """Return the scenario with options, which override those of its quick version.

    Raises
    ------
    ScenarioError
        The message names each option, its value and what is allowed, and the nearest known option.
    """
    scenario = find(name)
    try:
        return scenario.model_validate((scenario.quick if quick else {}) | options)
    except ValidationError as error:
        lines = [_explain(scenario, item) for item in error.errors()]
        raise ScenarioError("\n".join(lines)) from None


def _only(module: Any, name: str) -> type[Scenario]:
    found = [
        value
        for value in vars(module).values()
        if isinstance(value, type)
        and issubclass(value, Scenario)
        and value.__module__ == module.__name__
    ]
    if len(found) != 1:
        raise ScenarioError(
            f"scenario: {name!r} must define one subclass of mrs.Scenario, has {len(found)}"
        )
    return found[0]


def _import_file(path: Path) -> Any:
    spec = importlib.util.spec_from_file_location(FILE_PREFIX + path.stem, path)
    if not path.is_file() or spec is None or spec.loader is None:
        raise ScenarioError(f"scenario: there is no file {str(path)!r}")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # annotations are looked up there
    spec.loader.exec_module(module)
    return module


def _explain(scenario: type[Scenario], item: Any) -> str:
    place = ".".join(map(str, item["loc"]))
    if item["type"] in ("extra_forbidden", "unexpected_keyword_argument"):
        names = [".".join(path) for path in _paths(scenario)]
        return f"{place}: no such option{_nearest(place, names)}"
    return f"{place}: {item['msg'].lower()}, got {item['input']!r}"


def _nearest(name: str, names: list[str]) -> str:
    close = difflib.get_close_matches(name, names, n=1, cutoff=0.6)
    return f"; did you mean {close[0]!r}?" if close else ""


def _paths(model: Any) -> Iterator[tuple[str, ...]]:
    """Yield the options of a model, those of its parts included."""
    fields = getattr(model, "model_fields", None) or getattr(model, "__dataclass_fields__", {})
    for name, field in fields.items():
        yield (name,)
        for part in _classes(getattr(field, "annotation", None)):
            for path in _paths(part):
                yield (name, *path)


def _classes(annotation: Any) -> Iterator[type]:
    """Yield the classes in an annotation such as ``list[A | B]``."""
    if isinstance(annotation, type):
        yield annotation
    for part in typing.get_args(annotation):
        yield from _classes(part)
