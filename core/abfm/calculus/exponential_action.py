"""The action of the exponential of a general sparse matrix, by Taylor steps."""

import numpy as np

from abfm.calculus.operators import Matrix
from abfm.errors import AdvectionError
from abfm.numerics import kernels
from abfm.types import FloatArray

_STEP_NORM = 4.0  # a Taylor step of this norm loses under two digits to cancellation
_NORM_LIMIT = 1e5


def exponential_action(matrix: Matrix, x: FloatArray, t: float) -> FloatArray:
    """``exp(t matrix) x`` for a sparse matrix (n, n) and ``x`` (n,), to rounding.

    The result is not finite where the exponential overflows.

    Raises an AdvectionError if ``t matrix`` is not finite or so large that the sum would not end in reasonable time.
    """
    bound = abs(t) * float(np.min([abs(matrix).sum(axis=axis).max() for axis in (0, 1)]))
    if not bound <= _NORM_LIMIT:
        raise AdvectionError(
            f"the exponential of a matrix of norm {bound:.0e} was asked for (at most {_NORM_LIMIT:.0e}): "
            "shorten the time or slow the field"
        )
    steps = max(1, int(np.ceil(bound / _STEP_NORM)))
    for _ in range(steps):
        term = x
        order = 0
        while np.abs(term).max() > 1e-16 * np.abs(x).max():
            order += 1
            term = kernels.product(matrix, term) * (t / steps / order)
            x = x + term
    return x
