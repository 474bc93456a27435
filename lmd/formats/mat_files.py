"""MATLAB's files of version 5 to 7 as keys and plain values: numbers, texts and structures.

SciPy's compiled reader ends the process on some damaged files; this reader is for untrusted files.

Source: "MAT-File Format", R2024a, The MathWorks.
"""

import struct
import zlib
from collections.abc import Iterator
from math import prod
from typing import Any

import numpy as np

HEADER = 128  # size of the header before the first element, bytes
MATRIX, COMPRESSED, UTF8 = 14, 15, 16  # types of elements; lower types are numbers
NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
TEXTS = {UTF8: "utf-8", 17: "utf-16", 18: "utf-32"}
STRUCTURE, OBJECT, CHARACTERS, DOUBLE, LAST_NUMERIC = 2, 3, 4, 6, 15  # classes of arrays
COMPLEX = 0x800
SKIPPED = object()  # stands for a cell, a sparse matrix, an object of a class, or a large array


class MatFile:
    """Reader of a MATLAB file.

    Args:
        content: bytes of the file.
        largest: greatest expanded size of a compressed element, bytes.
        numbers: greatest number of entries of an array that is kept.
        depth: greatest depth of structures.
    """

    def __init__(self, content: bytes, largest: int, numbers: int, depth: int) -> None:
        self.content = content
        self.order = "<" if content[126:128] == b"IM" else ">"
        self.left, self.numbers, self.depth = largest, numbers, depth

    def keys(self) -> dict[str, Any]:
        """Variables by name, without skipped variables.

        Raises:
            ValueError, struct.error, zlib.error: the file is damaged, or its expanded size is too large.
        """
        found = {}
        for kind, data in self._elements(self.content[HEADER:]):
            if kind == COMPRESSED:
                expander = zlib.decompressobj()
                data = expander.decompress(data, self.left)
                self.left -= len(data)
                if expander.unconsumed_tail or self.left <= 0:
                    raise ValueError("it expands to too much")
                kind, data = next(self._elements(data), (0, b""))
            if kind == MATRIX:
                name, value = self._matrix(data, self.depth)
                if value is not SKIPPED:
                    found[name] = value
        return found

    def _elements(self, data: bytes) -> Iterator[tuple[int, bytes]]:
        """Types and contents of consecutive elements."""
        place = 0
        while place + 8 <= len(data):
            kind, size = struct.unpack_from(f"{self.order}II", data, place)
            if kind >> 16:  # a small element has its size, type and content in eight bytes
                kind, size = kind & 0xFFFF, kind >> 16
                if size > 4:
                    raise ValueError(f"a small element has {size} bytes")
                yield kind, data[place + 4 : place + 4 + size]
                place += 8
                continue
            if (inner := data[place + 8 : place + 8 + size]) and len(inner) < size:
                raise ValueError("it ends within an element")
            yield kind, inner
            place += 8 + size + (0 if kind == COMPRESSED else -size % 8)

    def _matrix(self, data: bytes, depth: int) -> tuple[str, Any]:
        """Name and value of an array."""
        parts = self._elements(data)
        flags = self._array(*next(parts, (0, b"")))
        if not flags.size:
            return "", SKIPPED
        shape = [int(side) for side in self._array(*next(parts, (0, b"")))]
        kind, count = int(flags[0]) & 0xFF, prod(shape) if len(shape) >= 2 and min(shape) >= 0 else self.numbers + 1
        if kind > LAST_NUMERIC or count > self.numbers or int(flags[0]) & COMPLEX:
            return "", SKIPPED
        name = next(parts, (0, b""))[1].decode()
        if kind == STRUCTURE:
            return name, self._structure(parts, depth) if count == 1 and depth else SKIPPED
        if kind == CHARACTERS:
            coding, text = next(parts, (UTF8, b""))
            if coding in TEXTS:
                return name, text.decode(TEXTS[coding])
            return name, "".join(chr(code) for code in self._array(coding, text).tolist())
        if not DOUBLE <= kind <= LAST_NUMERIC:
            return name, SKIPPED
        array = self._array(*next(parts, (0, b"")))
        if array.size != count:
            raise ValueError(f"the array {name[:40]!r} has {array.size} numbers in place of {count}")
        plain = array.reshape(shape, order="F").squeeze().tolist()
        return name, plain

    def _structure(self, parts: Iterator[tuple[int, bytes]], depth: int) -> dict[str, Any]:
        """Fields of a structure."""
        length = int(self._array(*next(parts, (0, b""))).sum())
        names = next(parts, (0, b""))[1]
        if not 0 < length <= 256:
            raise ValueError(f"names of fields have {length} bytes")
        fields = [names[i : i + length].split(b"\0")[0].decode() for i in range(0, len(names), length)]
        found = {}
        for field, (kind, data) in zip(fields, parts, strict=False):
            if kind == MATRIX and data and (value := self._matrix(data, depth - 1)[1]) is not SKIPPED:
                found[field] = value
        return found

    def _array(self, kind: int, data: bytes) -> Any:
        """Numbers of an element."""
        if kind not in NUMBERS:
            raise ValueError(f"an element is of the type {kind}, which has no numbers")
        return np.frombuffer(data, dtype=f"{self.order}{NUMBERS[kind]}")
