"""Arrays in NumPy's own format (.npy): a header is believed when it fits what follows it, byte for byte.

Own code, as NumPy's reader hands headers to Python's parser, which throws anything, and makes room for what they say
before it looks whether so much follows.
"""

import math
import re
import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray

from abfm.errors import one_line

_MAGIC = b"\x93NUMPY"
_LENGTHS = {1: 2, 2: 4, 3: 4}  # bytes of the header's length, by the format's version
_MOST_DIMENSIONS = 32
_ENTRY = re.compile(r"""\s*(['"])(\w+)\1\s*:\s*(?:(['"])([^'"\\]*)\3|(True|False)|\(([^()]*)\))\s*(?:,\s*|$)""")
_TYPE = re.compile(r"[<>=|]?([biufcSU]\d{1,9}|[?O])")


def array_from(data: bytes) -> NDArray[Any]:
    """The array that the bytes of a .npy file hold, of numbers, booleans or texts.

    Raises
    ------
    ValueError
        If they are no .npy file, hold anything else, or are more or fewer than the array.
    """
    header, start = _header(data)
    dtype, shape = _dtype(header), _shape(header)
    size = math.prod(shape) * dtype.itemsize
    if start + size != len(data):
        raise ValueError(
            f"its size is not what its header says: {len(data) - start} bytes follow, and {dtype} of shape "
            f"{one_line(shape, 60)} have {size}"
        )
    array = np.frombuffer(data, dtype, math.prod(shape), start)
    if dtype.kind == "b" and (array.view(np.uint8) > 1).any():
        raise ValueError("a boolean is neither 0 nor 1")
    if dtype.kind == "U" and (array.view(np.dtype("u4").newbyteorder(dtype.byteorder)) > sys.maxunicode).any():
        raise ValueError("a letter is none of Unicode's")
    return array.reshape(shape, order="F" if header.get("fortran_order") == "True" else "C").copy(order="K")


def _header(data: bytes) -> tuple[dict[str, str], int]:
    """The entries of the header as their texts, and where the array begins."""
    if data[:6] != _MAGIC or len(data) < 8 or data[6] not in _LENGTHS:
        raise ValueError("it does not begin as a .npy file of version 1, 2 or 3 does")
    begin = 8 + _LENGTHS[data[6]]
    end = begin + int.from_bytes(data[8:begin], "little")
    if end > len(data):
        raise ValueError("it ends within its header")
    text = data[begin:end].decode("latin-1").strip()
    entries, place = {}, 1
    if text[:1] + text[-1:] == "{}":
        while found := _ENTRY.match(text, place, len(text) - 1):
            entries[found[2]] = next(value for value in found.group(4, 5, 6) if value is not None)
            place = found.end()
    if place != len(text) - 1 or entries.keys() != {"descr", "fortran_order", "shape"}:
        raise ValueError("its header is damaged, or describes no plain array")
    return entries, end


def _dtype(header: dict[str, str]) -> np.dtype[Any]:
    text = header["descr"]
    try:
        dtype = np.dtype(text) if _TYPE.fullmatch(text) else None
    except (TypeError, ValueError):
        dtype = None
    if dtype is None or dtype.itemsize == 0:
        raise ValueError(f"its type is {text[:40]!r}; expected numbers, such as '<f8'")
    if dtype.hasobject:
        raise ValueError(f"it has type {dtype}; expected no Python objects")
    return dtype


def _shape(header: dict[str, str]) -> tuple[int, ...]:
    words = [word.strip().removesuffix("L") for word in header["shape"].split(",")]
    if words[-1] == "":  # (3,) has a comma more than numbers, () has none
        words.pop()
    if len(words) > _MOST_DIMENSIONS or not all(word.isdigit() and len(word) <= 18 for word in words):
        raise ValueError(f"its shape ({header['shape'][:40]}) is no size; expected whole numbers, 0 or more")
    return tuple(map(int, words))
