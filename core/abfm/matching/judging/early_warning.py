"""What looks wrong while a match still runs."""

from abfm.matching.energy.problem import Problem
from abfm.matching.judging.solvability import stood_still, vanished
from abfm.matching.judging.verdict import NEARLY
from abfm.types import FloatArray

_MOVING = 10  # iterations after which whatever will move has moved


def early_warning(problem: Problem, advected: FloatArray, iteration: int) -> str | None:
    """What looks wrong while a match runs, in one line without a full stop; None where nothing does.

    A source that vanishes may come back in a later stage, but mostly does not.

    Parameters
    ----------
    problem : Problem
        On the mesh that the match is on now.
    advected : (C, V) array
        Source carried to tau there by the fields so far.
    iteration : int
        Iterations so far; that a source stands still is not told before the tenth.
    """
    if problem.relative_mismatch(advected) <= NEARLY:
        return None
    if vanished(problem, advected):
        return "the source is being squeezed to nothing instead of moved: it may be too far from the target"
    if iteration >= _MOVING and stood_still(problem, advected):
        return "the source hardly moves: it may be too far from the target, or sigma too large"
    return None
