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
import os
import typing
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import is_dataclass
from typing import Annotated, Any, Literal, Union

import numpy as np
from numpy.typing import ArrayLike
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, create_model

from mrs.bodies import (
    BODIES,
    Beat,
    Body,
    Drive,
    Mount,
    Prescribed,
    Rigid,
    Rods,
    Swimmers,
    Taper,
    Tracers,
    TravellingWave,
    Turning,
    geometry,
    lattice_suspension,
    random_suspension,
    surfaces,
)
from mrs.fluid import BOUNDARIES, Fluid, flows
from mrs.forces import FORCES, Force
from mrs.run.scenario import Check, Scenario, ScenarioError
from mrs.run.simulation import Simulation

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
        fields[name] = (instead.pop(name, _data(hints.get(name, Any))), default)
        if isinstance(fields[name][0], tuple):
            fields[name] = fields[name][0]
    fields.pop(leave_out, None)
    return create_model(kind or function.__name__, __base__=_Call, **(fields | instead))


def _data(hint: Any) -> Any:
    """Return the type that pydantic checks: a text for a path, any for arrays.

    Arrays are checked by the function itself.
    """
    parts = typing.get_args(hint)
    if any(typing.get_origin(part) is os.PathLike for part in parts):
        return str
    return Any if set(typing.get_args(ArrayLike)) <= set(parts) else hint


def _one_of(*functions: Callable) -> Any:
    """Return a field that takes the arguments of one of the functions, named by `kind`."""
    return _named({function.__name__: function for function in functions})


def _named(functions: Mapping[str, Callable]) -> Any:
    """Return a field that takes the arguments of one of the functions, by their names in `kind`."""
    models = tuple(_call(function, kind) for kind, function in functions.items())
    return Annotated[Union[models], Field(discriminator="kind")]  # noqa: UP007


Shape = _one_of(geometry.straight, geometry.helix, geometry.ring, geometry.at_rest)
Background = _one_of(flows.shear, flows.extension, flows.poiseuille)
Suspension = _one_of(random_suspension, lattice_suspension)
Solid = _one_of(
    surfaces.sphere,
    surfaces.ellipsoid,
    surfaces.capsule,
    surfaces.disc,
    surfaces.helix,
    surfaces.read,
)
Vectors = list[tuple[float, float, float]]
_ONE_OR_MORE = BeforeValidator(lambda value: [value] if isinstance(value, Mapping) else value)

# Bodies whose options in TOML differ from the arguments of their class, and their making.
_ROD_OPTIONS: Any = _call(
    Rods,
    leave_out="centerlines",
    shape=(Shape, ...),
    origins=(Vectors, [(0.0, 0.0, 0.0)]),
    intrinsic_curvature=Literal["initial"] | Vectors | tuple[float, float, float],
    beat=TravellingWave | None,
    base=Literal["free", "clamped"] | Drive | Mount,
)
_FLAGELLUM: Any = _call(
    Turning,
    leave_out="fixed",
    turning=(Solid, ...),
    shift=(tuple[float, float, float], (0.0, 0.0, 0.0)),
)
_RIGID_OPTIONS: Any = _call(
    Rigid,
    shape=(Solid, ...),
    positions=(Vectors, [(0.0, 0.0, 0.0)]),
    motion=Literal["free", "held"] | Drive,
    flagellum=(_FLAGELLUM | None, None),
)
_PRESCRIBED_OPTIONS: Any = _call(
    Rigid,
    shape=(_call(Beat.read), ...),
    positions=(Vectors, [(0.0, 0.0, 0.0)]),
    motion=(Literal["free", "held"] | Drive, "held"),
    name=(str, "prescribed"),
)
_SWIMMER_OPTIONS: Any = _call(
    Swimmers,
    positions=(Vectors | None, None),
    orientations=(Vectors | None, None),
    suspension=(Suspension | None, None),
)


class _Scene(Scenario):
    """Any fluid with any bodies and forces."""

    fluid: Any  # `scene` says what it is

    def build(self, **common: Any) -> Simulation:
        """Return the scene."""
        with _at("fluid"):
            fluid = _fluid(self.fluid)
        bodies, forces = [], []
        for kind in BODIES:
            for i, options in enumerate(getattr(self, kind)):
                with _at(f"{kind}.{i}"):
                    bodies.append(_MAKERS.get(kind, BODIES[kind])(**options.arguments()))
        for kind in FORCES:
            for i, options in enumerate(getattr(self, kind)):
                with _at(f"{kind}.{i}"):
                    forces.append(_force(kind, options))
        return Simulation(fluid, bodies, forces=forces, **common)

    def check(self, sim: Simulation) -> Check:
        """Return how many coordinates are not finite."""
        bad = sum(int((~np.isfinite(array)).sum()) for array in sim.state)
        return Check("coordinates that are not finite", bad, 0.0, 0.0)


def scene() -> type[Scenario]:
    """Return the scenario of any fluid with any bodies and forces that are registered.

    Its options are `fluid`, and a list of tables for each kind of body and of force, for example
    ``[[options.rods]]`` and ``[[options.springs]]``. One force of a kind may be a table by itself,
    ``[options.steric]``.
    """
    boundary = _named(BOUNDARIES) | None, None
    fluid: Any = _call(Fluid, background=Background | None, boundary=boundary)
    fields: dict[str, Any] = {
        "fluid": (fluid, Field(fluid(), description="arguments of mrs.Fluid"))
    }
    for kind, body in BODIES.items():
        options: Any = _OPTIONS.get(kind) or _call(body)
        fields[kind] = list[options], Field([], description=f"arguments of {body.__name__}")
    for kind, force in FORCES.items():
        model: Any = force if is_dataclass(force) else _call(force)
        field: Any = Field([], description=f"arguments of {force.__name__}")
        fields[kind] = Annotated[list[model], _ONE_OR_MORE], field
    return create_model("Scene", __base__=_Scene, __module__=__name__, **fields)


@contextmanager
def _at(place: str) -> Iterator[None]:
    """Name the place of an option that is refused."""
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
    boundary = arguments.pop("boundary", None)
    if boundary is not None:
        with _at("boundary"):
            arguments["boundary"] = BOUNDARIES[boundary.kind](**boundary.arguments())
    return Fluid(**arguments)


def _rods(shape: Any, origins: Any = ((0.0, 0.0, 0.0),), **arguments: Any) -> Rods:
    with _at("shape"):
        centerline = getattr(geometry, shape.kind)(**shape.arguments())
    for name, value in arguments.items():
        if isinstance(value, Mapping):
            with _at(name):
                arguments[name] = Taper(**value)
    return Rods(geometry.array(centerline, origins), **arguments)


def _swimmers(suspension: Any = None, **arguments: Any) -> Swimmers:
    where = {"positions", "orientations"} & set(arguments)
    if len(where) != (2 if suspension is None else 0):
        raise ValueError("must have either a suspension, or positions and orientations")
    if suspension is not None:
        make = {f.__name__: f for f in (random_suspension, lattice_suspension)}[suspension.kind]
        with _at("suspension"):
            arguments["positions"], arguments["orientations"] = make(**suspension.arguments())
    return Swimmers(**arguments)


def _rigid(shape: Any, flagellum: Any = None, **arguments: Any) -> Rigid:
    with _at("shape"):
        surface = _solid(shape)
    if flagellum is None:
        return Rigid(surface, **arguments)
    with _at("flagellum"):
        options = flagellum.arguments()
        tail = _solid(options.pop("turning")).moved(options.pop("shift", (0.0, 0.0, 0.0)))
        return Rigid(Turning(surface, tail, **options), **arguments)


def _prescribed(shape: Any, **arguments: Any) -> Prescribed:
    with _at("shape"):
        beat = Beat.read(**shape.arguments())
    return Prescribed(beat, **arguments)


def _solid(options: Any) -> surfaces.Surface:
    surface: surfaces.Surface = getattr(surfaces, options.kind)(**options.arguments())
    return surface


def _force(kind: str, options: Any) -> Force:
    return options if isinstance(options, Force) else FORCES[kind](**options.arguments())


_OPTIONS = {
    "rods": _ROD_OPTIONS,
    "swimmers": _SWIMMER_OPTIONS,
    "tracers": _call(Tracers, positions=Vectors),
    "rigid": _RIGID_OPTIONS,
    "prescribed": _PRESCRIBED_OPTIONS,
}
_MAKERS: dict[str, Callable[..., Body]] = {
    "rods": _rods,
    "swimmers": _swimmers,
    "rigid": _rigid,
    "prescribed": _prescribed,
}
