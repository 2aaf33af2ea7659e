"""Writer of source estimates of MNE (.stc); `abfm.reading.read_stc` documents the format."""

import os
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from abfm.errors import ResultError, one_line
from abfm.io.atomic import write_file
from abfm.numerics.real_numbers import real_numbers
from abfm.reading import read_bytes, read_stc
from abfm.types import IntArray

_HEMISPHERES = ("-lh.stc", "-rh.stc")
_TIME_ROUNDING = 1e-3  # largest error of a time, as a fraction of the time between samples


def check_stc_name(path: str | os.PathLike[str]) -> None:
    """Raise a ResultError if the name does not have the ending of a hemisphere, as MNE requires."""
    if not os.fspath(path).endswith(_HEMISPHERES):
        raise ResultError(
            f"cannot write {path}: the name must end with {' or '.join(_HEMISPHERES)}, so that MNE "
            "can identify the hemisphere"
        )


def even_step(path: str | os.PathLike[str], times: ArrayLike) -> float:
    """Return the step between times (T,), or raise a ResultError if they are not evenly spaced."""
    seconds = real_numbers(times, "times", ResultError)
    step = float(seconds[-1] - seconds[0]) / max(len(seconds) - 1, 1) or 1.0
    if np.abs(np.diff(seconds) - step).max(initial=0.0) > _TIME_ROUNDING * step:
        raise ResultError(f"cannot write {path}: this format requires evenly spaced times")
    return step


def write_stc(
    path: str | os.PathLike[str], values: ArrayLike, vertices: IntArray, times: ArrayLike
) -> str:
    """Write values (T, n) of vertices (n,), counted from 0, at times (T,) in seconds.

    Values have single precision. MNE opens the files of both hemispheres together. Therefore the
    file of the other hemisphere is also written, without vertices, unless it exists and has
    vertices. Return a note if the existing file does not fit, or else an empty text.

    Raises
    ------
    ResultError
        If the name does not have the ending of a hemisphere, times are not evenly spaced, or the
        file cannot be written.
    """
    check_stc_name(path)
    seconds = real_numbers(times, "times", ResultError)
    frames = real_numbers(values, "values", ResultError)
    if frames.shape != (len(seconds), len(vertices)) or frames.size == 0:
        raise ResultError(
            f"values have shape {frames.shape}; expected ({len(seconds)}, {len(vertices)}), one "
            "row for each time"
        )
    head = np.array([1000 * seconds[0], 1000 * even_step(path, seconds)], dtype=">f4").tobytes()
    numbers = np.array([len(vertices), *vertices, len(seconds)], dtype=">u4")
    write_file(path, head + numbers.tobytes() + frames.astype(">f4").tobytes())
    name = os.fspath(path)
    this, that = _HEMISPHERES if name.endswith(_HEMISPHERES[0]) else _HEMISPHERES[::-1]
    other = Path(name.removesuffix(this) + that)
    try:
        content = read_bytes(other) if other.is_file() else b""
        if content and content[8:12] != bytes(4):  # the number of vertices is not 0
            count = read_stc(content).values.shape[1]
            fits = content[:8] == head and count == len(seconds)
            note = f"MNE cannot open the file together with {other.name}, which has other times"
            return "" if fits else note
    except (OSError, ValueError) as error:
        return f"MNE cannot open the file together with {other.name}: {one_line(error)}"
    write_file(other, head + np.array([0, len(seconds)], dtype=">u4").tobytes())
    return ""
