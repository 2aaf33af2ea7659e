"""Arrays in a page: whole numbers, as differences from row to row, in planes of bytes, deflated.

What changes little from frame to frame becomes mostly zeros, which deflate well; a browser inflates
by itself (`packing.js` is the other side).
"""

from __future__ import annotations

import base64
import zlib
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from abfm.types import FloatArray

LEVELS = 4095
"""Steps between the least and the greatest value: a colour map has 256 colours."""
NO_VALUE = 65535
"""Stands for no value."""
_PLACES = 65535  # steps along each side of a mesh's box


@dataclass(frozen=True, eq=False)
class Quantised:
    """Values as whole numbers: ``least + step * numbers``, within half a step; `NO_VALUE` for
    NaN.
    """

    numbers: NDArray[np.uint16]
    least: float
    step: float

    def place(self, value: float) -> float:
        """Return where a value lies, in steps from the least."""
        return (value - self.least) / self.step


def quantised(values: ArrayLike) -> Quantised:
    """Return values (T, V) in `LEVELS` steps from the least to the greatest one that is finite.

    Neither infinite values nor NaN have a colour, and both are `NO_VALUE`.
    """
    given = np.asarray(values, dtype=float)
    known = np.isfinite(given)
    least, most = (given[known].min(), given[known].max()) if known.any() else (0.0, 0.0)
    unit = max(abs(least), abs(most)) or 1.0  # in which no difference of huge values is infinite
    step = (most / unit - least / unit) / LEVELS or 1.0
    numbers = np.full(given.shape, NO_VALUE, dtype=np.uint16)
    numbers[known] = np.round((given[known] / unit - least / unit) / step)
    return Quantised(numbers, float(least), float(step * unit) or 1.0)


def quantised_places(points: FloatArray) -> tuple[NDArray[np.uint16], FloatArray, FloatArray]:
    """Return points (N, 3) in steps along the sides of their box, its lowest corner and the steps;
    they come back within half a step.
    """
    low = points.min(axis=0)
    steps = np.ptp(points, axis=0) / _PLACES
    numbers = np.round((points - low) / np.where(steps > 0, steps, 1.0))
    return numbers.astype(np.uint16), low, steps


@dataclass
class Store:
    """Collects arrays, which are then known by where they are, and gives all as one text."""

    _parts: list[bytes] = field(default_factory=list)
    _size: int = 0

    def add(self, array: NDArray[Any]) -> dict[str, int]:
        """Put in unsigned integers or single precision, (rows, columns) or one row."""
        rows = np.atleast_2d(array)
        if rows.dtype.kind == "f":
            rows = np.ascontiguousarray(rows, dtype="<f4").view("<u4")
        rows = np.ascontiguousarray(rows, dtype=rows.dtype.newbyteorder("<"))
        size = rows.dtype.itemsize
        changes = rows.copy()
        changes[1:] -= rows[:-1]  # wraps around
        planes = changes.reshape(-1).view(np.uint8).reshape(-1, size).T
        where = {"offset": self._size, "rows": rows.shape[0], "columns": rows.shape[1]}
        self._parts.append(planes.tobytes())
        self._size += rows.nbytes
        return where | {"bytes": size}

    def text(self) -> str:
        """Return all arrays, deflated, as base64."""
        deflater = zlib.compressobj(9)
        deflated = [deflater.compress(part) for part in self._parts]
        return base64.b64encode(b"".join([*deflated, deflater.flush()])).decode()
