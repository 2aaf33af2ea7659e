"""What subjects are registered to in a round."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from abfm.calculus.channels import extend_all
from abfm.errors import ResultError
from abfm.mesh import TriangleMesh
from abfm.population.statistics import relative_distance
from abfm.types import FloatArray


class Target(NamedTuple):
    """What subjects are registered to: functions on the template, where they are known."""

    functions: FloatArray  # (C, V), of the channels to register by
    mask: FloatArray  # (V,)

    @classmethod
    def filled(cls, mesh: TriangleMesh, functions: FloatArray, mask: FloatArray) -> Target:
        """Return one whose functions (C, V) are filled in from around where they are unknown."""
        known = np.isfinite(functions).all(axis=0) & (mask > 0)
        if not known.any():
            raise ResultError("the masks of subjects and template have nothing in common")
        return cls(extend_all(mesh, functions, known), np.where(known, mask, 0))

    def distance(self, before: Target, areas: FloatArray, weights: Sequence[float]) -> float:
        """Return how far it is from another one, over its deviation: of channels the root mean
        square, by their weights (C,).
        """
        seen = np.where((self.mask > 0) & (before.mask > 0), areas, 0)
        pairs = zip(before.functions, self.functions, strict=True)
        squares = [relative_distance(old, new, seen) ** 2 for old, new in pairs]
        return math.sqrt(np.average(squares, weights=weights))
