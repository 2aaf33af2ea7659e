"""What an interval came to, held against what its noise alone would leave."""

from dataclasses import replace

import numpy as np

from abfm.matching.judging import verdict as verdicts
from abfm.matching.judging.verdict import Outcome, Verdict
from abfm.matching.problem import Problem
from abfm.matching.solving.record import StopReason
from abfm.parameters import Parameters
from abfm.sequences.frames import Frames
from abfm.sequences.noise import noise
from abfm.sequences.solve import OFTEN, Said

_EXPLAINED = 0.6  # of what differed at first: where more is left, motion explains little
CONFIRMED = ("matched", "nearly", "registered")
"""Kinds of verdicts by which flow lines confirm an interval."""


def noise_floor(frames: Frames) -> float:
    """Return what independent noise on vertices leaves between two frames, at most, as a mismatch:
    the root of 2, as both have it.
    """
    problem = frames.problem(0, Parameters())
    seen = slice(None) if frames.mask is None else frames.mask > 0
    usual = np.array([noise(frames.mesh, frame.T, seen) for frame in frames.values])  # (T, C)
    level = np.sqrt(np.median(usual**2, axis=0))
    even = np.repeat(level[:, None], len(frames.mesh.vertices), axis=1)
    sizes = [problem.functions.norm(np.ascontiguousarray(frame.T)) for frame in frames.values]
    whole = float(np.sqrt(np.mean(np.square(sizes))))
    return float(np.sqrt(2) * problem.functions.norm(even) / whole) if whole > 0 else 0.0


def verdict_of(problem: Problem, said: Said, floor: float, found: bool) -> Verdict:
    """Return what an interval came to: as of any match, but that nothing more is asked of it than
    its noise allows.
    """
    functions = problem.functions
    if not found:
        return Verdict("not reached", "it was not solved: cancelled before", "solve it again")
    outcome = Outcome(
        said.advected, said.mismatch, StopReason.NO_PROGRESS, said.verified_mismatch, said.folded
    )
    told = verdicts.advice(functions, outcome, problem.parameters)
    left = verdicts.confirmed_mismatch(said.mismatch, said.verified_mismatch)
    first = functions.relative_mismatch(functions.source)
    change = told.reason.partition(": ")[0]
    if left <= OFTEN * floor and told.kind not in CONFIRMED:
        return Verdict("registered", f"{change}: no more is left than noise leaves", "")
    if told.kind == "registered" and left > max(OFTEN * floor, _EXPLAINED * first):
        return Verdict("not reached", f"{change}: most of what changes is no motion", "")
    return told if told.kind in CONFIRMED else replace(told, advice="", remedies=())
