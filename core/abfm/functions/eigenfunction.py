"""Eigenfunctions of the Laplace-Beltrami operator."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from abfm.calculus.eigenbasis import eigenbasis
from abfm.functions.family import INDEX, Family, Slider, parameter
from abfm.mesh import TriangleMesh
from abfm.types import FloatArray


@dataclass(frozen=True, kw_only=True)
class Eigenfunction(Family):
    """Eigenfunction of the Laplace-Beltrami operator: 0 is the constant, higher ones oscillate
    faster.

    Scaled to max |f| = 1, sign as in :func:`eigenbasis`; no unit, and the same on a scaled or moved
    mesh. Within an eigenspace of several dimensions (on a sphere, say) which function is returned
    is arbitrary but reproducible.
    """

    family: ClassVar[str] = "eigenfunction"
    positional: ClassVar[str | None] = "index"
    example: ClassVar[str] = "eigenfunction:1"
    index: int = parameter(
        INDEX, "number of the eigenfunction; 0 is the constant", slider=Slider(0, 50)
    )

    def evaluate(self, mesh: TriangleMesh) -> FloatArray:
        if self.index == 0:
            return np.ones(len(mesh.vertices))
        f = eigenbasis(mesh.normalized(), self.index + 1)[1][:, self.index]
        largest: float = np.abs(f).max()
        return f / largest
