"""What an interval came to, held against what its noise alone would leave."""

import math
from dataclasses import replace

from abfm.matching.judging import verdict as verdicts
from abfm.matching.judging.verdict import Outcome, Verdict
from abfm.matching.problem import Problem
from abfm.matching.solvability import narrowest, range_bound
from abfm.matching.solving.course import NEARLY
from abfm.matching.solving.record import StopReason
from abfm.matching.terms.functions import FunctionTerm
from abfm.sequences.explained import OFTEN, explains_little
from abfm.sequences.noise import noise_floor
from abfm.sequences.solve import Said
from abfm.types import FloatArray

_NOTHING_BUT_NOISE = 0.85  # of the deviation, which is three quarters of the variance
CONFIRMED = ("matched", "nearly", "registered")
"""Kinds of verdicts by which flow lines confirm an interval."""
_FEW_EDGES = 2.0  # what spans less is hardly carried, and looks like noise
_UNSOLVED = Verdict("not reached", "it was not solved: cancelled before", "solve it again")


def verdict_of(problem: Problem, said: Said, levels: FloatArray, found: bool) -> Verdict:
    """Return what an interval came to: as of any match, but that nothing more is asked of it than
    its noise, of levels (C, V), allows.
    """
    functions = problem.functions
    if not found:
        return _UNSOLVED
    outcome = Outcome(
        said.advected, said.mismatch, StopReason.NO_PROGRESS, said.verified_mismatch, said.folded
    )
    told = verdicts.advice(functions, outcome, problem.parameters)
    left = verdicts.confirmed_mismatch(said.mismatch, said.verified_mismatch)
    change = told.reason.partition(": ")[0]
    if functions.norm(levels) > _NOTHING_BUT_NOISE * functions.function_size:
        why = f"nothing but {_noise(functions)} is there, and no motion can be told"
        return Verdict("not reached", f"{change}: {why}", "")
    if left <= OFTEN * noise_floor(functions, levels) and told.kind not in CONFIRMED:
        why = f"no more is left than {_noise(functions)} leaves"
        told = Verdict("registered", f"{change}: {why}", "")
    if told.kind in CONFIRMED and explains_little(functions, levels, left):
        return Verdict("not reached", f"{change}: {_unexplained(functions, levels, said)}", "")
    if told.kind in CONFIRMED and _loses_values(functions, levels):
        return Verdict("not reached", f"{change}: the target lacks values of the source", "")
    return told if told.kind in CONFIRMED else replace(told, advice="", remedies=())


def _noise(functions: FunctionTerm) -> str:
    """Say what no neighbour knows of a function: noise, but where edges are long, as those of
    needles are, what is bent within one, too.
    """
    is_coarse = narrowest(functions) < _FEW_EDGES
    return "noise, or what is narrower than edges," if is_coarse else "noise"


def _unexplained(functions: FunctionTerm, levels: FloatArray, said: Said) -> str:
    """Say why a field explains little by the worse witness: what changes is no motion only where
    the other one has none either, and the mesh could carry it.
    """
    if not explains_little(functions, levels, said.mismatch):
        return "flow lines leave most of what changes, so the discrete flow is not one here"
    by_lines = said.verified_mismatch
    if not (math.isnan(by_lines) or explains_little(functions, levels, by_lines)):
        return "the discrete flow leaves most of what changes, though flow lines do not"
    if (spans := narrowest(functions)) < _FEW_EDGES:
        why = "most of what changes is no motion that the mesh can carry"
        return f"{why}, as it spans {spans:.2g} edges"
    return "most of what changes is no motion"


def is_unsolved(verdict: Verdict) -> bool:
    """Return whether a run was cancelled before an interval, whose field is 0 for that."""
    return (verdict.kind, verdict.reason) == (_UNSOLVED.kind, _UNSOLVED.reason)


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
    return range_bound(back) > max(NEARLY, OFTEN * noise_floor(back, levels))
