"""Sets of axes as bits: axis a is bit a % 64 of word a // 64."""

from typing import Any, TypeAlias

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic, overload
from numpy.typing import NDArray

from lmd.core.compiled import OVERLOAD_INLINED, inlined

Integer: TypeAlias = int | np.integer[Any]  # an index or a count in compiled code, of any width
WordArray: TypeAlias = NDArray[np.uint64]  # sets of axes

BITS = 64
LANES = 32  # axes or landmarks tested at a time, a bit of a word each
ZERO, ONE, ALL = np.uint64(0), np.uint64(1), np.uint64(2**64 - 1)
HALF, LOWER = np.uint64(32), np.uint64(2**32 - 1)  # two numbers in one word: a << HALF | b


def lowest(word: Any) -> np.uint64:
    """Index of the lowest bit that is set in a word other than 0; compiled, one instruction."""
    return np.uint64((int(word) & -int(word)).bit_length() - 1)


def prefetch(array: Any, index: Any) -> None:
    """Ask for two lines of the cache, 16 numbers of 64 bits from this one on of an array in C order, needed soon."""


@intrinsic
def _trailing_zeros(_typing_context: Any, word: Any) -> Any:
    def codegen(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        return builder.cttz(arguments[0], ir.Constant(ir.IntType(1), 1))

    return word(word), codegen


@intrinsic
def _prefetch_lines(_typing_context: Any, array: Any, index: Any) -> Any:
    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        array = context.make_array(signature.args[0])(context, builder, arguments[0])
        integer, pointer = ir.IntType(32), ir.IntType(8).as_pointer()
        kind = ir.FunctionType(ir.VoidType(), [pointer, integer, integer, integer])
        function = builder.module.declare_intrinsic("llvm.prefetch", [pointer], kind)
        for item in (0, 8):
            index = builder.add(arguments[1], ir.Constant(ir.IntType(64), item))
            address = builder.bitcast(builder.gep(array.data, [index]), pointer)
            builder.call(function, [address, *(ir.Constant(integer, value) for value in (0, 3, 1))])
        return context.get_dummy_value()

    return types.void(array, index), codegen


@overload(lowest, jit_options=OVERLOAD_INLINED)
def _lowest(word):  # type: ignore[no-untyped-def] # noqa: ARG001
    return lambda word: _trailing_zeros(word)  # type: ignore[call-arg]


@overload(prefetch, jit_options=OVERLOAD_INLINED)
def _prefetch(array, index):  # type: ignore[no-untyped-def] # noqa: ARG001
    return lambda array, index: _prefetch_lines(array, index)  # type: ignore[call-arg]


@inlined
def add_digit(digit: np.uint64, carry: np.uint64, goes: np.uint64) -> tuple[np.uint64, np.uint64]:
    """Add 1 to a digit of counts at the axes `carry`, or subtract 1 at those in `goes`; also returns the next carry."""
    return digit ^ carry, carry & (digit ^ goes)


@inlined
def equal_so_far(equal: np.uint64, digit: np.uint64, n: Integer, j: Integer) -> np.uint64:
    """Axes of the set `equal` whose counts equal n in digit j, too."""
    return equal & (digit if n >> j & 1 else ~digit)


@inlined
def at_least_so_far(reached: np.uint64, digit: np.uint64, n: Integer, j: Integer) -> np.uint64:
    """Axes whose counts are at least n in digits 0 to j; `reached` has those of digits 0 to j - 1."""
    return reached & digit if n >> j & 1 else reached | digit


@inlined
def add_set(digits: WordArray, axes: np.uint64, goes: np.uint64) -> None:
    """Count one less in `digits` `(J,)`, the lowest first, at `axes` that are in `goes`, one more at the others."""
    for j in range(np.uint64(len(digits))):
        digits[j], axes = add_digit(digits[j], axes, goes)


@inlined
def exactly(digits: WordArray, n: Integer) -> np.uint64:
    """The axes where the counts `digits` `(J,)` equal n."""
    equal = ALL
    for j in range(np.uint64(len(digits))):
        equal = equal_so_far(equal, digits[j], n, j)
    return equal


@inlined
def at_least(digits: WordArray, n: Integer) -> np.uint64:
    """The axes where the counts `digits` `(J,)` are at least n."""
    reached = ALL
    for j in range(np.uint64(len(digits))):
        reached = at_least_so_far(reached, digits[j], n, j)
    return reached


def in_words(values: np.ndarray) -> np.ndarray:
    """Fill the last axis of `values` `(..., D)` up with zeros to whole words."""
    missing = -values.shape[-1] % BITS
    return np.ascontiguousarray(np.pad(values, [(0, 0)] * (values.ndim - 1) + [(0, missing)]))


def packed(flags: np.ndarray) -> np.ndarray:
    """The sets `(..., W)` uint64 of `flags` `(..., D)`."""
    missing = -flags.shape[-1] % BITS
    padded = np.pad(flags, [(0, 0)] * (flags.ndim - 1) + [(0, missing)])
    return np.packbits(padded, axis=-1, bitorder="little").view("<u8").astype(np.uint64, copy=False)


def unpacked(words: np.ndarray, size: int) -> np.ndarray:
    """The flags `(..., size)` of the sets `words` `(..., W)`, 0 or 1."""
    octets = np.ascontiguousarray(words.astype("<u8", copy=False)).view(np.uint8)
    return np.unpackbits(octets, axis=-1, count=size, bitorder="little")
