"""Whether a result still belongs to what the document says."""

from __future__ import annotations

import numpy as np

import abfm
from abfm.types import FloatArray
from abfm_viewer.computing.memo import Memo
from abfm_viewer.document.document import SIDES, Document, Function
from abfm_viewer.session.functions import DocumentFunctions


class Outdated:
    """Compares them when one of them changed, and remembers the answer for the frames between."""

    def __init__(self, functions: DocumentFunctions) -> None:
        self._functions = functions
        self._now = Memo[bool]()
        self._result: abfm.Match | None = None
        self._answer = False

    def now(self, document: Document) -> bool:
        """Tell whether the result was found for another problem; False without a result.

        While new values are being computed, the answer is the one before.
        """
        result = document.result
        if result is None:
            return False
        values = [self._functions.values(function) for function in document.functions]

        def compare() -> bool:
            is_known = self._functions.problem(document) or all(one is not None for one in values)
            if result is not self._result or is_known:
                self._result, self._answer = result, self._differs(result, document)
            return self._answer

        problem = (document.parameters, document.channels, document.mask)
        return self._now.get((result, problem, *values), compare)

    def _differs(self, result: abfm.Match, document: Document) -> bool:
        """Return whether it was found for other parameters or functions, as far as known."""
        channels = document.channels
        if result.parameters != document.parameters or len(channels) != result.source.shape[1]:
            return True
        if [channel.weight for channel in channels] != result.weights.tolist():
            return True
        if (document.mask == "") != (result.mask is None):
            return True
        functions = [document.function(side, channel) for side in SIDES for channel in channels]
        pairs = [*zip(functions, [*result.source.T, *result.target.T], strict=True)]
        if result.mask is not None:
            pairs.append((document.mask_function, result.mask))
        return any(self._differs_from(function, then) for function, then in pairs)

    def _differs_from(self, function: Function, then: FloatArray) -> bool:
        values = self._functions.values(function)
        is_changed = values is not None and not np.array_equal(values, then)
        return is_changed or self._functions.error(function) != ""
