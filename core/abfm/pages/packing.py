"""Packing of arrays in a page: differences between consecutive rows, as deflated integers.

The first bytes of all integers precede the second bytes, and so on. Differences between similar
frames are mostly zero, which deflates well. Browsers can inflate without a library; `packing.js`
unpacks the arrays.
"""

from __future__ import annotations

import base64
import zlib
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from abfm.types import FloatArray

LEVELS = 4095  # number of steps between the ends of the colours; a colour map has 256 colours
_LEVELS_MAX = 65534
NO_VALUE = 65535  # number that represents an unknown value
_COORDINATE_LEVELS = 65535  # steps along each side of the bounding box


@dataclass(frozen=True, eq=False)
class Quantized:
    """Values as integers: ``minimum + step * numbers``, within half a step. NaN is `NO_VALUE`."""

    numbers: NDArray[np.uint16]
    minimum: float
    step: float

    def position(self, value: float) -> float:
        return (value - self.minimum) / self.step


def quantized(values: ArrayLike, stretch: float = 1.0) -> Quantized:
    """Return values (T, V) in `LEVELS` steps of their range; `NO_VALUE` if not finite.

    If the range is ``stretch`` times as long as that of the colours, it has as many times the
    steps, up to the largest number.
    """
    levels = min(round(LEVELS * max(stretch, 1.0)), _LEVELS_MAX)
    given = np.asarray(values, dtype=float)
    known = np.isfinite(given)
    minimum, maximum = (given[known].min(), given[known].max()) if known.any() else (0.0, 0.0)
    unit = max(abs(minimum), abs(maximum)) or 1.0  # prevents overflow of differences of huge values
    step = (maximum / unit - minimum / unit) / levels or 1.0
    numbers = np.full(given.shape, NO_VALUE, dtype=np.uint16)
    numbers[known] = np.round((given[known] / unit - minimum / unit) / step)
    return Quantized(numbers, float(minimum), float(step * unit) or 1.0)


def quantized_points(points: FloatArray) -> tuple[NDArray[np.uint16], FloatArray, FloatArray]:
    """Return points (N, 3) as integers, the lowest corner of their bounding box, and steps (3,).

    Points recovered as ``corner + steps * integers`` differ by at most half a step.
    """
    low = points.min(axis=0)
    steps = np.ptp(points, axis=0) / _COORDINATE_LEVELS
    numbers = np.round((points - low) / np.where(steps > 0, steps, 1.0))
    return numbers.astype(np.uint16), low, steps


@dataclass
class Store:
    """Arrays that are written as one text; each array is identified by its offset in bytes."""

    _parts: list[bytes] = field(default_factory=list)
    _size: int = 0

    def add(self, array: NDArray[Any]) -> dict[str, int]:
        """Append an array (rows, columns) or (columns,), and return a description of it.

        It has offset, rows, columns and bytes per value. Values are unsigned integers, or real
        numbers, which are stored in single precision.
        """
        rows = np.atleast_2d(array)
        if rows.dtype.kind == "f":
            rows = np.ascontiguousarray(rows, dtype="<f4").view("<u4")
        rows = np.ascontiguousarray(rows, dtype=rows.dtype.newbyteorder("<"))
        size = rows.dtype.itemsize
        changes = rows.copy()
        changes[1:] -= rows[:-1]  # unsigned differences wrap around
        planes = changes.reshape(-1).view(np.uint8).reshape(-1, size).T
        entry = {"offset": self._size, "rows": rows.shape[0], "columns": rows.shape[1]}
        self._parts.append(planes.tobytes())
        self._size += rows.nbytes
        return entry | {"bytes": size}

    def text(self) -> str:
        deflater = zlib.compressobj(9)
        deflated = [deflater.compress(part) for part in self._parts]
        return base64.b64encode(b"".join([*deflated, deflater.flush()])).decode()
