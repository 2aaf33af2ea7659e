"""Result of a round of registrations: outliers, and values of each subject on the template."""

from __future__ import annotations

import tempfile
import weakref
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple

import numpy as np

from abfm.io import writing_in
from abfm.population.on_template import MapFacts
from abfm.population.outliers import OutlierAnalysis
from abfm.types import FloatArray


class RoundResult(NamedTuple):
    """Result of a round of registrations: outliers, and values of N subjects on the template."""

    outliers: OutlierAnalysis
    before: FloatArray  # (N, V, C), values by the initial maps
    masks_before: FloatArray  # (N, V)
    after: FloatArray  # (N, V, C), values after registration
    masks: FloatArray  # (N, V)
    log2_areas: FloatArray  # (N, F), log2 J of faces
    drift: FloatArray  # (F, 3), mean field
    drift_file: str  # path of the file with the mean field
    verdicts: tuple[str, ...]
    digests: tuple[str, ...]
    facts: tuple[MapFacts, ...]


class ArrayStack:
    """Arrays of equal shape, one for each subject, in a temporary file in ``folder``.

    The memory is thus independent of the number of subjects. The file is removed after use.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._shape: tuple[int, ...] = (0,)
        with writing_in(folder), ExitStack() as opened:
            self._file = opened.enter_context(tempfile.TemporaryFile(dir=folder))
            self._close = weakref.finalize(self, opened.pop_all().close)

    def add(self, array: FloatArray) -> None:
        self._shape = (self._shape[0] + 1, *array.shape)
        with writing_in(self._folder):
            self._file.write(np.ascontiguousarray(array, dtype=np.float64).data)

    def array(self) -> FloatArray:
        """Return all arrays as one read-only array, (N, ...); `add` cannot be called again."""
        with writing_in(self._folder):
            self._file.flush()
        found = np.memmap(self._file, np.float64, "r", shape=self._shape)
        self._close()
        return found.view(np.ndarray)
