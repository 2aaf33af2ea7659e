"""Conversion and checks of numbers and arrays from users."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from abfm.errors import AbfmError, ParameterError, one_line
from abfm.types import FloatArray


def real_numbers(
    values: ArrayLike, name: str, error: type[AbfmError] = ParameterError
) -> FloatArray:
    """Return an array of real numbers as float64 in C order; infinities and NaN are allowed.

    Masked values become NaN; PyTorch tensors are detached and copied to the CPU. An ``error`` about
    ``name`` is raised for text, objects, complex numbers, or rows of different lengths.
    """
    try:
        array = plain_array(values)
    except (ValueError, TypeError, OverflowError, RuntimeError) as problem:  # also by __array__
        raise error(
            f"{name} is not an array: {one_line(problem, 80)}; expected real numbers"
        ) from None
    if array.dtype.kind not in "biuf":
        raise error(f"the type of {name} is {one_line(array.dtype, 40)}; expected real numbers")
    return as_float64(array)


def plain_array(values: Any) -> NDArray[Any]:
    """Return values as a NumPy array; see `real_numbers`. Objects may raise any error."""
    if hasattr(values, "detach") and hasattr(values, "cpu"):
        values = values.detach().cpu()
    array = np.asarray(values)
    if np.ma.is_masked(values) and array.dtype.kind in "biuf":
        array = np.where(np.ma.getmaskarray(values), np.nan, array)
    return array


def as_float64(array: NDArray[Any]) -> FloatArray:
    """Return numbers as float64 in C order, without a warning for infinities and NaN."""
    with np.errstate(over="ignore", invalid="ignore"):
        return array.astype(np.float64, order="C", copy=False)


def is_finite_number(value: object) -> bool:
    """Return whether a value is one finite real number, also of NumPy, but not a boolean."""
    try:
        array = np.asarray(value)
    except (ValueError, TypeError):
        return False
    return array.ndim == 0 and array.dtype.kind in "iuf" and bool(np.isfinite(array))


def is_integer(value: object, least: int, most: int) -> bool:
    """Return whether a value is one integer from ``least`` to ``most``, both included."""
    if not is_finite_number(value):
        return False
    number = float(np.asarray(value))
    return least <= number <= most and number == int(number)
