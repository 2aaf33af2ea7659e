"""Arrays that users give: numbers, or an error that says what is wrong with them."""

import numpy as np
from numpy.typing import ArrayLike

from abfm.errors import AbfmError, ParameterError, one_line
from abfm.types import FloatArray


def real_numbers(values: ArrayLike, name: str, error: type[AbfmError] = ParameterError) -> FloatArray:
    """Whatever NumPy takes for an array of real numbers, as float64; it may hold infinities and NaN.

    Raises
    ------
    AbfmError
        Of the given kind, if it is something else: text, objects, complex numbers, rows of different lengths, or
        values that are masked.
    """
    try:
        array = np.asarray(values)
    except (ValueError, TypeError, OverflowError, RuntimeError) as problem:  # also what __array__ raises
        raise error(f"{name} is no array: {one_line(problem, 80)}; expected real numbers") from None
    if array.dtype.kind not in "biuf":
        raise error(f"{name} has values of type {one_line(array.dtype, 40)}; expected real numbers")
    if np.ma.is_masked(values):
        raise error(f"{name} has values that are masked; expected real numbers")
    with np.errstate(over="ignore"):  # numbers of more digits may be larger
        return array.astype(np.float64, copy=False)
