"""What an interval came to, held against what its noise alone would leave."""

from dataclasses import replace

import numpy as np

from abfm.matching.judging import verdict as verdicts
from abfm.matching.judging.verdict import Outcome, Verdict
from abfm.matching.problem import Problem
from abfm.matching.solvability import range_bound
from abfm.matching.solving.course import NEARLY
from abfm.matching.solving.record import StopReason
from abfm.matching.terms.functions import FunctionTerm
from abfm.sequences.frames import Frames
from abfm.sequences.noise import flat, noise
from abfm.sequences.solve import Said
from abfm.types import FloatArray

_OFTEN = 1.3  # times what noise leaves, within which nothing but noise is left
# of what differed at first, or would if all were squeezed away: more is left where motion
# explains little
_EXPLAINED = 0.6
CONFIRMED = ("matched", "nearly", "registered")
"""Kinds of verdicts by which flow lines confirm an interval."""


def noise_levels(frames: Frames) -> FloatArray:
    """Return the standard deviation of independent noise of each channel at each vertex, (C, V):
    one for all that are compared, and 0 where no frame has any, as activity below a threshold.
    """
    mesh, rows = frames.mesh, [np.ascontiguousarray(frame.T) for frame in frames.values]
    noisy = ~np.logical_and.reduce([flat(mesh, row) for row in rows])  # (C, V)
    if frames.mask is not None:
        noisy &= frames.mask > 0
    levels = np.zeros(noisy.shape)
    for channel, seen in enumerate(noisy):
        if seen.any():
            usual = np.array([noise(mesh, row[channel], seen) for row in rows])
            levels[channel, seen] = np.sqrt(np.median(usual**2))
    return levels


def noise_floor(functions: FunctionTerm, levels: FloatArray) -> float:
    """Return what noise of levels (C, V) leaves between two frames, at most, as a mismatch: the
    root of 2, as both have it.
    """
    return float(np.sqrt(2) * functions.relative_size(levels))


def verdict_of(problem: Problem, said: Said, levels: FloatArray, found: bool) -> Verdict:
    """Return what an interval came to: as of any match, but that nothing more is asked of it than
    its noise, of levels (C, V), allows.
    """
    functions = problem.functions
    if not found:
        return Verdict("not reached", "it was not solved: cancelled before", "solve it again")
    outcome = Outcome(
        said.advected, said.mismatch, StopReason.NO_PROGRESS, said.verified_mismatch, said.folded
    )
    told = verdicts.advice(functions, outcome, problem.parameters)
    left = verdicts.confirmed_mismatch(said.mismatch, said.verified_mismatch)
    often = _OFTEN * noise_floor(functions, levels)
    change = told.reason.partition(": ")[0]
    if left <= often and told.kind not in CONFIRMED:
        told = Verdict("registered", f"{change}: no more is left than noise leaves", "")
    first = functions.relative_mismatch(functions.source)
    explained = _EXPLAINED * min(first, _left_by_none(functions))
    if told.kind == "registered" and left > max(often, explained):
        return Verdict("not reached", f"{change}: most of what changes is no motion", "")
    if told.kind in CONFIRMED and _loses_values(functions, levels):
        return Verdict("not reached", f"{change}: the target lacks values of the source", "")
    return told if told.kind in CONFIRMED else replace(told, advice="", remedies=())


def _left_by_none(functions: FunctionTerm) -> float:
    """Return the mismatch of a constant, the mean of the target: what differs of a bump from one
    that is elsewhere is more, and falls to this where the flow does no more than make it small.
    """
    size = functions.norm(functions.target)
    if size == 0:
        return float("inf")
    relative = functions.relative_size(functions.target)
    return relative * functions.deviation(functions.target) / size


def _loses_values(functions: FunctionTerm, levels: FloatArray) -> bool:
    """Tell whether the film run backwards would be impossible, by more than noise of levels (C, V):
    forwards, what vanishes can be squeezed to little, but no flow takes its values away.
    """
    back = FunctionTerm(
        functions.mesh,
        functions.target.T,
        functions.source.T,
        functions.mask,
        functions.weights,
    )
    return range_bound(back) > max(NEARLY, _OFTEN * noise_floor(back, levels))
