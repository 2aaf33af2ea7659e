"""Target of the registrations of a round."""

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
    """Functions on the template to which subjects are registered, with a mask."""

    functions: FloatArray  # (C, V), functions of the channels used for registration
    mask: FloatArray  # (V,)

    @classmethod
    def from_partial(cls, mesh: TriangleMesh, functions: FloatArray, mask: FloatArray) -> Target:
        """Return a target with functions (C, V) extended to vertices where they are unknown.

        Its mask is 0 there. Raises ResultError if the functions are unknown everywhere.
        """
        known = np.isfinite(functions).all(axis=0) & (mask > 0)
        if not known.any():
            raise ResultError("the masks of subjects and template do not overlap; enlarge a mask")
        return cls(extend_all(mesh, functions, known), np.where(known, mask, 0))

    def distance(self, before: Target, areas: FloatArray, weights: Sequence[float]) -> float:
        """Return the relative L2 distance to the target ``before``.

        For each channel it is divided by the L2 norm of this target minus its mean. The result is
        the root mean square over channels with ``weights`` (C,). Only areas in both masks count.
        """
        common_areas = np.where((self.mask > 0) & (before.mask > 0), areas, 0)
        pairs = zip(before.functions, self.functions, strict=True)
        squares = [relative_distance(old, new, common_areas) ** 2 for old, new in pairs]
        return math.sqrt(np.average(squares, weights=weights))
