"""Numbers and arrays that users give, or an error that says what is wrong with them."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from abfm.errors import AbfmError, ParameterError, one_line
from abfm.types import FloatArray


def real_numbers(
    values: ArrayLike, name: str, error: type[AbfmError] = ParameterError
) -> FloatArray:
    """Return an array of real numbers as float64, row after row; it may hold infinities and NaN.

    ``error`` is raised for anything else: text, objects, complex numbers, rows of different
    lengths, or values that are masked.
    """
    try:
        array = np.asarray(values)
    except (ValueError, TypeError, OverflowError, RuntimeError) as problem:  # or of __array__
        raise error(f"{name} is no array: {one_line(problem, 80)}; expected real numbers") from None
    if array.dtype.kind not in "biuf":
        raise error(f"{name} has values of type {one_line(array.dtype, 40)}; expected real numbers")
    if np.ma.is_masked(values):
        raise error(f"{name} has values that are masked; expected real numbers")
    return as_doubles(array)


def as_doubles(array: NDArray[Any]) -> FloatArray:
    """Return numbers as float64, row after row; infinities and NaN without a warning."""
    with np.errstate(over="ignore", invalid="ignore"):
        return array.astype(np.float64, order="C", copy=False)


def is_finite_number(value: object) -> bool:
    """Return whether it is one finite real number, of any type of NumPy's but truth values."""
    try:
        array = np.asarray(value)
    except (ValueError, TypeError):
        return False
    return array.ndim == 0 and array.dtype.kind in "iuf" and bool(np.isfinite(array))


def is_whole_number(value: object, least: int, most: int) -> bool:
    """Return whether it is one whole number between two, the ends included."""
    if not is_finite_number(value):
        return False
    number = float(np.asarray(value))
    return least <= number <= most and number == int(number)
