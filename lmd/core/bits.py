"""Bit masks over the orientations of a camera, and counters for each orientation that are stored as binary digits.

An orientation of the camera is called an axis. A mask has one bit for each axis, in 64-bit integers that are called
words: axis a is bit a % 64 of word a // 64. A counter is a number for each axis, such as the number of landmarks in
view. The counters of the 64 axes of a word are stored as J words: word j has binary digit j of each of the 64
counters. So an instruction of the processor works on 64 counters.
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
    """Load 16 elements of an array into the processor's cache before they are needed, from the element `index` on.

    The array is in C order. An element has 64 bits, so 16 elements fill two cache lines.
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
    """Add the bits `carry` to one binary digit of the counters of 64 axes.

    All arguments are 64-bit masks with one bit for each axis. At the axes whose bit in `decrement` is 1, `carry` is
    subtracted instead. Returns the new digit, and the carry (or borrow) for the next digit.
    """
    return digit ^ carry, carry & (digit ^ decrement)


@inlined
def equal_so_far(equal: np.uint64, digit: np.uint64, n: Integer, j: Integer) -> np.uint64:
    """Mask of those axes in the mask `equal` whose counter has the same binary digit j as the number n.

    Masks are 64-bit integers with one bit for each axis. `digit` has bit j of the counter of each axis. Calls for all
    digits j, one after the other, leave the axes whose counter equals n.
    """
    return equal & (digit if n >> j & 1 else ~digit)


@inlined
def add_set(digits: WordArray, axes: np.uint64, decrement: np.uint64) -> None:
    """Add 1 to the counters of the axes in the mask `axes`, or subtract 1 from those that are also in `decrement`.

    A mask is a 64-bit integer with one bit for each axis. `digits` `(J,)` are the binary digits of the counters, the
    lowest digit first: digit j has bit j of the counter of each axis. The digits are changed in place.
    """
    for j in range(np.uint64(len(digits))):
        digits[j], axes = add_digit(digits[j], axes, decrement)


@inlined
def exactly(digits: WordArray, n: Integer) -> np.uint64:
    """Mask of the axes whose counter equals n: a 64-bit integer with one bit for each axis.

    `digits` `(J,)` are the binary digits of the counters, the lowest first: digit j has bit j of each counter.
    """
    equal = ALL
    for j in range(np.uint64(len(digits))):
        equal = equal_so_far(equal, digits[j], n, j)
    return equal


@inlined
def at_least(digits: WordArray, n: Integer) -> np.uint64:
    """Mask of the axes whose counter is at least n: a 64-bit integer with one bit for each axis.

    `digits` `(J,)` are the binary digits of the counters, the lowest first: digit j has bit j of each counter.
    """
    reached = ALL
    for j in range(np.uint64(len(digits))):
        # The axes whose counts, taken modulo 2^(j + 1), are at least n modulo 2^(j + 1).
        reached = reached & digits[j] if n >> j & 1 else reached | digits[j]
    return reached


def in_words(values: np.ndarray) -> np.ndarray:
    """Copy of an array `(..., D)`, with zeros appended to its last axis so that D is a multiple of 64, see `packed`."""
    missing = -values.shape[-1] % BITS
    return np.ascontiguousarray(np.pad(values, [(0, 0)] * (values.ndim - 1) + [(0, missing)]))


def packed(flags: np.ndarray) -> np.ndarray:
    """Pack flags (0 or 1) `(..., D)` into 64-bit integers `(..., W)`: flag d becomes bit d % 64 of integer d // 64.

    W is D / 64, rounded up; unused bits are 0.
    """
    return np.packbits(in_words(flags), axis=-1, bitorder="little").view("<u8").astype(np.uint64, copy=False)


def unpacked(words: np.ndarray, size: int) -> np.ndarray:
    """Flags (0 or 1) `(..., size)` from the 64-bit integers `words` `(..., W)` in which `packed` stored the flags."""
    octets = np.ascontiguousarray(words.astype("<u8", copy=False)).view(np.uint8)
    return np.unpackbits(octets, axis=-1, count=size, bitorder="little")
