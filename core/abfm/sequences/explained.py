"""How much of what changes a motion explains, beyond noise."""

from abfm.matching.terms.functions import FunctionTerm
from abfm.sequences.noise import noise_floor
from abfm.types import FloatArray

OFTEN = 1.3
"""Times what noise leaves, within which nothing but noise is left."""
# of what differed at first, or would if all were squeezed away: more is left where motion
# explains little
_EXPLAINED = 0.6
_ROUNDED = 1e-9  # a mismatch that is rounding, as of constants


def explains_little(functions: FunctionTerm, levels: FloatArray, left: float) -> bool:
    """Tell whether a field that leaves such a mismatch explains little of what changes that is no
    noise of levels (C, V).
    """
    first = functions.relative_mismatch(functions.source)
    explained = _EXPLAINED * min(first, _left_by_none(functions))
    return left > max(OFTEN * noise_floor(functions, levels), explained, _ROUNDED)


def _left_by_none(functions: FunctionTerm) -> float:
    """Return the mismatch of a constant, the mean of the target: what differs of a bump from one
    that is elsewhere is more, and falls to this where the flow does no more than make it small.
    """
    size = functions.norm(functions.target)
    if size == 0:
        return float("inf")
    relative = functions.relative_size(functions.target)
    return relative * functions.deviation(functions.target) / size
