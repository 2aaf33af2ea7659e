"""Numeric arrays of MATLAB files of versions 5 to 7.2.

Format: https://www.mathworks.com/help/pdf_doc/matlab/matfile_format.pdf. Own code, as SciPy crashes
on damaged files, and makes room for sizes before it compares them with the file.
"""

import math
import struct
from collections.abc import Iterator, Mapping
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from abfm.errors import brief
from abfm.reading import inflated, most_inflated

_SIGNATURE = b"MATLAB 5.0"
_HEAD_BYTES = 128
_TYPES = dict(zip((1, 2, 3, 4, 5, 6, 7, 9, 12, 13), "bBhHiIfdqQ", strict=True))
_MATRIX = 14
_COMPRESSED = 15
_NUMERIC = range(6, 16)  # classes of arrays: double, single, and integers of 8 to 64 bits
_COMPLEX = 0x800

Element = tuple[int, bytes]
"""The type of a data element, and its bytes."""


class MatlabArrays(Mapping[str, NDArray[Any]]):
    """Numeric arrays of a file by their names, each made when it is looked up.

    A ValueError reports a damaged file, a name that several arrays have, or complex numbers.
    """

    def __init__(self, data: bytes) -> None:
        if not data.startswith(_SIGNATURE) or len(data) < _HEAD_BYTES:
            raise ValueError(
                "it is not a MATLAB file of version 5 to 7.2: write it with save(..., '-v7')"
            )
        self._order = "<" if data[126:128] == b"IM" else ">"
        self._found: dict[str, list[list[Element]]] = {}
        left = most_inflated(len(data))
        for kind, body in self._elements(data, _HEAD_BYTES):
            if kind == _COMPRESSED:
                unpacked = inflated(body, left)
                left -= len(unpacked)
                kind, body = next(self._elements(unpacked), (0, b""))
            if kind == _MATRIX:
                parts = list(islice(self._elements(body), 4))  # flags, sizes, name, numbers
                if len(parts) == 4 and self._flags(parts) & 0xFF in _NUMERIC:
                    self._found.setdefault(parts[2][1].decode("latin-1"), []).append(parts)

    def __getitem__(self, name: str) -> NDArray[Any]:
        found = self._found[name]
        if len(found) > 1:
            raise ValueError(
                f"{len(found)} of its arrays are called {brief(name)}: rename all but one"
            )
        _, (_, sizes), _, (kind, numbers) = found[0]
        if self._flags(found[0]) & _COMPLEX:
            raise ValueError(f"its array {brief(name)} is complex; expected real numbers")
        if kind not in _TYPES:
            raise ValueError(f"its array {brief(name)} is of the unknown type {kind}")
        dtype = np.dtype(self._order + _TYPES[kind])
        shape = tuple(int(size) for (size,) in struct.iter_unpack(f"{self._order}i", sizes))
        if min(shape, default=-1) < 0 or math.prod(shape) * dtype.itemsize != len(numbers):
            raise ValueError(
                f"its array {brief(name)} of shape {shape} has {len(numbers)} bytes of numbers"
            )
        return np.frombuffer(numbers, dtype).reshape(shape, order="F")

    def __iter__(self) -> Iterator[str]:
        return iter(self._found)

    def __len__(self) -> int:
        return len(self._found)

    def _flags(self, parts: list[Element]) -> int:
        flags = parts[0][1]
        return int(struct.unpack_from(f"{self._order}I", flags)[0]) if len(flags) >= 4 else 0

    def _elements(self, data: bytes, begin: int = 0) -> Iterator[Element]:
        """Yield data elements; up to four bytes stand next to their size."""
        while begin + 8 <= len(data):
            kind, size = struct.unpack_from(f"{self._order}II", data, begin)
            if small := kind >> 16:
                yield kind & 0xFFFF, data[begin + 4 : begin + 4 + min(small, 4)]
                begin += 8
                continue
            body = data[begin + 8 : begin + 8 + size]
            if len(body) < size:
                raise ValueError(
                    f"it is cut off: {len(body)} bytes are left for one part of {size}"
                )
            yield kind, body
            begin += 8 + size + (0 if kind == _COMPRESSED else -size % 8)
