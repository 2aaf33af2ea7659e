"""What looks wrong while a match still runs."""

from abfm.matching.solving.schedule import NEARLY
from abfm.matching.terms.functions import FunctionTerm
from abfm.types import FloatArray

VANISHED = 0.2
"""A function has vanished whose deviation from its mean is below this share of the source's and of
the target's.

Of 18 matches of Gaussians those that ended at a mismatch of 1 had a share below 0.01, all others
one above 0.4.
"""
STILL = 0.1
"""A source stood still that changed by less than this share of what it differed from the target.

What moves changes by 0.4 or more within five iterations.
"""
_MOVING = 10  # iterations after which whatever will move has moved


def vanished(functions: FunctionTerm, advected: FloatArray) -> bool:
    """Tell whether the flow squeezed the source to nothing (C, V) though the target is not flat."""
    source, target = functions.source, functions.target
    least = min(functions.deviation(source), functions.deviation(target))
    return functions.deviation(advected) < VANISHED * least


def stood_still(functions: FunctionTerm, advected: FloatArray) -> bool:
    """Tell whether the flow left the source where it was, though the target is elsewhere."""
    apart = functions.norm(functions.source - functions.target)
    return functions.norm(advected - functions.source) < STILL * apart


def early_warning(functions: FunctionTerm, advected: FloatArray, iteration: int) -> str | None:
    """Say what looks wrong while a match runs, in one line without a full stop; None if nothing.

    A source that vanishes may come back in a later stage, but mostly does not.

    Parameters
    ----------
    functions : FunctionTerm
        On the mesh that the match is on now.
    advected : (C, V) array
        Source carried to tau there by the fields so far.
    iteration : int
        Iterations so far; that a source stands still is not told before the tenth.
    """
    if functions.relative_mismatch(advected) <= NEARLY:
        return None
    if vanished(functions, advected):
        return (
            "the source is being squeezed to nothing instead of moved: it may be too far from the "
            "target"
        )
    if iteration >= _MOVING and stood_still(functions, advected):
        return "the source hardly moves: it may be too far from the target, or sigma too large"
    return None
