"""Sixteen numbers that the processor handles side by side: the type in which compiled derivatives are carried.

A `Lanes` value is one derivative with respect to up to sixteen parameters. numba keeps it in registers as an LLVM
vector. So the text of a derivative reads like the text it was derived from, one line per line and without loops.
Products with zero are taken to be zero, and multiplications and additions may be fused.

Derivatives are in single precision, the model itself in double. Seven digits are enough for the next step and the
standard errors, and twice as many lanes fit a register.
"""

# mypy: ignore-errors

from __future__ import annotations

import operator

import numpy as np
from llvmlite import ir
from numba.core import types
from numba.core.typing.templates import ConcreteTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, models, register_model

#: As many as the first model and three more effects have parameters: each further block runs the model once more.
WIDTH = 16
PRECISION = np.float32
_NUMBER = ir.FloatType()
_VECTOR = ir.VectorType(_NUMBER, WIDTH)
_FLAGS = ("nnan", "ninf", "nsz", "contract", "reassoc")
#: Smaller numbers are set to zero: processors take many times as long for single-precision numbers near 1e-40. So would
#: the products of such numbers with other small ones.
FADED = 1e-25


class LanesType(types.Type):
    """numba's name for the type."""

    def __init__(self) -> None:
        super().__init__("Lanes")


LANES = LanesType()


@register_model(LanesType)
class _Model(models.PrimitiveModel):
    def __init__(self, manager, kind) -> None:
        super().__init__(manager, kind, _VECTOR)


def _spread(builder, number):
    """The same number in every lane."""
    number = builder.fptrunc(number, _NUMBER)
    one = builder.insert_element(ir.Constant(_VECTOR, ir.Undefined), number, ir.Constant(ir.IntType(32), 0))
    mask = ir.Constant(ir.VectorType(ir.IntType(32), WIDTH), [0] * WIDTH)
    return builder.shuffle_vector(one, ir.Constant(_VECTOR, ir.Undefined), mask)


@infer_global(operator.add)
@infer_global(operator.sub)
class _Sum(ConcreteTemplate):
    cases = [signature(LANES, LANES, LANES)]  # noqa: RUF012


@infer_global(operator.mul)
class _Product(ConcreteTemplate):
    cases = [signature(LANES, types.float64, LANES)]  # noqa: RUF012


@infer_global(operator.neg)
class _Negative(ConcreteTemplate):
    cases = [signature(LANES, LANES)]  # noqa: RUF012


@lower_builtin(operator.add, LANES, LANES)
def _add(context, builder, sig, args):
    return builder.fadd(*args, flags=_FLAGS)


@lower_builtin(operator.sub, LANES, LANES)
def _subtract(context, builder, sig, args):
    return builder.fsub(*args, flags=_FLAGS)


@lower_builtin(operator.mul, types.float64, LANES)
def _multiply(context, builder, sig, args):
    return builder.fmul(_spread(builder, args[0]), args[1], flags=_FLAGS)


@lower_builtin(operator.neg, LANES)
def _negate(context, builder, sig, args):
    return builder.fsub(ir.Constant(_VECTOR, [0.0] * WIDTH), args[0], flags=_FLAGS)


@intrinsic
def numbers(typingctx, array):
    """The bare numbers of a contiguous array: indexed as before, but handed on without being counted."""

    def lower(context, builder, sig, args):
        return context.make_array(sig.args[0])(context, builder, args[0]).data

    return types.CPointer(array.dtype)(array), lower


@intrinsic
def zero(typingctx):
    """`WIDTH` zeros."""
    return LANES(), lambda context, builder, sig, args: ir.Constant(_VECTOR, [0.0] * WIDTH)


@intrinsic
def settled(typingctx, value):
    """The value, with zero for what is smaller than `FADED`."""

    def lower(context, builder, sig, args):
        least, most = (ir.Constant(_VECTOR, [limit] * WIDTH) for limit in (-FADED, FADED))
        small = builder.and_(builder.fcmp_ordered(">", args[0], least), builder.fcmp_ordered("<", args[0], most))
        return builder.select(small, ir.Constant(_VECTOR, [0.0] * WIDTH), args[0])

    return LANES(LANES), lower


def _place(context, builder, kind, array, row):
    """Pointer to the numbers at `row` of a contiguous (…, WIDTH) array, or of what `numbers` gave."""
    data = array
    if isinstance(kind, types.Array):
        data = context.make_array(kind)(context, builder, array).data
    first = builder.gep(data, [builder.mul(row, ir.Constant(row.type, WIDTH))])
    return builder.bitcast(first, _VECTOR.as_pointer())


@intrinsic
def row(typingctx, array, index):
    """Row of a contiguous (…, WIDTH) array."""

    def lower(context, builder, sig, args):
        at = context.cast(builder, args[1], sig.args[1], types.intp)
        return builder.load(_place(context, builder, sig.args[0], args[0], at), align=4)

    return LANES(array, index), lower


@intrinsic
def put(typingctx, array, index, value):
    """Write a row of a contiguous (…, WIDTH) array."""

    def lower(context, builder, sig, args):
        at = context.cast(builder, args[1], sig.args[1], types.intp)
        builder.store(args[2], _place(context, builder, sig.args[0], args[0], at), align=4)
        return context.get_dummy_value()

    return types.void(array, index, LANES), lower
