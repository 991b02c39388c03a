"""Refused options of a scenario, in the words of the other refusals."""

from __future__ import annotations

import difflib
import typing
from collections.abc import Iterator
from typing import Any

from pydantic import BaseModel


def explain(scenario: type[BaseModel], item: Any) -> str:
    """Return a fault that pydantic has found in the words of the other error messages."""
    place = ".".join(map(str, item["loc"]))
    if item["type"] in ("extra_forbidden", "unexpected_keyword_argument"):
        return f"{place}: no such option{_suggestion(scenario, item['loc'])}"
    if item["type"] == "missing":
        return f"{place}: must be given"
    if item["type"] == "value_error":  # of a class that checks itself; its message has the value
        return f"{place}: {item['ctx']['error']}"
    return f"{place}: {item['msg'].lower()}, got {item['input']!r}"


def _suggestion(scenario: type[BaseModel], place: tuple[int | str, ...]) -> str:
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
    """Yield the options of a model and of its parts."""
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
