"""Fields that a user gives to start from, as the solver takes them."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from abfm.calculus.vector_fields import to_frame
from abfm.matching.energy.energy import MatchingEnergy, check_fields
from abfm.types import FloatArray


def start_fields(energy: MatchingEnergy, start: ArrayLike) -> FloatArray:
    """Fields (F, 3) or (M, F, 3) in the input's units as frame coefficients (N, F, 2).

    Those of M segments are averaged over, or repeated in, the N of the energy's parameters.

    Raises
    ------
    ParameterError
        If they do not fit or are not finite.
    """
    count = max(len(np.asarray(start)), 1) if np.ndim(start) == 3 else 1
    fields = check_fields(start, (count, *energy.shape[1:]), "start") / energy.length_scale
    return to_frame(energy.mesh, np.tensordot(_averages(count, energy.parameters.segments), fields, 1))


def _averages(given: int, wanted: int) -> FloatArray:
    """Weights (wanted, given) that average over even parts of a time what is constant on other even parts."""
    begins, others = np.arange(wanted)[:, None] * given, np.arange(given) * wanted
    overlaps = np.minimum(begins + given, others + wanted) - np.maximum(begins, others)
    weights: FloatArray = np.maximum(overlaps, 0) / given
    return weights
