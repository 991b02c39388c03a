"""Numbers with bounds, and the cases that yield them."""

import math
from collections.abc import Callable
from typing import NamedTuple


class Finding(NamedTuple):
    """One row of the table."""

    asked: str
    found: float
    low: float = -math.inf
    high: float = math.inf

    def holds(self):
        return self.low <= self.found <= self.high  # false for nan

    def cells(self):
        low, high = f"{self.low:.5g}", f"{self.high:.5g}"
        bound = f"{low} to {high}"
        if self.low == -math.inf:
            bound = f"at most {high}"
        elif self.high == math.inf:
            bound = f"at least {low}"
        elif self.low == self.high:
            bound = high
        return [self.asked, f"{self.found:.5g}", bound]


class Case(NamedTuple):
    """A function that yields findings, and its options."""

    title: str
    slow: bool
    function: Callable
    options: dict

    @property
    def name(self):
        return "_".join([self.function.__name__, *map(str, self.options.values())])

    @property
    def section(self):
        return int(self.title.partition(".")[0])

    @property
    def heading(self):
        return self.title + "".join(f", {k} = {v:,}" for k, v in self.options.items())

    def findings(self):
        return list(self.function(**self.options))


CASES = []


def case(title, slow=False, **options):
    """Append a function, with these options, to the cases."""

    def append(function):
        CASES.append(Case(title, slow, function, options))
        return function

    return append


def at_most(asked, found, high):
    return Finding(asked, float(found), high=float(high))


def at_least(asked, found, low):
    return Finding(asked, float(found), low=float(low))
