"""What is said of a mistake in a kernel: its name, its line, and what to write instead."""

import math
import re
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

import treecode as tc
from treecode._jit import Driver
from treecode._lanes import load, store
from treecode._mistakes import explain
from treecode.kernels.base import pair, weights, zero


@Driver
def on_lanes(kernel, x, out):
    """Call `pair` as the loops do: a small function, quick to compile."""
    at = load(x, 0, 0)
    store(out, 0, 0, pair(kernel, at, at, at, (1.0,), zero(kernel, x))[0])


@Driver
def on_numbers(kernel):
    return weights(kernel, (1.0,))


def call(kernel):
    on_numbers(kernel)
    on_lanes(kernel, np.ones((1, 64)), np.ones((1, 64)))


class Right(NamedTuple):
    """A kernel without a mistake."""

    size: float = 1.0
    strength_size = 1
    weight_size = 1
    value_size = 1
    value_lengths = (1,)

    def weights(self, q):
        return q

    def pair(self, dx, dy, dz, w, acc):
        return (acc[0] + self.size * w[0] * dx,)


class If(Right):
    def pair(self, dx, dy, dz, w, acc):
        if dx > 0.0:
            return (acc[0] + w[0],)
        return acc


class And(Right):
    def pair(self, dx, dy, dz, w, acc):
        return (acc[0] + tc.where(dx > 0.0 and dy > 0.0, w[0], 0.0),)


class BrokenPower(Right):
    def pair(self, dx, dy, dz, w, acc):
        return (acc[0] + w[0] * dx**2.5,)


class Sine(Right):
    def pair(self, dx, dy, dz, w, acc):
        s = math.sin(dx)
        return (acc[0] + w[0] * s,)


class Attribute(Right):
    def pair(self, dx, dy, dz, w, acc):
        return (acc[0] + w[0] * dx * self.length,)


class Import(Right):
    def pair(self, dx, dy, dz, w, acc):
        from scipy.special import erf

        return (acc[0] + w[0] * erf(dx),)


class Format(Right):
    def weights(self, q):
        return (float(f"{q[0]:.2g}"),)


MISTAKES = [
    (If, "if dx > 0.0:", r"bool\(lanes", r"treecode\.where\(condition, a, b\)"),
    (And, "dx > 0.0 and dy", r"bool\(lanes", r"and, or .*treecode\.where"),
    (BrokenPower, "dx**2.5", r"pow\(lanes of doubles, float64\)", "whole powers"),
    (Sine, "s = math.sin(dx)", r"sin\(lanes of doubles\)", r"math\.sqrt, .* inverse_sqrt"),
    (Attribute, "self.length", "Unknown attribute 'length'", r"fields alone: constants .* module"),
    (Import, "from scipy", "IMPORT_NAME", "numba compiles a part of Python"),
    (Format, "float(f", "", "numba compiles a part of Python"),
]


@pytest.mark.parametrize(("kernel", "line", "reason", "remedy"), MISTAKES)
def test_a_few_lines(kernel, line, reason, remedy):
    with pytest.raises(TypeError) as refusal:
        call(kernel())
    message = str(refusal.value)
    assert message.startswith(f"kernel {kernel.__name__} cannot be compiled: ")
    assert re.search(reason, message)
    assert re.search(remedy, message)
    source = Path(__file__).read_text().splitlines()
    at = re.search(rf"{re.escape(__file__)}, line (\d+): (.*)", message)
    assert line in at[2]
    assert source[int(at[1]) - 1].strip() == at[2]
    assert len(message) < 500
    assert refusal.value.__suppress_context__


@pytest.mark.interpreted
def test_the_innermost_reason_and_the_users_line():
    """What numba says, in short: its own lines and those of this package do not count."""
    ours = Path(tc.__file__).with_name("pairs.py")
    error = f"""Failed in nopython mode pipeline (step: nopython frontend)
    No implementation of function Function(<function pair at 0x7f>) found for signature:
     >>> pair(Sine(float64 x 1), lanes of doubles)
      TypingError: Failed in nopython mode pipeline (step: nopython frontend)
      No implementation of function Function(<built-in function sin>) found for signature:
       >>> sin(lanes of doubles)
      During: typing of call at {__file__} (1)
    During: typing of call at {ours} (47)
    """
    lines = explain(Sine(), error).splitlines()
    assert lines[0] == "kernel Sine cannot be compiled: there is no sin(lanes of doubles)"
    assert lines[1] == f"  {__file__}, line 1: {Path(__file__).read_text().splitlines()[0]}"
    named = explain(Sine(), "Failed in nopython mode\n\nNameError: name 'a' is not defined")
    assert named.startswith("kernel Sine cannot be compiled: NameError: name 'a' is not defined\n")


def test_a_sum_says_it_too():
    with pytest.raises(TypeError, match=r"kernel If cannot.*\n.*test_mistakes\.py.*\n.*where"):
        tc.evaluate(If(), np.eye(3), np.ones((3, 1)), backend="direct")


class FewValues(Right):
    value_size = 2
    value_lengths = (1, 1)


class ManyValues(Right):
    def pair(self, dx, dy, dz, w, acc):
        return acc[0] + w[0], acc[0]


class NoTuple(Right):
    def pair(self, dx, dy, dz, w, acc):
        return acc[0] + w[0] * dx


class FewWeights(Right):
    """Compiled, the second weight was whatever stood in memory."""

    weight_size = 2

    def pair(self, dx, dy, dz, w, acc):
        return (acc[0] + w[0] + w[1],)


class ListOfWeights(Right):
    def weights(self, q):
        return [q[0]]


@pytest.mark.interpreted
@pytest.mark.parametrize(
    ("kernel", "said"),
    [
        (FewValues, r"pair of kernel FewValues must .* value_size = 2, got \(0\.0"),
        (ManyValues, r"pair of kernel ManyValues must .* value_size = 1, got \("),
        (NoTuple, r"pair of kernel NoTuple must return a tuple .* value_size = 1, got 0\.0"),
        (FewWeights, r"weights of kernel FewWeights must .* weight_size = 2, got \(0\.3,\)"),
        (ListOfWeights, r"weights of kernel ListOfWeights must return a tuple .* got \[0\.3\]"),
    ],
)
def test_numbers_of_values(kernel, said):
    with pytest.raises(TypeError, match=said):
        tc.Plan(kernel(), "direct")


class Weighted(NamedTuple):
    """A kernel with a tuple as a field."""

    parts: tuple[float, float]
    strength_size = 1
    weight_size = 1
    value_size = 1
    value_lengths = (1,)

    def weights(self, q):
        return (q[0] * self.parts[0],)

    def pair(self, dx, dy, dz, w, acc):
        return (acc[0] + w[0] * tc.inverse_sqrt(dx**2 + dy**2 + dz**2 + self.parts[1]),)


def test_a_tuple_as_a_field():
    rng = np.random.default_rng(0)
    points, charges = rng.random((600, 3)), rng.random((600, 1))
    distance2 = ((points[:, None] - points) ** 2).sum(axis=2)
    exact = 2.0 * (1.0 / np.sqrt(distance2 + 0.01)) @ charges
    for backend, error in (("direct", 1e-14), ("kitc", 1e-3)):
        options = {} if backend == "direct" else {"degree": 3, "leaf_size": 70}
        plan = tc.Plan(Weighted((2.0, 0.01)), backend, **options).set_points(points)
        assert tc.relative_error(plan.execute(charges), exact) < error
        assert (plan.info()["far_pairs"] > 0) == (backend == "kitc")
