"""What the values of source and target leave of a match, whatever the flow."""

import numpy as np

from abfm.matching.terms.functions import FunctionTerm
from abfm.types import FloatArray


def within_range(functions: FunctionTerm) -> FloatArray:
    """Clip the target (C, V) to the values that the source has: the best that they allow."""
    source = functions.source
    low, high = source.min(axis=1, keepdims=True), source.max(axis=1, keepdims=True)
    return np.asarray(np.clip(functions.target, low, high))


def range_bound(functions: FunctionTerm) -> float:
    """Return the least relative mismatch that any flow can leave; 0 if the source has all values.

    What a flow carries has only values of the source, so
    ``|f_tau - g| >= |clip(g, min f, max f) - g|`` everywhere.
    """
    return functions.relative_mismatch(within_range(functions))
