"""Sixteen float32 numbers as one value in compiled kernels: a vector register, or as many as the processor needs.

LLVM vectorises a plain loop only if it can analyse it, and keeps the loop's sums in registers only until the loop ends.
With an explicit vector type, sums stay in registers across loops: ``v = load(array, start) * 2``, ``total += v``.
"""

from collections.abc import Callable
from operator import add, mul, sub, truediv
from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.core import cgutils
from numba.core.datamodel.models import PrimitiveModel
from numba.extending import intrinsic, overload, register_model

from gaussian_enhancer.compiled import inner

COUNT = 16
_FLOATS = ir.VectorType(ir.FloatType(), COUNT)
_INTEGERS = ir.VectorType(ir.IntType(32), COUNT)
_FLAGS = ("contract", "reassoc", "nsz", "arcp", "afn")


class Lanes(types.Type):  # type: ignore[misc]
    """Numba's type of a vector."""

    def __init__(self) -> None:
        super().__init__(name="lanes")


lanes = Lanes()


@register_model(Lanes)
class _Model(PrimitiveModel):  # type: ignore[misc]
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, _FLOATS)


def _constant(value: float | int, kind: ir.VectorType = _FLOATS) -> ir.Constant:
    return ir.Constant(kind, [value] * COUNT)


def _broadcast(builder: Any, value: Any) -> Any:
    """Broadcast a scalar to all lanes; a vector is returned unchanged."""
    if value.type == _FLOATS:
        return value
    vector = builder.insert_element(ir.Constant(_FLOATS, ir.Undefined), value, ir.Constant(ir.IntType(32), 0))
    return builder.shuffle_vector(vector, vector, ir.Constant(ir.VectorType(ir.IntType(32), COUNT), [0] * COUNT))


def _vector_pointer(context: Any, builder: Any, kind: Any, array: Any, start: Any) -> Any:
    """Pointer to the vector that begins at an element of a float32 array."""
    data = context.make_array(kind)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [start]), _FLOATS.as_pointer())


def _row_pointer(context: Any, builder: Any, kind: Any, array: Any, row: Any) -> Any:
    """Pointer to a row's first element."""
    array_struct = context.make_array(kind)(context, builder, array)
    return cgutils.get_item_pointer(context, builder, kind, array_struct, [row, context.get_constant(types.intp, 0)])


def _operator(symbol: Callable[..., Any], instruction: str) -> None:
    """Overload an operator for vectors on one side or on both."""

    @intrinsic  # type: ignore[untyped-decorator]
    def apply(typing: Any, a: Any, b: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            left, right = (_broadcast(builder, value) for value in arguments)
            return getattr(builder, instruction)(left, right, flags=_FLAGS)

        return lanes(a, b), generate

    @overload(symbol)  # type: ignore[untyped-decorator]
    def _(a, b):  # type: ignore[no-untyped-def]
        if lanes in (a, b) and {a, b} <= {lanes, types.float32}:
            return lambda a, b: apply(a, b)
        return None


for _symbol, _instruction in ((add, "fadd"), (sub, "fsub"), (mul, "fmul"), (truediv, "fdiv")):
    _operator(_symbol, _instruction)


@intrinsic  # type: ignore[untyped-decorator]
def broadcast(typing: Any, value: Any) -> Any:
    """The same float32 in every lane."""
    return lanes(types.float32), lambda context, builder, signature, arguments: _broadcast(builder, arguments[0])


@intrinsic  # type: ignore[untyped-decorator]
def lane_indices(typing: Any) -> Any:
    """0, 1, 2, ... 15."""
    numbers = ir.Constant(_FLOATS, [float(k) for k in range(COUNT)])
    return lanes(), lambda context, builder, signature, arguments: numbers


@intrinsic  # type: ignore[untyped-decorator]
def prefetch(typing: Any, array: Any, row: Any) -> Any:
    """Prefetch the first cache line of a row."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        byte, word = ir.IntType(8).as_pointer(), ir.IntType(32)
        address = builder.bitcast(_row_pointer(context, builder, signature.args[0], arguments[0], arguments[1]), byte)
        kind = ir.FunctionType(ir.VoidType(), [byte, word, word, word])
        function = cgutils.get_or_insert_function(builder.module, kind, "llvm.prefetch.p0")
        builder.call(function, [address, word(0), word(3), word(1)])
        return context.get_dummy_value()

    return types.void(array, types.intp), generate


@intrinsic  # type: ignore[untyped-decorator]
def load(typing: Any, array: Any, start: Any) -> Any:
    """Load sixteen elements of a contiguous float32 array from ``start`` on.

    The array must begin on a cache line, and ``start`` must be a multiple of 16.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.load(_vector_pointer(context, builder, signature.args[0], *arguments), align=64)

    return lanes(array, types.intp), generate


@intrinsic  # type: ignore[untyped-decorator]
def store(typing: Any, array: Any, start: Any, value: Any) -> Any:
    """Store a vector where `load` would read it."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        builder.store(arguments[2], _vector_pointer(context, builder, signature.args[0], *arguments[:2]), align=64)
        return context.get_dummy_value()

    return types.void(array, types.intp, lanes), generate


@intrinsic  # type: ignore[untyped-decorator]
def select_less(typing: Any, a: Any, b: Any, yes: Any, no: Any) -> Any:
    """``yes if a < b else no`` lane by lane; NaN is not less. Each argument may be a vector or a float32."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        left, right, first, second = (_broadcast(builder, value) for value in arguments)
        return builder.select(builder.fcmp_ordered("<", left, right), first, second)

    return lanes(a, b, yes, no), generate


@inner
def minimum(a, b):  # type: ignore[no-untyped-def]
    """The smaller of a vector and a float32, lane by lane."""
    return select_less(a, b, a, b)


@intrinsic  # type: ignore[untyped-decorator]
def magnitude(typing: Any, value: Any) -> Any:
    """Absolute value."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        bits = builder.and_(builder.bitcast(arguments[0], _INTEGERS), _constant(0x7FFFFFFF, _INTEGERS))
        return builder.bitcast(bits, _FLOATS)

    return lanes(lanes), generate


_POLYNOMIAL = (0.00132765, 0.00967554, 0.05550713, 0.2402212, 0.69314697, 1.00000007)


@intrinsic  # type: ignore[untyped-decorator]
def exp2_of(typing: Any, value: Any) -> Any:
    """2^t for t in [-126, 0], undefined elsewhere; by the polynomial of `compiled.exp2_nonpositive`."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        (t,) = arguments
        exponent = builder.fptosi(builder.fsub(t, _constant(0.5)), _INTEGERS)
        fraction = builder.fsub(t, builder.sitofp(exponent, _FLOATS), flags=_FLAGS)
        result = _constant(_POLYNOMIAL[0])
        for coefficient in _POLYNOMIAL[1:]:
            result = builder.fadd(builder.fmul(result, fraction, flags=_FLAGS), _constant(coefficient), flags=_FLAGS)
        power = builder.shl(builder.add(exponent, _constant(127, _INTEGERS)), _constant(23, _INTEGERS))
        return builder.fmul(result, builder.bitcast(power, _FLOATS), flags=_FLAGS)

    return lanes(lanes), generate


@intrinsic  # type: ignore[untyped-decorator]
def store_sums(typing: Any, array: Any, row: Any, vectors: Any) -> Any:
    """Sum each of up to 16 vectors over its lanes and write the sums to a row of 16 columns; other columns get 0.

    Vectors are added in pairs: after four such steps the lanes of one vector hold the sums of all 16.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        address = _row_pointer(context, builder, signature.args[0], arguments[0], arguments[1])
        sums = [builder.extract_value(arguments[2], k) for k in range(len(signature.args[2]))]
        sums += [_constant(0.0)] * (COUNT - len(sums))
        for width in (8, 4, 2, 1):
            # Adds lanes whose indices differ by `width`; sums of the second vector fill the lanes that become free.
            low = [i if not i & width else COUNT + i - width for i in range(COUNT)]
            high = [i + width if not i & width else COUNT + i for i in range(COUNT)]
            sums = [_folded(builder, sums[k], sums[k + len(sums) // 2], low, high) for k in range(len(sums) // 2)]
        builder.store(sums[0], builder.bitcast(address, _FLOATS.as_pointer()), align=4)
        return context.get_dummy_value()

    return types.void(array, types.intp, vectors), generate


def _folded(builder: Any, a: Any, b: Any, low: list[int], high: list[int]) -> Any:
    masks = (ir.Constant(_INTEGERS, indices) for indices in (low, high))
    return builder.fadd(*(builder.shuffle_vector(a, b, mask) for mask in masks), flags=_FLAGS)
