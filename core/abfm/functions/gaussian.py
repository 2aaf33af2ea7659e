"""Gaussian bumps."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from abfm.calculus.geodesics import geodesic_distance
from abfm.functions.family import NUMBER, POSITIVE, Slider, choice, parameter
from abfm.functions.points import AroundPoints
from abfm.mesh import TriangleMesh
from abfm.types import FloatArray, IntArray


@dataclass(frozen=True, kw_only=True)
class Gaussian(AroundPoints):
    """Gaussian bump ``height exp(-d^2 / (2 width^2))`` of the distance d to a vertex.

    d is a length divided by the square root of the surface's area, so a width means the same on
    every mesh. It is geodesic (:func:`~abfm.functions.geodesic.geodesic_distance`) or the
    straight-line distance through space.
    """

    family: ClassVar[str] = "gaussian"
    example: ClassVar[str] = "gaussian:vertex={vertex},width=0.1"
    width: float = parameter(
        POSITIVE,
        "standard deviation",
        unit="fraction of sqrt(area)",
        default=0.1,
        slider=Slider(0.01, 1, log=True),
    )
    height: float = parameter(NUMBER, "value at the centre", default=1.0, slider=Slider(-2, 2))
    metric: str = parameter(
        choice("geodesic", "euclidean"), "along the surface or through space", default="geodesic"
    )

    def evaluate(self, mesh: TriangleMesh) -> FloatArray:
        distance = geodesic_distance if self.metric == "geodesic" else _straight_distance
        d = distance(mesh, self.sources(mesh)) / mesh.length_scale
        return self.height * np.exp(-0.5 * (d / self.width) ** 2)


def _straight_distance(mesh: TriangleMesh, sources: IntArray) -> FloatArray:
    distances = [
        np.linalg.norm(mesh.vertices - mesh.vertices[source], axis=1) for source in sources
    ]
    return np.asarray(np.min(distances, axis=0))
