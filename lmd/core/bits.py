"""Bit masks of axes (orientations of a camera), and counters for each axis that are stored as binary digits.

A mask is an array of 64-bit integers, called words: axis a is bit a % 64 of word a // 64. The counts of the 64 axes of
a word are J words: digit j of the counts is a word that holds bit j of the count of each axis.
"""

from typing import Any, TypeAlias

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic, overload
from numpy.typing import NDArray

from lmd.core.compiled import OVERLOAD_INLINED, inlined

Integer: TypeAlias = int | np.integer[Any]  # index or count in compiled code, an integer of any width
WordArray: TypeAlias = NDArray[np.uint64]  # sets of axes

BITS = 64
LANES = 32  # number of axes or landmarks that are tested at once, one bit each
ZERO, ONE, ALL = np.uint64(0), np.uint64(1), np.uint64(2**64 - 1)
HALF, LOWER = np.uint64(32), np.uint64(2**32 - 1)  # shift and mask to pack two numbers into a word, a << HALF | b


def lowest(word: Any) -> np.uint64:
    """Index of the lowest set bit of a nonzero word; one instruction in compiled code."""
    return np.uint64((int(word) & -int(word)).bit_length() - 1)


def prefetch(array: Any, index: Any) -> None:
    """Tell the processor to load elements of an array that are needed soon: 16 elements of 64 bits (two cache lines),
    from `index` on; the array is in C order.
    """


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
def add_digit(digit: np.uint64, carry: np.uint64, decrement: np.uint64) -> tuple[np.uint64, np.uint64]:
    """Add `carry` to one binary digit of the counts; at the axes in `decrement`, subtract `carry` instead.

    All arguments are words with a bit for each axis. Returns the new digit, and the carry (or borrow) for the next
    digit.
    """
    return digit ^ carry, carry & (digit ^ decrement)


@inlined
def equal_so_far(equal: np.uint64, digit: np.uint64, n: Integer, j: Integer) -> np.uint64:
    """Word of those axes in the word `equal` whose count has the same bit j as n.

    `digit` is digit j of the counts, a word with a bit for each axis.
    """
    return equal & (digit if n >> j & 1 else ~digit)


@inlined
def add_set(digits: WordArray, axes: np.uint64, decrement: np.uint64) -> None:
    """Add 1 to the counts at the axes in the word `axes`; subtract 1 instead at those that are also in `decrement`.

    `digits` `(J,)` are the binary digits of the counts, the lowest digit first; they are changed in place.
    """
    for j in range(np.uint64(len(digits))):
        digits[j], axes = add_digit(digits[j], axes, decrement)


@inlined
def exactly(digits: WordArray, n: Integer) -> np.uint64:
    """Word with a bit for each axis whose count equals n; `digits` `(J,)` are the binary digits of the counts."""
    equal = ALL
    for j in range(np.uint64(len(digits))):
        equal = equal_so_far(equal, digits[j], n, j)
    return equal


@inlined
def at_least(digits: WordArray, n: Integer) -> np.uint64:
    """Word with a bit for each axis whose count is at least n; `digits` `(J,)` are the binary digits of the counts."""
    reached = ALL
    for j in range(np.uint64(len(digits))):
        # The axes whose counts, taken modulo 2^(j + 1), are at least n modulo 2^(j + 1).
        reached = reached & digits[j] if n >> j & 1 else reached | digits[j]
    return reached


def in_words(values: np.ndarray) -> np.ndarray:
    """Pad the last axis of `values` `(..., D)` with zeros to a multiple of `BITS`."""
    missing = -values.shape[-1] % BITS
    return np.ascontiguousarray(np.pad(values, [(0, 0)] * (values.ndim - 1) + [(0, missing)]))


def packed(flags: np.ndarray) -> np.ndarray:
    """Pack flags, 0 or 1, `(..., D)`, into bit sets of W 64-bit words, `(..., W)`."""
    return np.packbits(in_words(flags), axis=-1, bitorder="little").view("<u8").astype(np.uint64, copy=False)


def unpacked(words: np.ndarray, size: int) -> np.ndarray:
    """Flags `(..., size)`, 0 or 1, of the bit sets `words` `(..., W)`."""
    octets = np.ascontiguousarray(words.astype("<u8", copy=False)).view(np.uint8)
    return np.unpackbits(octets, axis=-1, count=size, bitorder="little")
