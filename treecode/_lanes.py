"""`LANES` numbers as one value: the vectors in which `Kernel.pair` computes.

In compiled code a lanes value is an LLVM vector, wider than a register. LLVM cuts every operation
into independent ones on full registers and puts them side by side, which keeps the processor busy
where a loop that LLVM vectorises itself waits for results: 1.3 to 1.5 times faster, and
the vector instructions do not hang on what an optimiser makes of a loop. A kernel sees numbers:
lanes can be added, subtracted, multiplied, divided and compared with lanes and with numbers.
Where nothing is compiled a lanes value is a float, and `LANES` is 1.
"""

from __future__ import annotations

import math
import operator
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, models, register_model

from treecode._jit import INTERPRETED, overloaded

# Four vectors of AVX-512. With 16 or 64 lanes the pair loops are 1.1 to 1.2 times slower.
LANES = 1 if INTERPRETED else 32

_FLAGS = ("contract", "reassoc", "arcp", "nsz")  # as the options in `_jit`
_DOUBLES = ir.VectorType(ir.DoubleType(), LANES)
_INTEGERS = ir.VectorType(ir.IntType(64), LANES)
_BITS = ir.VectorType(ir.IntType(1), LANES)


class _Lanes(types.Type):
    """Numba's type of lanes (of numbers or of comparisons)."""


_NUMBERS = _Lanes("lanes")
_MASK = _Lanes("lanes mask")


@register_model(_Lanes)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, manager: Any, lanes: _Lanes) -> None:
        super().__init__(manager, lanes, _DOUBLES if lanes is _NUMBERS else _BITS)


def _spread(builder: Any, value: Any) -> Any:
    """Copy a double to all lanes; leave lanes as they are."""
    if value.type == _DOUBLES:
        return value
    undefined = ir.Constant(_DOUBLES, ir.Undefined)
    first = builder.insert_element(undefined, value, ir.Constant(ir.IntType(32), 0))
    zeros = ir.Constant(ir.VectorType(ir.IntType(32), LANES), None)
    return builder.shuffle_vector(first, undefined, zeros)


def _register_operator(symbol: Any, result: _Lanes, emit: Any) -> None:
    """Teach numba a binary operator between lanes, or lanes and a number."""

    @infer_global(symbol)
    class _Operator(AbstractTemplate):
        def generic(self, arguments: Any, keywords: Any) -> Any:
            numbers = (_Lanes, types.Number, types.Literal)
            if _NUMBERS in arguments and all(isinstance(a, numbers) for a in arguments):
                return signature(
                    result, *(a if a is _NUMBERS else types.float64 for a in arguments)
                )
            return None

    def lower(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return emit(builder, *(_spread(builder, value) for value in values))

    for pair in ((_Lanes, _Lanes), (_Lanes, types.Float), (types.Float, _Lanes)):
        lower_builtin(symbol, *pair)(lower)


for _symbol, _name in (
    (operator.add, "fadd"),
    (operator.sub, "fsub"),
    (operator.mul, "fmul"),
    (operator.truediv, "fdiv"),
):
    _register_operator(
        _symbol, _NUMBERS, lambda builder, a, b, n=_name: getattr(builder, n)(a, b, flags=_FLAGS)
    )
for _symbol, _name in (
    (operator.lt, "<"),
    (operator.le, "<="),
    (operator.gt, ">"),
    (operator.ge, ">="),
):
    _register_operator(_symbol, _MASK, lambda builder, a, b, n=_name: builder.fcmp_ordered(n, a, b))


@intrinsic
def _neg(typing_context, lanes):
    def codegen(context, builder, signature, arguments):
        return builder.fneg(arguments[0], flags=_FLAGS)

    return _NUMBERS(lanes), codegen


@overloaded(operator.neg)
def _(lanes):
    return (lambda lanes: _neg(lanes)) if lanes is _NUMBERS else None


def where(condition: Any, a: Any, b: Any) -> Any:
    """Return `a` in the lanes where `condition` holds and `b` in the others.

    Both are computed; what an unselected lane holds, infinity or NaN included, does not matter.
    """
    return a if condition else b


@intrinsic
def _select(typing_context, condition, a, b):
    def codegen(context, builder, signature, arguments):
        condition, a, b = arguments
        return builder.select(condition, _spread(builder, a), _spread(builder, b))

    return _NUMBERS(condition, a, b), codegen


@overloaded(where)
def _(condition, a, b):
    return (lambda condition, a, b: _select(condition, a, b)) if condition is _MASK else None


def no_lanes() -> Any:
    """Return lanes of zeros."""
    return 0.0


@intrinsic
def _no_lanes(typing_context):
    def codegen(context, builder, signature, arguments):
        return ir.Constant(_DOUBLES, None)

    return _NUMBERS(), codegen


@overloaded(no_lanes)
def _():
    return lambda: _no_lanes()


def load(array: Any, row: int, column: int) -> Any:
    """Return ``array[row, column : column + LANES]`` of a C-ordered float64 array."""
    return array[row, column]


def store(array: Any, row: int, lanes: Any) -> None:
    """Write lanes to the start of a row of a C-ordered float64 array."""
    array[row, 0] = lanes


def _pointer(context: Any, builder: Any, array_type: Any, array: Any, indices: Any) -> Any:
    array = context.make_array(array_type)(context, builder, array)
    item = cgutils.get_item_pointer(context, builder, array_type, array, indices, wraparound=False)
    return builder.bitcast(item, _DOUBLES.as_pointer())


@intrinsic
def _load(typing_context, array, row, column):
    def codegen(context, builder, signature, arguments):
        pointer = _pointer(context, builder, array, arguments[0], arguments[1:])
        lanes = builder.load(pointer)
        lanes.align = 8
        return lanes

    return _NUMBERS(array, types.intp, types.intp), codegen


@intrinsic
def _store(typing_context, array, row, lanes):
    def codegen(context, builder, signature, arguments):
        indices = [arguments[1], ir.Constant(arguments[1].type, 0)]
        pointer = _pointer(context, builder, array, arguments[0], indices)
        builder.store(arguments[2], pointer).align = 8
        return context.get_dummy_value()

    return types.void(array, types.intp, lanes), codegen


@overloaded(load)
def _(array, row, column):
    return lambda array, row, column: _load(array, row, column)


@overloaded(store)
def _(array, row, lanes):
    return lambda array, row, lanes: _store(array, row, lanes)


def inverse_sqrt(x: Any) -> Any:
    """Return ``1/sqrt(x)`` to 2e-16 for positive normal `x`; anything for another.

    Compiled, it is a guess from the exponent bits (3.5 % off), a quadratic fitted to the
    range of that guess (2.5e-5 off) and one step of fourth order: 15 operations that all run in
    vectors, where the divider needs some 40 cycles for eight numbers, and unlike a single
    precision estimate it keeps the whole range of the exponent.
    """
    return 1.0 / math.sqrt(x) if x > 0.0 else math.inf


@intrinsic
def _guess(typing_context, x):
    def codegen(context, builder, signature, arguments):
        integer = _INTEGERS if x is _NUMBERS else ir.IntType(64)

        def constant(value):
            return ir.Constant(integer, [value] * LANES if x is _NUMBERS else value)

        bits = builder.lshr(builder.bitcast(arguments[0], integer), constant(1))
        bits = builder.sub(constant(0x5FE6EB50C7B537A9), bits)
        return builder.bitcast(bits, arguments[0].type)

    return x(x), codegen


@overloaded(inverse_sqrt)
def _(x):
    def compiled_inverse_sqrt(x):
        y = _guess(x)
        h = 1.0 - x * y * y
        y = y * (1.0000002120398663 + h * (0.5010991420705498 + h * 0.3755058620157817))
        h = 1.0 - x * y * y
        return y + y * h * (0.5 + h * (0.375 + h * 0.3125))

    return compiled_inverse_sqrt if x is _NUMBERS or x is types.float64 else None
