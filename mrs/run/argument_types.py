"""Arguments of the command line that are more than a word or a number."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from typing import Any


def camera(text: str) -> list[float]:
    """Return position, focal point and up as nine numbers."""
    numbers = _numbers(text, float, ",")
    if len(numbers) != 9 or not all(map(math.isfinite, numbers)):
        raise argparse.ArgumentTypeError(f"must be nine numbers, got {text!r}")
    return numbers


def size(text: str) -> tuple[int, int]:
    """Return width and height."""
    numbers = _numbers(text, int, ",")
    if len(numbers) != 2 or not all(16 <= number <= 10_000 for number in numbers):
        raise argparse.ArgumentTypeError(f"must be two numbers from 16 to 10000, got {text!r}")
    return numbers[0], numbers[1]


def interval(text: str) -> tuple[float, float]:
    """Return a lower and a higher number."""
    numbers = _numbers(text, float, ",")
    if len(numbers) != 2 or not -math.inf < numbers[0] < numbers[1] < math.inf:
        raise argparse.ArgumentTypeError(f"must be a lower and a higher number, got {text!r}")
    return numbers[0], numbers[1]


def frames(text: str) -> int | slice:
    """Return the number of a frame, or a range of them."""
    numbers = _numbers(text, lambda word: int(word) if word else None, ":")
    if not 1 <= len(numbers) <= 3 or numbers == [None] or numbers[2:] == [0]:
        raise argparse.ArgumentTypeError(f"must be a number or a range such as 0:20, got {text!r}")
    return numbers[0] if len(numbers) == 1 else slice(*numbers)


def plane(text: str) -> tuple[str, float]:
    """Return an axis, and the place of a plane across it."""
    axis, _, place = text.partition("=")
    numbers = _numbers(place, float, ",")
    if axis not in ("x", "y", "z") or len(numbers) != 1:
        raise argparse.ArgumentTypeError(f"must be an axis and a number as in z=0.5, got {text!r}")
    return axis, numbers[0]


def point(text: str) -> list[float]:
    """Return three coordinates."""
    numbers = _numbers(text, float, ",")
    if len(numbers) != 3 or not all(map(math.isfinite, numbers)):
        raise argparse.ArgumentTypeError(f"must be three numbers, got {text!r}")
    return numbers


def ends(text: str) -> tuple[list[float], list[float]]:
    """Return the two ends of a line, or two opposite corners of a box."""
    numbers = _numbers(text, float, ",")
    if len(numbers) != 6 or not all(map(math.isfinite, numbers)):
        raise argparse.ArgumentTypeError(f"must be six numbers, got {text!r}")
    return numbers[:3], numbers[3:]


def _numbers(text: str, kind: Callable[[str], Any], separator: str) -> list[Any]:
    """Return the numbers in a text, none if one of them is not of that kind."""
    try:
        return [kind(word) for word in text.split(separator)]
    except ValueError:
        return []
