"""A scene of one's own from a TOML file: its options are the arguments of the Python functions.

scenario = "scene"
[options.fluid]
viscosity = 1.0
epsilon = 0.1
background = { kind = "shear", rate = 1.0 }
[[options.rods]]
shape = { kind = "helix", radius = 0.3, pitch = 3.14, length = 6.0, nodes = 76 }
origins = [[0, 0, 0], [2, 0, 0]]
bending = 1.0
...
"""

from __future__ import annotations

import inspect
import typing
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Annotated, Any, Literal, Union

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, create_model

from mrs import flows, geometry
from mrs.rods import Drive, Rods, TravellingWave
from mrs.scenario import Check, Scenario, ScenarioError
from mrs.simulation import Fluid, Simulation
from mrs.steric import Steric
from mrs.swimmers import Swimmers, lattice_suspension, random_suspension
from mrs.tracers import Tracers

_STRICT = ConfigDict(extra="forbid", allow_inf_nan=False)


class _Call(BaseModel):
    """Arguments of a function."""

    model_config = _STRICT

    def arguments(self) -> dict[str, Any]:
        """Return those that were given."""
        return {name: getattr(self, name) for name in self.model_fields_set if name != "kind"}


def _call(
    function: Callable, kind: str | None = None, leave_out: str = "", **instead: Any
) -> type[_Call]:
    """Return a model of a function's arguments.

    `instead` has types that say more than the annotations, or pairs of a type and a default.
    """
    hints = typing.get_type_hints(function.__init__ if inspect.isclass(function) else function)
    fields: dict[str, Any] = {} if kind is None else {"kind": (Literal[kind], ...)}
    for name, parameter in inspect.signature(function).parameters.items():
        default = ... if parameter.default is parameter.empty else parameter.default
        fields[name] = (instead.pop(name, hints[name]), default)
        if isinstance(fields[name][0], tuple):
            fields[name] = fields[name][0]
    fields.pop(leave_out, None)
    return create_model(kind or function.__name__, __base__=_Call, **(fields | instead))


def _one_of(*functions: Callable) -> Any:
    """Return a field that takes the arguments of one of the functions, named by `kind`."""
    models = tuple(_call(function, function.__name__) for function in functions)
    return Annotated[Union[models], Field(discriminator="kind")]  # noqa: UP007


Shape = _one_of(geometry.straight, geometry.helix, geometry.ring, geometry.at_rest)
Background = _one_of(flows.shear, flows.extension, flows.poiseuille)
Suspension = _one_of(random_suspension, lattice_suspension)
Vectors = list[tuple[float, float, float]]

FluidOptions: Any = _call(Fluid, background=Background | None)
RodOptions: Any = _call(
    Rods,
    leave_out="centerlines",
    shape=(Shape, ...),
    origins=(Vectors, [(0.0, 0.0, 0.0)]),
    intrinsic_curvature=Literal["initial"] | Vectors | tuple[float, float, float],
    beat=TravellingWave | None,
    base=Literal["free", "clamped"] | Drive,
)
SwimmerOptions: Any = _call(
    Swimmers,
    positions=(Vectors | None, None),
    orientations=(Vectors | None, None),
    suspension=(Suspension | None, None),
)
TracerOptions: Any = _call(Tracers, positions=Vectors)


class Scene(Scenario):
    """Any fluid with any bodies."""

    # The types are made above from the functions' signatures, which mypy does not follow.
    fluid: FluidOptions = Field(FluidOptions(), description="arguments of mrs.Fluid")  # type: ignore[valid-type]
    rods: list[RodOptions] = Field(  # type: ignore[valid-type]
        [], description="arguments of mrs.Rods, with shape and origins"
    )
    swimmers: list[SwimmerOptions] = Field(  # type: ignore[valid-type]
        [], description="arguments of mrs.Swimmers, or a suspension"
    )
    tracers: list[TracerOptions] = Field(  # type: ignore[valid-type]
        [], description="arguments of mrs.Tracers"
    )
    steric: Steric | None = Field(None, description="repulsion between all bodies")

    def build(self, **common: Any) -> Simulation:
        """Return the scene."""
        with _at("fluid"):
            fluid = _fluid(self.fluid)
        bodies = []
        for name, make in (("rods", _rods), ("swimmers", _swimmers), ("tracers", _tracers)):
            for i, options in enumerate(getattr(self, name)):
                with _at(f"{name}.{i}"):
                    bodies.append(make(options))
        return Simulation(fluid, bodies, steric=self.steric, **common)

    def check(self, sim: Simulation) -> Check:
        """Return how many coordinates are not finite."""
        bad = sum(int((~np.isfinite(array)).sum()) for array in sim.state)
        return Check("coordinates that are not finite", bad, 0.0, 0.0)


@contextmanager
def _at(place: str) -> Iterator[None]:
    """Name the place of what is refused."""
    try:
        yield
    except (TypeError, ValueError) as error:
        raise ScenarioError(f"{place}: {error}") from None


def _fluid(options: Any) -> Fluid:
    arguments = options.arguments()
    background = arguments.pop("background", None)
    if background is not None:
        with _at("background"):
            arguments["background"] = getattr(flows, background.kind)(**background.arguments())
    return Fluid(**arguments)


def _rods(options: Any) -> Rods:
    arguments = options.arguments()
    shape = arguments.pop("shape")
    with _at("shape"):
        centerline = getattr(geometry, shape.kind)(**shape.arguments())
    origins = arguments.pop("origins", [(0.0, 0.0, 0.0)])
    return Rods(geometry.array(centerline, origins), **arguments)


def _swimmers(options: Any) -> Swimmers:
    arguments = options.arguments()
    suspension = arguments.pop("suspension", None)
    where = {"positions", "orientations"} & set(arguments)
    if len(where) != (2 if suspension is None else 0):
        raise ValueError("must have either a suspension, or positions and orientations")
    if suspension is not None:
        make = {f.__name__: f for f in (random_suspension, lattice_suspension)}[suspension.kind]
        with _at("suspension"):
            arguments["positions"], arguments["orientations"] = make(**suspension.arguments())
    return Swimmers(**arguments)


def _tracers(options: Any) -> Tracers:
    return Tracers(**options.arguments())
