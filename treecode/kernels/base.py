"""What a kernel is, and the functions through which the loops reach it."""

from __future__ import annotations

from sys import float_info
from typing import Any, Protocol

from treecode._jit import method_hook, overloaded
from treecode._lanes import load, no_lanes

# Smallest normal number, DBL_MIN. Two points coincide if the square of their distance is below it.
SMALLEST = float_info.min


# Targets, or particles, that go through a table of Taylor terms together: two vectors of AVX-512.
COLUMNS = 16


# What `check.kernel` asks for; the protocol below says what each is.
MEMBERS = ("strength_size", "weight_size", "value_size", "weights", "pair")


class Kernel(Protocol):
    """The contract of a kernel K(x, y): a NamedTuple of its parameters with these members.

    The sum is ``out(x_i) = sum_j K(x_i, y_j) q_j``. Methods are plain Python; the package compiles
    them into its loops. In `pair` distances and `acc` are lanes, many targets at once: use
    arithmetic, `treecode.inverse_sqrt`, and `treecode.where` for ``if``. docs/add-a-kernel.md is
    a guide.

    Attributes
    ----------
    strength_size : int
        Columns of the strengths q that a user passes.
    weight_size : int
        Components of the linear weights w that `pair` takes.
    value_size : int
        Components of the sum.
    value_lengths : tuple of `value_size` numbers
        Equal for components of one unit, whose errors are measured together: with lengths L times
        larger component i is ``L**value_lengths[i]`` times smaller, beside the others.
        (1, 1, 1, 2, 2, 2) for velocities and angular velocities.

    Examples
    --------
    >>> from typing import NamedTuple
    >>> import treecode as tc
    >>> class Source(NamedTuple):  # the velocity of a source of fluid, 1/(4 pi r^2)
    ...     strength_size = weight_size = 1
    ...     value_size, value_lengths = 3, (2, 2, 2)
    ...
    ...     def weights(self, q):
    ...         return (q[0] / 12.566370614359172,)
    ...
    ...     def pair(self, dx, dy, dz, w, acc):
    ...         square = dx**2 + dy**2 + dz**2
    ...         apart = square > 0.0
    ...         f = tc.where(apart, w[0] * tc.inverse_sqrt(tc.where(apart, square, 1.0)) ** 3, 0.0)
    ...         return acc[0] + f * dx, acc[1] + f * dy, acc[2] + f * dz
    >>> source = Source()
    >>> u = source.pair(0.0, 0.0, 2.0, source.weights((16.0,)), (0.0, 0.0, 0.0))
    >>> round(u[2], 6)  # 1 / pi
    0.31831
    """

    strength_size: int
    weight_size: int
    value_size: int
    value_lengths: tuple[float, ...]

    def weights(self, q: tuple[float, ...]) -> tuple[float, ...]:
        """Turn one row of strengths into weights, constant factors included."""

    def pair(
        self, dx: float, dy: float, dz: float, w: tuple[float, ...], acc: tuple[float, ...]
    ) -> tuple[float, ...]:
        """Return ``acc + K(r) w`` with r = target - source; linear in w and finite at r = 0."""


@method_hook
def pair(self: Any, dx: float, dy: float, dz: float, w: tuple, acc: tuple) -> tuple:
    """Return ``acc + K(r) w``."""
    return self.pair(dx, dy, dz, w, acc)


@method_hook
def weights(self: Any, q: tuple) -> tuple:
    """Turn one row of strengths into linear weights."""
    return self.weights(q)


def zero(kernel: Any, array: Any) -> tuple:
    """Return the empty accumulator of a kernel, lanes of zeros in the precision of `array`."""
    return _zeros(array, (0.0,) * kernel.value_size)


@overloaded(zero)
def _(kernel, array):
    like = (0.0,) * kernel.instance_class.value_size
    return lambda kernel, array: _zeros(array, like)


def _zeros(array: Any, like: tuple) -> tuple:
    """Return as many lanes of zeros as `like` has entries; a tuple's length is part of its type."""
    return like


@overloaded(_zeros)
def _(array, like):
    if len(like) == 1:
        return lambda array, like: (no_lanes(array),)
    return lambda array, like: (*_zeros(array, like[1:]), no_lanes(array))


def weight_column(kernel: Any, array: Any, j: int) -> tuple:
    """Return column `j` of a (weight_size, N) array as a tuple."""
    return tuple(array[c, j] for c in range(kernel.weight_size))


@overloaded(weight_column)
def _(kernel, array, j):
    like = (0.0,) * kernel.instance_class.weight_size
    return lambda kernel, array, j: _column(array, j, like)


def weight_lanes(kernel: Any, array: Any, j: int) -> tuple:
    """Return lanes of a (weight_size, N) array, from column `j` on, as a tuple."""
    return weight_column(kernel, array, j)


@overloaded(weight_lanes)
def _(kernel, array, j):
    like = (0.0,) * kernel.instance_class.weight_size
    return lambda kernel, array, j: _load_rows(array, j, like)


def _load_rows(array: Any, j: int, like: tuple) -> tuple:
    """Return lanes of the first ``len(like)`` rows."""
    return tuple(load(array, c, j) for c in range(len(like)))


@overloaded(_load_rows)
def _(array, j, like):
    last = len(like) - 1
    if last == 0:
        return lambda array, j, like: (load(array, 0, j),)
    return lambda array, j, like: (*_load_rows(array, j, like[1:]), load(array, last, j))


def strength_row(kernel: Any, array: Any, i: int) -> tuple:
    """Return row `i` of an (N, strength_size) array as a tuple."""
    return tuple(array[i, c] for c in range(kernel.strength_size))


@overloaded(strength_row)
def _(kernel, array, i):
    like = (0.0,) * kernel.instance_class.strength_size
    return lambda kernel, array, i: _column(array.T, i, like)


def _column(array: Any, j: int, like: tuple) -> tuple:
    """Return the first ``len(like)`` entries of column `j`; the type of `like` tells how many."""
    return tuple(array[c, j] for c in range(len(like)))


@overloaded(_column)
def _(array, j, like):
    last = len(like) - 1
    if last == 0:
        return lambda array, j, like: (array[0, j],)
    return lambda array, j, like: (*_column(array, j, like[1:]), array[last, j])


def require_counts(kernel: Any) -> None:
    """Refuse a kernel whose methods return other numbers of values than its sizes say.

    Compiled loops read as many as there should be. What only compiled code can do is left to it.
    """
    numbers = [0.3 + 0.1 * i for i in range(max(3, kernel.strength_size, kernel.weight_size))]
    calls = {
        "weights": ("weight_size", (tuple(numbers[: kernel.strength_size]),)),
        "pair": (
            "value_size",
            (*numbers[:3], tuple(numbers[: kernel.weight_size]), (0.0,) * kernel.value_size),
        ),
    }
    for method, (size, arguments) in calls.items():
        try:
            result = getattr(kernel, method)(*arguments)
        except Exception:  # compiling says more
            continue
        count = getattr(kernel, size)
        if not isinstance(result, tuple) or len(result) != count:
            raise TypeError(
                f"{method} of kernel {type(kernel).__qualname__} must return a tuple of "
                f"length {size} = {count}, got {result!r}"
            )
