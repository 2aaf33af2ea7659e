"""Indicator functions: 1 inside, 0 outside."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from abfm.calculus.geodesics import geodesic_distance
from abfm.errors import FunctionError
from abfm.functions.coordinate import AXIS, along
from abfm.functions.family import NUMBER, POSITIVE, Shape, Slider, parameter
from abfm.functions.points import AroundPoints
from abfm.mesh import TriangleMesh
from abfm.types import FloatArray


def _extent(function: Indicator, mesh: TriangleMesh) -> Slider | None:
    """Return the least and the largest value of the coordinate, if they differ."""
    assert function.axis is not None
    height = along(mesh, function.axis)
    ends = Slider(float(height.min()), float(height.max()))
    return ends if ends.low < ends.high else None


def _bound(summary: str) -> Any:
    return parameter(NUMBER, summary, unit="length", default=None, slider=_extent, empty="no bound")


@dataclass(frozen=True, kw_only=True)
class Indicator(AroundPoints):
    """Indicator (1 inside, 0 outside) of a geodesic disc, or of a half-space or slab.

    ``indicator:vertex=12,radius=0.2`` is the disc of that radius, a fraction of sqrt(area), its rim
    included; ``indicator:axis=x,above=0.2`` is where x > 0.2 in the file's units, ``below=`` where
    x is less; both make a slab.
    """

    family: ClassVar[str] = "indicator"
    example: ClassVar[str] = "indicator:vertex={vertex},radius=0.2"
    shapes: ClassVar[Mapping[str, Shape]] = {
        "disc": Shape("a geodesic disc", example, ("vertex", "x", "y", "z", "radius")),
        "half-space": Shape(
            "what lies above or below a plane",
            "indicator:axis=y,above={middle}",
            ("axis", "above", "below"),
        ),
    }
    radius: float | None = parameter(
        POSITIVE,
        "radius of the disc",
        unit="fraction of sqrt(area)",
        default=None,
        slider=Slider(0.01, 1, log=True),
    )
    axis: str | None = parameter(AXIS, "coordinate that bounds the half-space", default=None)
    above: float | None = _bound("lower bound of that coordinate")
    below: float | None = _bound("upper bound of that coordinate")

    def check(self) -> None:
        is_disc = self.is_located() or self.radius is not None
        has_bound = self.above is not None or self.below is not None
        is_half_space = self.axis is not None or has_bound
        if is_disc == is_half_space:
            raise FunctionError(
                "indicator: give either a disc (vertex= or x=,y=,z=; radius=) or a half-space "
                "(axis=; above= or below=)"
            )
        if is_disc:
            super().check()
            if self.radius is None:
                raise FunctionError("indicator: a disc needs radius=, as a fraction of sqrt(area)")
        elif self.axis is None or not has_bound:
            raise FunctionError(
                "indicator: a half-space needs axis=x, y or z, and above= or below="
            )

    def evaluate(self, mesh: TriangleMesh) -> FloatArray:
        if self.radius is not None:
            inside = geodesic_distance(mesh, self.sources(mesh)) <= self.radius * mesh.length_scale
        else:
            assert self.axis is not None
            height = along(mesh, self.axis)
            lower = -np.inf if self.above is None else self.above
            upper = np.inf if self.below is None else self.below
            inside = (lower < height) & (height < upper)
        return inside.astype(np.float64)
