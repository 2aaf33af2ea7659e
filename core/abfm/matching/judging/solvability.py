"""What no flow can do, and signs of a flow that went astray, told from the functions alone.

A flow makes no new values, and neither splits nor joins peaks: functions that need this have no
match, whatever the parameters. The discrete flow can do both, between vertices, and its own
mismatch does not tell.
"""

import numpy as np

from abfm.matching.judging.peaks import Extrema, peaks_apart
from abfm.matching.solving.range_bound import within_range
from abfm.matching.terms.functions import FunctionTerm
from abfm.types import FloatArray, IntArray

_EQUAL = 1e-9  # of the largest value: a smaller range is a constant


def squeezed(functions: FunctionTerm, advected: FloatArray) -> bool:
    """Tell whether the flow gained more by shrinking the source, down to half of it or less, than
    by moving it.

    With ``a`` the advected source (C, V), and all less their means, ``|a - g|^2`` falls by
    ``|f|^2 - |a|^2``, which is shrinking, and by ``2 <a - f, g>``, which is moving to where the
    target is. A target that is smaller than the source may be met by the first.
    """
    size = min(functions.deviation(functions.source), functions.deviation(functions.target)) ** 2
    left = functions.deviation(advected) ** 2
    moved = 2 * functions.covariance(advected - functions.source, functions.target)
    return left < size / 2 and size - left > moved


def distance(functions: FunctionTerm) -> float:
    """Return how far the source has to go, in sqrt(area): between the centres of what it has too
    much and too little of.

    Straight through space, of the channel where it is most; 0 where nothing is too much, or nothing
    too little.
    """
    excess = (functions.source - functions.target)[_counting(functions)] * functions.areas
    more, less = np.maximum(excess, 0), np.maximum(-excess, 0)
    known = (more.sum(axis=1) > 0) & (less.sum(axis=1) > 0)
    if not known.any():
        return 0.0
    mesh = functions.mesh
    here, there = (
        part @ mesh.vertices / part.sum(axis=1)[:, None] for part in (more[known], less[known])
    )
    return float(np.linalg.norm(here - there, axis=1).max()) / mesh.length_scale


def source_is_constant(functions: FunctionTerm) -> bool:
    """Tell whether every channel that counts has one value all over the surface."""
    return _constant(functions.source[_counting(functions)])


def target_is_constant(functions: FunctionTerm) -> bool:
    """Tell whether every channel that counts has one value wherever the mask is above 0."""
    return _constant(functions.target[_counting(functions)][:, functions.areas > 0])


def worst_channel(functions: FunctionTerm) -> int:
    """The channel whose target has most that the source has no values for."""
    return int(
        np.argmax(
            (within_range(functions) - functions.target) ** 2 @ functions.areas * functions.weights
        )
    )


def different_peaks(functions: FunctionTerm) -> tuple[int, Extrema, Extrema] | None:
    """The first channel that counts whose source and target differ in their peaks or pits, and how
    many each has.

    None where they do not, or where a mask leaves vertices out, which may hide peaks of the target.
    """
    if (functions.areas > 0).all():
        for channel in _counting(functions):
            found = peaks_apart(
                functions.mesh, functions.source[channel], functions.target[channel]
            )
            if found is not None:
                return int(channel), *found
    return None


def _counting(functions: FunctionTerm) -> IntArray:
    """Channels whose weight is not 0."""
    return np.flatnonzero(functions.weights)


def _constant(values: FloatArray) -> bool:
    return bool((np.ptp(values, axis=1) <= _EQUAL * np.abs(values).max(axis=1)).all())
