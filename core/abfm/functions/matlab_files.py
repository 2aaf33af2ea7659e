"""Reader of numeric arrays of MATLAB files of versions 5 to 7.2.

Format: https://www.mathworks.com/help/pdf_doc/matlab/matfile_format.pdf. The reader of SciPy is not
used, because it crashes on damaged files and allocates memory before it checks sizes.
"""

import math
import struct
from collections.abc import Iterator
from functools import partial
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from abfm.errors import brief
from abfm.reading import PointData, inflated, inflated_size_max

_SIGNATURE = b"MATLAB 5.0"
_HEAD_BYTES = 128
_TYPES = dict(zip((1, 2, 3, 4, 5, 6, 7, 9, 12, 13), "bBhHiIfdqQ", strict=True))
_MATRIX = 14
_COMPRESSED_KIND = 15
_NUMERIC_CLASSES = range(6, 16)  # classes of arrays: double, single, and integers of 8 to 64 bits
_COMPLEX_FLAG = 0x800

Element = tuple[int, bytes]  # type and bytes of a data element


def matlab_arrays(data: bytes) -> PointData:
    """Return the numeric arrays of a MATLAB file by name; each is decoded on access.

    Raises ValueError if the file is damaged. Access raises it if several arrays have the name, or
    if the array is complex.
    """
    if not data.startswith(_SIGNATURE) or len(data) < _HEAD_BYTES:
        raise ValueError(
            "the file is not a MATLAB file of version 5 to 7.2. Write it with save(..., '-v7')"
        )
    order = "<" if data[126:128] == b"IM" else ">"
    found = []
    budget = inflated_size_max(len(data))
    for kind, body in _elements(data, order, _HEAD_BYTES):
        if kind == _COMPRESSED_KIND:
            unpacked = inflated(body, budget)
            budget -= len(unpacked)
            kind, body = next(_elements(unpacked, order), (0, b""))
        if kind == _MATRIX:
            parts = list(islice(_elements(body, order), 4))  # flags, sizes, name, numbers
            if len(parts) == 4 and _flags(parts, order) & 0xFF in _NUMERIC_CLASSES:
                name = parts[2][1].decode("latin-1")
                found.append((name, partial(_array, name, parts, order)))
    return PointData(found)


def _array(name: str, parts: list[Element], order: str) -> NDArray[Any]:
    _, (_, sizes), _, (kind, numbers) = parts
    if _flags(parts, order) & _COMPLEX_FLAG:
        raise ValueError(f"the array {brief(name)} is complex; expected real numbers")
    if kind not in _TYPES:
        raise ValueError(f"the array {brief(name)} has type {kind}, which MATLAB does not use")
    dtype = np.dtype(order + _TYPES[kind])
    shape = tuple(int(size) for (size,) in struct.iter_unpack(f"{order}i", sizes))
    if min(shape, default=-1) < 0 or math.prod(shape) * dtype.itemsize != len(numbers):
        raise ValueError(
            f"the array {brief(name)} of shape {shape} has {len(numbers)} bytes, which does not "
            "fit. The file is damaged"
        )
    return np.frombuffer(numbers, dtype).reshape(shape, order="F")


def _flags(parts: list[Element], order: str) -> int:
    flags = parts[0][1]
    return int(struct.unpack_from(f"{order}I", flags)[0]) if len(flags) >= 4 else 0


def _elements(data: bytes, order: str, begin: int = 0) -> Iterator[Element]:
    """Yield the type and bytes of each data element, from index ``begin``.

    A small element stores up to four bytes together with its size.
    """
    while begin + 8 <= len(data):
        kind, size = struct.unpack_from(f"{order}II", data, begin)
        if small := kind >> 16:
            yield kind & 0xFFFF, data[begin + 4 : begin + 4 + min(small, 4)]
            begin += 8
            continue
        body = data[begin + 8 : begin + 8 + size]
        if len(body) < size:
            raise ValueError(
                f"the file is cut off: an element has {size} bytes, but only {len(body)} remain"
            )
        yield kind, body
        begin += 8 + size + (0 if kind == _COMPRESSED_KIND else -size % 8)
