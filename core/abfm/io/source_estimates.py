"""Source estimates of MNE, .stc files, written; `abfm.reading.read_stc` says what they hold."""

import os

import numpy as np
from numpy.typing import ArrayLike

from abfm.errors import ResultError
from abfm.io.atomic import write_atomically
from abfm.numerics.real_numbers import real_numbers
from abfm.types import IntArray

_HEMISPHERES = ("-lh.stc", "-rh.stc")
_UNEVEN = 1e-3  # of the time between samples


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
    if np.abs(np.diff(when) - step).max(initial=0.0) > _UNEVEN * step:
        raise ResultError(
            f"cannot write {path}: its times are not evenly spaced, and .stc files know one step"
        )
    return step


def write_stc(
    path: str | os.PathLike[str], values: ArrayLike, vertices: IntArray, times: ArrayLike
) -> None:
    """Write values (T, n) at vertices (n,), counted from 0, at times (T,) in seconds, in single
    precision.

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
    step = even_step(path, when)
    parts = [
        np.array([1000 * when[0], 1000 * step], dtype=">f4"),
        np.array([len(vertices), *vertices, len(when)], dtype=">u4"),
        film.astype(">f4"),
    ]
    with write_atomically(path) as temporary:
        temporary.write_bytes(b"".join(part.tobytes() for part in parts))
