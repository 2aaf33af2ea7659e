"""The simplest interpolation: source fades out while target fades in, and nothing moves."""

import numpy as np
from numpy.typing import ArrayLike

from abfm.errors import FunctionError, ParameterError, brief
from abfm.numerics.real_numbers import is_finite_number, real_numbers
from abfm.types import FloatArray

_LONGEST = 1e100  # times tau


def linear_blend(f: ArrayLike, g: ArrayLike, t: float, tau: float = 1.0) -> FloatArray:
    """Return ``(1 - t / tau) f + (t / tau) g``, in the shape of ``f`` and ``g``: ``f`` at time 0,
    ``g`` at time ``tau``.

    Raises
    ------
    FunctionError
        If the functions are no arrays of finite numbers of one shape.
    ParameterError
        If a time is no finite number, or ``tau`` is not positive.
    """
    if not (
        is_finite_number(t)
        and is_finite_number(tau)
        and tau > 0
        and abs(float(t)) < _LONGEST * float(tau)
    ):
        raise ParameterError(
            f"t is {brief(t)} and tau {brief(tau)}; expected a finite time and a positive one"
        )
    source = real_numbers(f, "source f", FunctionError)
    target = real_numbers(g, "target g", FunctionError)
    if source.shape != target.shape:
        raise FunctionError(
            f"source and target have shapes {source.shape} and {target.shape}; expected them alike"
        )
    if not (np.isfinite(source).all() and np.isfinite(target).all()):
        raise FunctionError("source or target has values that are not finite; expected finite ones")
    share = float(t) / float(tau)
    return (1 - share) * source + share * target
