"""What no flow can do, and signs of a flow that went astray, told from the functions alone.

A flow makes no new values, and neither splits nor joins peaks: functions that need this have no match, whatever the
parameters. The discrete flow can do both, between vertices, and its own mismatch does not tell.
"""

import numpy as np

from abfm.matching.energy.problem import Problem
from abfm.matching.judging.peaks import Extrema, peaks_apart
from abfm.types import FloatArray, IntArray

VANISHED = 0.2
"""A function has vanished whose deviation from its mean is below this share of the source's and of the target's.

Of 18 matches of Gaussians those that ended at a mismatch of 1 had a share below 0.01, all others one above 0.4.
"""
STILL = 0.1
"""A source stood still that changed by less than this share of what it differed from the target.

What moves changes by 0.4 or more within five iterations.
"""

_EQUAL = 1e-9  # of the largest value: a smaller range is a constant


def vanished(problem: Problem, advected: FloatArray) -> bool:
    """Whether the flow squeezed the source to nothing (C, V), though the target is not flat."""
    least = min(problem.deviation(problem.source), problem.deviation(problem.target))
    return problem.deviation(advected) < VANISHED * least


def squeezed(problem: Problem, advected: FloatArray) -> bool:
    """Whether the flow gained more by shrinking the source, down to half of it or less, than by moving it.

    With ``a`` the advected source (C, V), and all less their means, ``|a - g|^2`` falls by ``|f|^2 - |a|^2``, which is
    shrinking, and by ``2 <a - f, g>``, which is moving to where the target is. A target that is smaller than the source
    may be met by the first.
    """
    size = min(problem.deviation(problem.source), problem.deviation(problem.target)) ** 2
    left = problem.deviation(advected) ** 2
    moved = 2 * problem.covariance(advected - problem.source, problem.target)
    return left < size / 2 and size - left > moved


def stood_still(problem: Problem, advected: FloatArray) -> bool:
    """Whether the flow left the source where it was, though the target is elsewhere."""
    return problem.norm(advected - problem.source) < STILL * problem.norm(problem.source - problem.target)


def distance(problem: Problem) -> float:
    """How far the source has to go, in sqrt(area): between the centres of what it has too much and too little of.

    Straight through space, of the channel where it is most; 0 where nothing is too much, or nothing too little.
    """
    excess = (problem.source - problem.target)[_counting(problem)] * problem.areas
    more, less = np.maximum(excess, 0), np.maximum(-excess, 0)
    known = (more.sum(axis=1) > 0) & (less.sum(axis=1) > 0)
    if not known.any():
        return 0.0
    mesh = problem.mesh
    here, there = (part @ mesh.vertices / part.sum(axis=1)[:, None] for part in (more[known], less[known]))
    return float(np.linalg.norm(here - there, axis=1).max()) / mesh.length_scale


def source_is_constant(problem: Problem) -> bool:
    """Whether every channel that counts has one value all over the surface."""
    return _constant(problem.source[_counting(problem)])


def target_is_constant(problem: Problem) -> bool:
    """Whether every channel that counts has one value wherever the mask is above 0."""
    return _constant(problem.target[_counting(problem)][:, problem.areas > 0])


def worst_channel(problem: Problem) -> int:
    """The channel whose target has most that the source has no values for."""
    return int(np.argmax((within_range(problem) - problem.target) ** 2 @ problem.areas * problem.weights))


def different_peaks(problem: Problem) -> tuple[int, Extrema, Extrema] | None:
    """The first channel that counts whose source and target differ in their peaks or pits, and how many each has.

    None where they do not, or where a mask leaves vertices out, which may hide peaks of the target.
    """
    if (problem.areas > 0).all():
        for channel in _counting(problem):
            found = peaks_apart(problem.mesh, problem.source[channel], problem.target[channel])
            if found is not None:
                return int(channel), *found
    return None


def within_range(problem: Problem) -> FloatArray:
    """The target (C, V) with its values clipped to those that the source has: the best that values alone allow."""
    low, high = problem.source.min(axis=1, keepdims=True), problem.source.max(axis=1, keepdims=True)
    return np.asarray(np.clip(problem.target, low, high))


def range_bound(problem: Problem) -> float:
    """The least relative mismatch that any flow can leave, by the values alone; 0 where the source has all values.

    What a flow carries has only values of the source, so ``|f_tau - g| >= |clip(g, min f, max f) - g|`` everywhere.
    """
    return problem.relative_mismatch(within_range(problem))


def _counting(problem: Problem) -> IntArray:
    """Channels whose weight is not 0."""
    return np.flatnonzero(problem.weights)


def _constant(functions: FloatArray) -> bool:
    return bool((np.ptp(functions, axis=1) <= _EQUAL * np.abs(functions).max(axis=1)).all())
