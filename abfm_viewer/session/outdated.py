"""Whether a result still belongs to what the document says."""

from __future__ import annotations

import numpy as np

import abfm
from abfm_viewer.computing.evaluation import Evaluated
from abfm_viewer.computing.memo import Memo
from abfm_viewer.document.document import SIDES, Document


class Outdated:
    """Compares them when one of them changed, and remembers the answer for the frames between."""

    def __init__(self) -> None:
        self._now = Memo[bool]()
        self._result: abfm.Match | None = None
        self._answer = False

    def now(self, document: Document, specs: tuple[str, ...], found: Evaluated) -> bool:
        """Whether the result was found for another problem; False without a result.

        `found` are the values of all its functions, as far as known: while new ones are being computed, the answer is
        the one before.
        """
        result = document.result
        if result is None:
            return False
        values = [found.values.get(spec) for spec in specs]

        def compare() -> bool:
            if result is not self._result or found.errors or all(value is not None for value in values):
                self._result, self._answer = result, _differs(result, document, found)
            return self._answer

        return self._now.get((result, document.parameters, document.channels, document.mask, *values), compare)


def _differs(result: abfm.Match, document: Document, found: Evaluated) -> bool:
    """Whether a result was found for other parameters or functions, as far as these are known."""
    channels, mask = document.channels, document.mask
    if result.parameters != document.parameters or len(channels) != result.source.shape[1]:
        return True
    if [channel.weight for channel in channels] != result.weights.tolist() or (mask == "") != (result.mask is None):
        return True
    specs = [channel.spec(side) for side in SIDES for channel in channels]
    pairs = [*zip(specs, [*result.source.T, *result.target.T], strict=True)]
    if result.mask is not None:
        pairs.append((mask, result.mask))
    return any(
        spec in found.errors or (spec in found.values and not np.array_equal(found.values[spec], then))
        for spec, then in pairs
    )
