"""exp, log and erf of lanes, in vector arithmetic alone: no call for each lane.

Range reductions and the ways the functions are composed are the usual ones: powers of two for exp
and log (P. T. P. Tang, ACM Trans. Math. Softw. 15, 1989, and 16, 1990); for erf two ranges, the
outer by exp(-x^2) erfc (W. J. Cody, Math. Comp. 23, 1969). The polynomials are our own fits, from
`benchmarks/fit_elements.py`. Errors are below two units of the last place, over the whole range.

The order of operations matters here, so that nothing may be reassociated: these functions are
emitted as they stand, multiplications and additions fused where the processor can.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from treecode._jit import overloaded
from treecode._lanes import Lanes

_POLYNOMIALS: dict[int, dict[str, tuple[float, ...]]] = {
    64: {
        "exp": (
            0.5000000000000001,
            0.16666666666666669,
            0.041666666666623824,
            0.008333333333330039,
            0.0013888888917367081,
            0.00019841269863171557,
            2.4801521057868204e-05,
            2.7557268276905696e-06,
            2.7620201591031547e-07,
            2.5100472505694996e-08,
        ),
        "log": (
            0.666666666666667,
            0.3999999999989889,
            0.28571428626253836,
            0.22222211089379496,
            0.1818289243253687,
            0.15331611722055008,
            0.14617807153417325,
        ),
        "erf": (
            0.12837916709551256,
            -0.37612638903183543,
            0.11283791670945006,
            -0.02686617064323777,
            0.0052239776071164225,
            -0.0008548325975389692,
            0.00012055294904839707,
            -1.492473690741966e-05,
            1.6447424703317362e-06,
            -1.6208483801871705e-07,
            1.3720064546777686e-08,
            -7.795898827002142e-10,
        ),
        "erfc": (
            0.21080636406114356,
            -0.3717367339489732,
            0.251713193217456,
            -0.12503305237885554,
            0.0399225390747838,
            -0.0039937011641469865,
            -0.002642365927759658,
            0.0008759154019168855,
            0.00022837955896605415,
            -0.00012887649615317198,
            -3.4172229273553035e-05,
            1.8609712314617464e-05,
            7.48480117852628e-06,
            -2.2842173094341345e-06,
            -1.562525850774316e-06,
            8.134380709229635e-08,
        ),
    },
    32: {
        "exp": (
            0.5,
            0.166665767,
            0.0416665542,
            0.00836323288,
            0.00139262508,
        ),
        "log": (
            0.666666851,
            0.399887577,
            0.295809859,
        ),
        "erf": (
            0.128379166,
            -0.376126267,
            0.112835947,
            -0.026854212,
            0.00518908742,
            -0.000801686429,
            7.87587506e-05,
        ),
        "erfc": (
            0.210806368,
            -0.371736785,
            0.251712217,
            -0.125030181,
            0.0399643866,
            -0.00398635031,
            -0.00311584981,
        ),
    },
}


class _Format(NamedTuple):
    """A format of floating point numbers.

    Attributes
    ----------
    mantissa, bias : int
        Bits, and what is added to exponents.
    least, most : float
        Exponentials below and above are 0 and infinity.
    log2, log2_rest : float
        The logarithm of 2 in two parts, the first with so many zeros at its end that products with
        exponents are exact.
    one : float
        From here on erf is 1 to rounding.
    """

    mantissa: int
    bias: int
    least: float
    most: float
    log2: float
    log2_rest: float
    one: float


_FORMATS = {
    64: _Format(52, 1023, -750.0, 710.0, 0.6931471803691238, 1.9082149292705877e-10, 6.0),
    32: _Format(23, 127, -106.0, 89.0, 0.693145752, 1.42860677e-06, 4.0),
}
_MIDDLE = 2.5


class _Value:
    """An LLVM value of lanes with Python's operators, each one instruction."""

    def __init__(self, builder: Any, lanes: Lanes, value: Any) -> None:
        self.builder, self.lanes, self.value = builder, lanes, value
        self.format, self.polynomials = _FORMATS[lanes.bits], _POLYNOMIALS[lanes.bits]

    def new(self, value: Any) -> _Value:
        return _Value(self.builder, self.lanes, value)

    def number(self, number: Any, integer: bool = False) -> _Value:
        """Return a number in all lanes."""
        vector = self.lanes.integers if integer else self.lanes.vector
        return self.new(ir.Constant(vector, [number] * self.lanes.count))

    def _is_integer(self) -> bool:
        return self.value.type == self.lanes.integers

    def _both(self, operation: str, other: Any) -> _Value:
        integer = self._is_integer()
        if not isinstance(other, _Value):
            other = self.number(other, integer)
        emit = getattr(self.builder, operation if integer else f"f{operation}")
        flags = () if integer else ("contract",)
        return self.new(emit(self.value, other.value, flags=flags))

    def __add__(self, other: Any) -> _Value:
        return self._both("add", other)

    def __sub__(self, other: Any) -> _Value:
        return self._both("sub", other)

    def __mul__(self, other: Any) -> _Value:
        return self._both("mul", other)

    def __truediv__(self, other: Any) -> _Value:
        return self._both("div", other)

    def compare(self, relation: str, number: float) -> Any:
        """Return a mask; false where a lane is not a number."""
        return self.builder.fcmp_ordered(relation, self.value, self.number(number).value)

    def select(self, mask: Any, other: Any) -> _Value:
        """Return the lanes of `other` where the mask holds."""
        if not isinstance(other, _Value):
            other = self.number(other)
        return self.new(self.builder.select(mask, other.value, self.value))

    def bits(self) -> _Value:
        """Return the bits as integers, or integers as the numbers that have these bits."""
        vector = self.lanes.vector if self._is_integer() else self.lanes.integers
        return self.new(self.builder.bitcast(self.value, vector))

    def polynomial(self, coefficients: tuple[float, ...]) -> _Value:
        """Return a polynomial of the value, by Horner's rule."""
        total = self.number(coefficients[-1])
        for c in reversed(coefficients[:-1]):
            total = total * self + c
        return total


def _exp(x: _Value) -> _Value:
    """exp(x) = 2^n (1 + r + r^2 p(r)) with r = x - n log 2, |r| <= log(2) / 2."""
    form = x.format
    clamped = x.select(x.compare(">", form.most), form.most)
    clamped = clamped.select(clamped.compare("<", form.least), form.least)
    # Added to 1.5 * 2^mantissa a number is rounded to an integer, which is there in its last bits.
    shift = 1.5 * 2.0**form.mantissa
    rounded = clamped * (1.0 / math.log(2.0)) + shift
    n = rounded - shift
    r = clamped - n * form.log2 - n * form.log2_rest
    mantissa = r * r * r.polynomial(x.polynomials["exp"]) + r + 1.0
    # In two factors, since 2^n alone may be beyond the range.
    integer = rounded.bits() - x.number(shift).bits()
    half = x.new(x.builder.ashr(integer.value, x.number(1, integer=True).value))
    return mantissa * _power_of_two(half) * _power_of_two(integer - half)


def _power_of_two(n: _Value) -> _Value:
    shift = n.number(n.format.mantissa, integer=True)
    return n.new(n.builder.shl((n + n.format.bias).value, shift.value)).bits()


def _log(x: _Value) -> _Value:
    """log(x) = e log 2 + log(1 + f), 1 + f from sqrt(1/2) to sqrt(2).

    With s = f / (2 + f) and z = s^2, log(1 + f) = f - f^2/2 + s (f^2/2 + z p(z)).
    """
    form, builder = x.format, x.builder
    tiny = x.compare("<", 2.0 ** (1 - form.bias))  # subnormal: its exponent is not in its bits
    bits = x.select(tiny, x * 2.0 ** (form.mantissa + 1)).bits()
    root = x.number(math.sqrt(0.5)).bits()
    shift = x.number(form.mantissa, integer=True).value
    exponent = x.new(builder.ashr((bits - root).value, shift))
    f = (bits - x.new(builder.shl(exponent.value, shift))).bits() - 1.0
    large = 1.5 * 2.0**form.mantissa
    e = (exponent + x.number(large).bits()).bits() - large
    e = e.select(tiny, e - (form.mantissa + 1.0))
    s = f / (f + 2.0)
    z = s * s
    square = f * f * 0.5
    rest = s * (square + z * z.polynomial(x.polynomials["log"])) + e * form.log2_rest
    result = e * form.log2 - ((square - rest) - f)
    limit = x.number(math.nan).select(x.compare("==", 0.0), -math.inf)
    result = limit.select(x.compare(">", 0.0), result)
    return result.select(x.compare("==", math.inf), math.inf)


def _erf(x: _Value) -> _Value:
    """Up to 1 erf(x) = x + x p(x^2); beyond 1 - exp(-x^2) q(u) with u = (x - 5/2) / (x + 5/2)."""
    sign = x.number(-0.0).bits().value
    negative = x.builder.and_(x.bits().value, sign)
    a = x.new(x.builder.xor(x.bits().value, negative)).bits()
    inner = a * (a * a).polynomial(x.polynomials["erf"]) + a
    far = a.select(a.compare(">", x.format.one), x.format.one)
    u = (far - _MIDDLE) / (far + _MIDDLE)
    complement = _exp(x.number(0.0) - far * far) * u.polynomial(x.polynomials["erfc"])
    size = (x.number(1.0) - complement).select(a.compare("<", 1.0), inner)
    return x.new(x.builder.or_(size.bits().value, negative)).bits()


def exp(x: Any) -> Any:
    """Return e to the power of `x`, lanes or a number; infinity where that overflows.

    Examples
    --------
    >>> import treecode as tc
    >>> round(tc.exp(1.0), 6), tc.exp(1e5)
    (2.718282, inf)
    """
    try:
        return math.exp(x)
    except OverflowError:
        return math.inf


def log(x: Any) -> Any:
    """Return the natural logarithm of `x`, lanes or a number; -infinity of 0, NaN below.

    Examples
    --------
    >>> import treecode as tc
    >>> tc.log(1.0), tc.log(0.0)
    (0.0, -inf)
    """
    if x > 0.0:
        return math.log(x)
    return -math.inf if x == 0.0 else math.nan


def erf(x: Any) -> Any:
    """Return the error function of `x`, lanes or a number.

    Examples
    --------
    >>> import treecode as tc
    >>> round(tc.erf(0.5), 6)
    0.5205
    """
    return math.erf(x)


def _square_root(x: _Value) -> _Value:
    vector = x.lanes.vector
    name = f"llvm.sqrt.v{x.lanes.count}f{x.lanes.bits}"
    function = x.builder.module.declare_intrinsic(name, fnty=ir.FunctionType(vector, [vector]))
    return x.new(x.builder.call(function, [x.value]))


def _define(emit: Callable[[_Value], _Value], *stubs: Callable) -> None:
    """Give compiled code a function of lanes, by the names of `stubs`."""

    @intrinsic
    def of_lanes(typing_context, x):
        def codegen(context, builder, signature, arguments):
            return emit(_Value(builder, x, arguments[0])).value

        return x(x), codegen

    def twin(x):
        return (lambda x: of_lanes(x)) if isinstance(x, Lanes) else None

    for stub in stubs:
        overloaded(stub)(twin)


def _of_numbers(stub: Callable, function: Callable) -> None:
    """Let compiled code take `function` for `stub` of a number."""

    @overloaded(stub)
    def _(x):
        return (lambda x: function(x)) if isinstance(x, types.Number) else None


_define(_exp, exp, math.exp)
_define(_log, log, math.log)
_define(_erf, erf, math.erf)
_define(_square_root, math.sqrt)  # `inverse_sqrt` is faster
_of_numbers(exp, math.exp)
_of_numbers(log, math.log)
_of_numbers(erf, math.erf)
