"""How much of what changes a motion explains, beyond noise."""

from abfm.matching.terms.functions import FunctionTerm
from abfm.sequences.noise import noise_floor
from abfm.types import FloatArray

OFTEN = 1.3
"""Times what noise leaves, within which nothing but noise is left."""
# of what differed at first, or would if all were squeezed away: more is left where motion
# explains little
_EXPLAINED = 0.6
_ROUNDED = 1e-9  # a residual that is rounding, as of constants
_RESIDUAL_OF_MEAN = 1.0
"""Residual of a constant, the mean of the target: that of a bump in the wrong place is larger, and
falls to this if the flow only flattens it."""


def explains_little(functions: FunctionTerm, levels: FloatArray, left: float) -> bool:
    """Tell whether a field that leaves such a residual explains little of what changes that is no
    noise of levels (C, V).
    """
    first = functions.residual(functions.source)
    explained = _EXPLAINED * min(first, _RESIDUAL_OF_MEAN)
    return left > max(OFTEN * noise_floor(functions, levels), explained, _ROUNDED)
