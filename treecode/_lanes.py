"""Many numbers as one value: the vectors in which `Kernel.pair` computes.

In compiled code a lanes value is an LLVM vector, wider than a register. LLVM cuts every operation
into independent ones on full registers and puts them side by side, which keeps the processor busy
where a loop that LLVM vectorises itself waits for results: 1.3 to 1.5 times faster, and
the vector instructions do not hang on what an optimiser makes of a loop. A kernel sees numbers:
lanes can be added, subtracted, multiplied, divided and compared with lanes and with numbers, and
raised to whole powers. There are lanes of doubles, and of singles where a tolerance allows them; a
number that meets singles becomes one. Where nothing is compiled a lanes value is a float, and there
is one lane.
"""

from __future__ import annotations

import math
import operator
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, models, register_model

from treecode._jit import INTERPRETED, overloaded

# Four vectors of AVX-512 and two. With 16 or 64 doubles pair loops are 1.1 to 1.2 times slower.
LANES = 1 if INTERPRETED else 32
LANES_SINGLE = 1 if INTERPRETED else 32
EIGHT = 1 if INTERPRETED else 8  # where rows are as short as that

_FLAGS = ("contract", "reassoc", "arcp", "nsz")  # as the options in `_jit`


class Lanes(types.Type):
    """Numba's type of lanes of numbers."""

    def __init__(self, name: str, scalar: Any, llvm_scalar: Any, bits: int, count: int) -> None:
        super().__init__(name)
        self.scalar, self.bits, self.count = scalar, bits, count
        self.vector = ir.VectorType(llvm_scalar, count)
        self.integers = ir.VectorType(ir.IntType(bits), count)
        self.mask = _Mask(f"{name} mask", self)


class _Mask(types.Type):
    """Numba's type of the comparisons of lanes."""

    def __init__(self, name: str, numbers: Lanes) -> None:
        super().__init__(name)
        self.vector = ir.VectorType(ir.IntType(1), numbers.count)


_DOUBLES = Lanes("lanes of doubles", types.float64, ir.DoubleType(), 64, LANES)
_SINGLES = Lanes("lanes of singles", types.float32, ir.FloatType(), 32, LANES_SINGLE)
_EIGHT_DOUBLES = Lanes("eight doubles", types.float64, ir.DoubleType(), 64, 8)
_EIGHT_SINGLES = Lanes("eight singles", types.float32, ir.FloatType(), 32, 8)


@register_model(Lanes)
@register_model(_Mask)
class LanesModel(models.PrimitiveModel):
    def __init__(self, manager: Any, lanes: Any) -> None:
        super().__init__(manager, lanes, lanes.vector)


def _spread(builder: Any, value: Any, vector: Any) -> Any:
    """Copy a number to all lanes; leave lanes as they are."""
    if value.type == vector:
        return value
    if value.type != vector.element:
        # What is positive stays so: the square of a distance is compared with the smallest double.
        smallest = ir.Constant(vector.element, float(np.finfo(np.float32).tiny))
        single = builder.fptrunc(value, vector.element)
        vanishes = builder.and_(
            builder.fcmp_ordered(">", value, ir.Constant(value.type, 0.0)),
            builder.fcmp_ordered("<", single, smallest),
        )
        value = builder.select(vanishes, smallest, single)
    undefined = ir.Constant(vector, ir.Undefined)
    first = builder.insert_element(undefined, value, ir.Constant(ir.IntType(32), 0))
    zeros = ir.Constant(ir.VectorType(ir.IntType(32), vector.count), None)
    return builder.shuffle_vector(first, undefined, zeros)


def _register_operator(symbol: Any, compares: bool, emit: Any) -> None:
    """Teach numba a binary operator between lanes, or lanes and a number."""

    @infer_global(symbol)
    class _Operator(AbstractTemplate):
        def generic(self, arguments: Any, keywords: Any) -> Any:
            lanes = next((a for a in arguments if isinstance(a, Lanes)), None)
            numbers = (types.Number, types.Literal)
            if lanes and all(a is lanes or isinstance(a, numbers) for a in arguments):
                singles = lanes.bits == 32
                given = (
                    a if a is lanes or (singles and a is types.float32) else types.float64
                    for a in arguments
                )
                return signature(lanes.mask if compares else lanes, *given)
            return None

    def lower(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        lanes = next(a for a in signature.args if isinstance(a, Lanes))
        return emit(builder, *(_spread(builder, value, lanes.vector) for value in values))

    for pair in ((Lanes, Lanes), (Lanes, types.Float), (types.Float, Lanes)):
        lower_builtin(symbol, *pair)(lower)


for _name in ("add", "sub", "mul", "div"):
    _python = _name.replace("div", "truediv")
    for _symbol in (getattr(operator, _python), getattr(operator, f"i{_python}")):
        _register_operator(
            _symbol,
            False,
            lambda builder, a, b, n=f"f{_name}": getattr(builder, n)(a, b, flags=_FLAGS),
        )
for _symbol, _name in (
    (operator.lt, "<"),
    (operator.le, "<="),
    (operator.gt, ">"),
    (operator.ge, ">="),
):
    _register_operator(_symbol, True, lambda builder, a, b, n=_name: builder.fcmp_ordered(n, a, b))


@intrinsic
def _neg(typing_context, lanes):
    def codegen(context, builder, signature, arguments):
        return builder.fneg(arguments[0], flags=_FLAGS)

    return lanes(lanes), codegen


@overloaded(operator.neg)
def _(lanes):
    return (lambda lanes: _neg(lanes)) if isinstance(lanes, Lanes) else None


@intrinsic(prefer_literal=True)
def _power(typing_context, base, exponent):
    def codegen(context, builder, signature, arguments):
        n, square = abs(exponent.literal_value), arguments[0]
        one = result = ir.Constant(base.vector, [1.0] * base.count)
        while n:
            if n & 1:
                result = builder.fmul(result, square, flags=_FLAGS)
            square, n = builder.fmul(square, square, flags=_FLAGS), n >> 1
        if exponent.literal_value < 0:
            result = builder.fdiv(one, result, flags=_FLAGS)
        return result

    return base(base, exponent), codegen


@overloaded(operator.ipow)
@overloaded(operator.pow)
def _(base, exponent):
    if isinstance(base, Lanes) and isinstance(exponent, types.IntegerLiteral):
        return lambda base, exponent: _power(base, exponent)
    return None


@intrinsic
def _abs(typing_context, lanes):
    def codegen(context, builder, signature, arguments):
        name = f"llvm.fabs.v{lanes.count}f{lanes.bits}"
        kind = ir.FunctionType(lanes.vector, [lanes.vector])
        return builder.call(builder.module.declare_intrinsic(name, fnty=kind), arguments)

    return lanes(lanes), codegen


@overloaded(abs)
def _(lanes):
    return (lambda lanes: _abs(lanes)) if isinstance(lanes, Lanes) else None


def where(condition: Any, a: Any, b: Any) -> Any:
    """Return `a` in the lanes where `condition` holds and `b` in the others.

    Both are computed; what an unselected lane holds, infinity or NaN included, does not matter.

    Examples
    --------
    >>> import treecode as tc
    >>> tc.where(2.0 > 1.0, 10.0, 20.0)
    10.0
    """
    return a if condition else b


@intrinsic
def _select(typing_context, condition, a, b):
    lanes = _DOUBLES if condition is _DOUBLES.mask else _SINGLES

    def codegen(context, builder, signature, arguments):
        condition, a, b = arguments
        vector = lanes.vector
        return builder.select(condition, _spread(builder, a, vector), _spread(builder, b, vector))

    return lanes(condition, a, b), codegen


@overloaded(where)
def _(condition, a, b):
    if isinstance(condition, _Mask):
        return lambda condition, a, b: _select(condition, a, b)
    if isinstance(condition, types.Boolean):  # of parameters or weights
        return lambda condition, a, b: a if condition else b
    return None


def no_lanes(array: Any) -> Any:
    """Return lanes of zeros, of the precision of `array`."""
    return 0.0


@intrinsic
def _no_lanes(typing_context, array):
    lanes = _lanes_of(array)

    def codegen(context, builder, signature, arguments):
        return ir.Constant(lanes.vector, None)

    return lanes(array), codegen


@overloaded(no_lanes)
def _(array):
    return lambda array: _no_lanes(array)


def lane_sum(lanes: Any) -> Any:
    """Return the sum of all lanes."""
    return lanes


@intrinsic
def _lane_sum(typing_context, lanes):
    def codegen(context, builder, signature, arguments):
        scalar, vector = lanes.vector.element, lanes.vector
        name = f"llvm.vector.reduce.fadd.v{lanes.count}f{lanes.bits}"
        function = cgutils.get_or_insert_function(
            builder.module, ir.FunctionType(scalar, [scalar, vector]), name
        )
        zero = ir.Constant(scalar, 0.0)
        return builder.call(function, [zero, arguments[0]], fastmath=_FLAGS)

    return lanes.scalar(lanes), codegen


@overloaded(lane_sum)
def _(lanes):
    return (lambda lanes: _lane_sum(lanes)) if isinstance(lanes, Lanes) else None


def lane_count(array: Any) -> int:
    """Return the number of lanes of the precision of `array`."""
    return 1


@overloaded(lane_count)
def _(array):
    count = _lanes_of(array).count
    return lambda array: count


def load(array: Any, row: int, column: int) -> Any:
    """Return ``array[row, column : column + lane_count(array)]`` of a C-ordered array."""
    return array[row, column]


def store(array: Any, row: int, column: int, lanes: Any) -> None:
    """Write lanes to ``array[row, column : column + lane_count(array)]``, C-ordered."""
    array[row, column] = lanes


def _lanes_of(array: Any) -> Lanes:
    return _SINGLES if array.dtype is types.float32 else _DOUBLES


def _eight_of(array: Any) -> Lanes:
    return _EIGHT_SINGLES if array.dtype is types.float32 else _EIGHT_DOUBLES


def _access(lanes_of: Any) -> tuple[Any, Any]:
    """Return intrinsics that load and store the lanes `lanes_of` an array."""

    def pointer(context: Any, builder: Any, array_type: Any, array: Any, indices: Any) -> Any:
        array = context.make_array(array_type)(context, builder, array)
        item = cgutils.get_item_pointer(
            context, builder, array_type, array, indices, wraparound=False
        )
        return builder.bitcast(item, lanes_of(array_type).vector.as_pointer())

    @intrinsic
    def load_lanes(typing_context, array, row, column):
        lanes = lanes_of(array)

        def codegen(context, builder, signature, arguments):
            value = builder.load(pointer(context, builder, array, arguments[0], arguments[1:]))
            value.align = lanes.bits // 8
            return value

        return lanes(array, types.intp, types.intp), codegen

    @intrinsic
    def store_lanes(typing_context, array, row, column, lanes):
        def codegen(context, builder, signature, arguments):
            place = pointer(context, builder, array, arguments[0], arguments[1:3])
            builder.store(arguments[3], place).align = lanes.bits // 8
            return context.get_dummy_value()

        return types.void(array, types.intp, types.intp, lanes), codegen

    return load_lanes, store_lanes


_load, _store = _access(_lanes_of)
_load_eight, _store_eight = _access(_eight_of)


@overloaded(load)
def _(array, row, column):
    return lambda array, row, column: _load(array, row, column)


@overloaded(store)
def _(array, row, column, lanes):
    return lambda array, row, column, lanes: _store(array, row, column, lanes)


def load_eight(array: Any, row: int, column: int) -> Any:
    """Return ``array[row, column : column + EIGHT]`` of a C-ordered array."""
    return array[row, column]


def store_eight(array: Any, row: int, column: int, lanes: Any) -> None:
    """Write lanes to ``array[row, column : column + EIGHT]``, C-ordered."""
    array[row, column] = lanes


@overloaded(load_eight)
def _(array, row, column):
    return lambda array, row, column: _load_eight(array, row, column)


@overloaded(store_eight)
def _(array, row, column, lanes):
    return lambda array, row, column, lanes: _store_eight(array, row, column, lanes)


def inverse_sqrt(x: Any) -> Any:
    """Return ``1/sqrt(x)`` to rounding for positive normal `x`; anything for another.

    Compiled, it is a guess from the exponent bits (3.5 % off), a quadratic fitted to the
    range of that guess (2.5e-5 off) and one step of fourth order (of second order for singles): 15
    operations that all run in vectors, where the divider needs some 40 cycles for eight numbers,
    and unlike a single precision estimate it keeps the whole range of the exponent.

    Examples
    --------
    >>> import treecode as tc
    >>> tc.inverse_sqrt(4.0)
    0.5
    """
    return 1.0 / math.sqrt(x) if x > 0.0 else math.inf


@intrinsic
def _guess(typing_context, x):
    def codegen(context, builder, signature, arguments):
        integer = x.integers if isinstance(x, Lanes) else ir.IntType(64)

        def constant(value):
            return ir.Constant(integer, [value] * x.count if isinstance(x, Lanes) else value)

        magic = 0x5F375A86 if x is _SINGLES else 0x5FE6EB50C7B537A9
        bits = builder.lshr(builder.bitcast(arguments[0], integer), constant(1))
        return builder.bitcast(builder.sub(constant(magic), bits), arguments[0].type)

    return x(x), codegen


@overloaded(inverse_sqrt)
def _(x):
    def of_doubles(x):
        y = _guess(x)
        h = 1.0 - x * y * y
        y = y * (1.0000002120398663 + h * (0.5010991420705498 + h * 0.3755058620157817))
        h = 1.0 - x * y * y
        return y + y * h * (0.5 + h * (0.375 + h * 0.3125))

    def of_singles(x):
        y = _guess(x)
        h = 1.0 - x * y * y
        y = y * (1.0000002120398663 + h * (0.5010991420705498 + h * 0.3755058620157817))
        return y + y * (0.5 * (1.0 - x * y * y))

    def of_number(x):
        return inverse_sqrt(float(x))

    if x is _SINGLES:
        return of_singles
    if x is _DOUBLES or x is types.float64:
        return of_doubles
    return of_number if isinstance(x, types.Number) else None
