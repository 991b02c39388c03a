"""A scenario is a class of options that can build its simulation, run it and check one number."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, NamedTuple

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from mrs import check
from mrs.fluid.mobility import Backend
from mrs.observables import columns
from mrs.output.formats import FORMATS
from mrs.output.options import Output
from mrs.run.option_errors import explain
from mrs.run.simulation import Simulation
from mrs.time.stepper import Integrator

PACKAGE = "mrs.scenarios"  # those that come with the project: found by name, not imported


class ScenarioError(ValueError):
    """An unknown scenario, an unknown option, or a value that an option does not take.

    Examples
    --------
    >>> import mrs
    >>> mrs.Scenario(intervall=0.1)
    Traceback (most recent call last):
        ...
    mrs.run.scenario.ScenarioError: intervall: no such option; did you mean 'interval'?
    """


class Check(NamedTuple):
    """One number that a run must give.

    Examples
    --------
    >>> import mrs
    >>> check = mrs.Check("drag over Stokes's", 1.007, expected=1.0, tolerance=0.01)
    >>> check.passed
    True
    >>> print(check)
    drag over Stokes's: 1.007, expected 1 to 0.01 (relative): ok
    """

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


def _known(formats: list[str]) -> list[str]:
    return [check.one_of(f"formats[{i}]", name, FORMATS) for i, name in enumerate(formats)]


def _measurable(tables: dict[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
    columns.from_tables(tables)
    return tables


class Scenario(BaseModel):
    """Options of a scene; a subclass adds its own, and says how to build it.

    Subclasses state in `quick` the options of a version that ends within seconds.

    Raises
    ------
    ScenarioError
        The message names each option, its value and the allowed values, or the nearest option.

    Examples
    --------
    >>> import mrs
    >>> class Fall(mrs.Scenario):
    ...     weight: float = 1.0
    ...
    ...     def build(self, **common):
    ...         ball = mrs.Rigid(mrs.surfaces.sphere(1.0, count=50), force=(0, 0, -self.weight))
    ...         return mrs.Simulation(mrs.Fluid(), [ball], **common)
    >>> fall = Fall(weight=18.85, t_end=0.5)
    >>> sim = fall.simulation().run(fall.t_end)
    >>> print(round(sim.state.positions[0, 2], 1))
    -0.5
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
    formats: Annotated[list[str], AfterValidator(_known)] = Field(
        ["vtkhdf"], description="of trajectories; 'pvd' is for ParaView before 5.12"
    )
    observables: Annotated[dict[str, dict[str, Any]], AfterValidator(_measurable)] = Field(
        {}, description="columns of log.csv: kind and arguments of a class of mrs.observables"
    )
    plugins: list[str] = Field(
        [],
        description="Python files that register bodies, forces, formats, observables of one's own",
    )

    def __init__(self, **options: Any) -> None:
        try:
            super().__init__(**options)
        except ValidationError as error:
            lines = [explain(type(self), item) for item in error.errors()]
            raise ScenarioError("\n".join(lines)) from None

    @property
    def log_columns(self) -> Mapping[str, Callable[[Simulation], Any]]:
        """Columns of log.csv that a subclass adds, each a function of the simulation."""
        return {}

    def build(self, **common: Any) -> Simulation:
        """Return the simulation; `common` goes to `Simulation` as it is."""
        raise NotImplementedError

    def check(self, sim: Simulation) -> Check:
        """Return the number that a finished run is judged by."""
        raise NotImplementedError

    def simulation(
        self, directory: str | Path | None = None, *, overwrite: bool = False, comm: Any = None
    ) -> Simulation:
        """Return the simulation, writing to `directory` if that is given, over ranks of `comm`.

        A scenario that `find` does not find again (of a notebook, or of the script that runs) is
        not named in config.toml; the run goes on with ``mrs.restart(scenario.simulation(directory))
        .run(t_end)``.
        """
        output = None
        if directory is not None:
            output = Output(
                directory,
                self.interval,
                self.checkpoint_seconds,
                overwrite,
                self.formats,
                {**self.log_columns, **columns.from_tables(self.observables)},
            )
        name = name_of(type(self))
        recipe = {} if name is None else {"scenario": name}
        return self.build(
            backend=self.backend,
            integrator=self.integrator,
            output=output,
            recipe=recipe | {"options": self.model_dump(mode="json", exclude_none=True)},
            comm=comm,
        )


def name_of(scenario: type[Scenario]) -> str | None:
    """Return the name for `scenario_files.find`; None if only the class's own program can make it.

    The main program counts as such, although it has a file: to import a script is to run it again.
    """
    package, _, module = scenario.__module__.rpartition(".")
    if package == PACKAGE:
        return module
    if scenario.__module__ == "mrs.run.toml_scene":
        return "scene"
    found = sys.modules.get(scenario.__module__)
    path = getattr(found, "__file__", None)
    if (
        scenario.__module__ == "__main__"
        or path is None
        or vars(found).get(scenario.__name__) is not scenario
    ):
        return None
    return f"{Path(path).resolve()}:{scenario.__name__}"
