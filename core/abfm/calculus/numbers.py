"""Real numbers, and arrays of them, of whatever a caller gives."""

import numpy as np
from numpy.typing import ArrayLike

from abfm.errors import AbfmError
from abfm.types import FloatArray


def real_numbers(values: ArrayLike, name: str, error: type[AbfmError]) -> FloatArray:
    """The values as float64, in their shape, also infinite ones and NaN.

    Raises
    ------
    AbfmError
        Of the given type, if they are no array of real numbers: ragged lists, texts, complex numbers, objects.
    """
    try:
        array = np.asarray(values)
    except (ValueError, TypeError):
        raise error(f"{name} is no array: its rows differ in length; give an array of real numbers") from None
    if array.dtype.kind not in "biuf":
        raise error(f"{name} has values of type {array.dtype}; expected real numbers")
    with np.errstate(over="ignore"):  # of longer floats
        return array.astype(np.float64, copy=False)


def is_finite_number(value: object) -> bool:
    """Whether it is one finite real number, of any type of NumPy's but truth values."""
    try:
        array = np.asarray(value)
    except (ValueError, TypeError):
        return False
    return array.ndim == 0 and array.dtype.kind in "iuf" and bool(np.isfinite(array))


def is_whole_number(value: object, least: int, most: int) -> bool:
    """Whether it is one whole number between two, the ends included."""
    if not is_finite_number(value):
        return False
    number = float(np.asarray(value))
    return least <= number <= most and number == int(number)
