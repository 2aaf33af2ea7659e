"""Source estimates of MNE, .stc files, written; `abfm.reading.read_stc` says what they hold."""

import os
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from abfm.errors import ResultError, one_line
from abfm.io.atomic import write_whole
from abfm.numerics.real_numbers import real_numbers
from abfm.reading import read_bytes, read_stc
from abfm.types import IntArray

_HEMISPHERES = ("-lh.stc", "-rh.stc")
_TIME_ROUNDING = 1e-3  # of the time between samples


def check_stc_name(path: str | os.PathLike[str]) -> None:
    """Refuse a name by which MNE would not know which hemisphere it is, by a ResultError."""
    if not os.fspath(path).endswith(_HEMISPHERES):
        raise ResultError(
            f"cannot write {path}: its name must end in {' or '.join(_HEMISPHERES)}, by which MNE "
            "knows the hemisphere"
        )


def even_step(path: str | os.PathLike[str], times: ArrayLike) -> float:
    """Return the time between samples (T,), or refuse a file whose format knows one step, by a
    ResultError, as samples are not evenly spaced.
    """
    when = real_numbers(times, "times", ResultError)
    step = float(when[-1] - when[0]) / max(len(when) - 1, 1) or 1.0
    if np.abs(np.diff(when) - step).max(initial=0.0) > _TIME_ROUNDING * step:
        raise ResultError(
            f"cannot write {path}: its times are not evenly spaced; this format has one time step"
        )
    return step


def write_stc(
    path: str | os.PathLike[str], values: ArrayLike, vertices: IntArray, times: ArrayLike
) -> str:
    """Write values (T, n) at vertices (n,), counted from 0, at times (T,) in seconds, in single
    precision.

    MNE opens two hemispheres: the other file is also written, without vertices, unless one with
    vertices exists. Return a note if that one has other times, otherwise an empty text.

    Raises
    ------
    ResultError
        If the name does not say the hemisphere, times are not evenly spaced, or the file cannot be
        written.
    """
    check_stc_name(path)
    when = real_numbers(times, "times", ResultError)
    film = real_numbers(values, "values", ResultError)
    if film.shape != (len(when), len(vertices)) or film.size == 0:
        raise ResultError(
            f"values have shape {film.shape}; expected ({len(when)}, {len(vertices)})"
        )
    head = np.array([1000 * when[0], 1000 * even_step(path, when)], dtype=">f4").tobytes()
    numbers = np.array([len(vertices), *vertices, len(when)], dtype=">u4")
    write_whole(path, head + numbers.tobytes() + film.astype(">f4").tobytes())
    other = _other_hemisphere(path)
    try:
        content = read_bytes(other) if other.is_file() else b""
        if content and content[8:12] != bytes(4):  # the number of its vertices
            frames = read_stc(content).values.shape[1]
            fits = content[:8] == head and frames == len(when)
            return "" if fits else f"MNE cannot open it with {other.name}, which has other times"
    except (OSError, ValueError) as error:
        return f"MNE cannot open it with {other.name}: {one_line(error)}"
    write_whole(other, head + np.array([0, len(when)], dtype=">u4").tobytes())
    return ""


def _other_hemisphere(path: str | os.PathLike[str]) -> Path:
    name = os.fspath(path)
    this, other = _HEMISPHERES if name.endswith(_HEMISPHERES[0]) else _HEMISPHERES[::-1]
    return Path(name.removesuffix(this) + other)
