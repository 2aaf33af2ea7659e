"""Functions of positions: coordinates, distances, Gaussians and indicators."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from abfm.calculus.geodesics import geodesic_distance, surface_distance
from abfm.errors import FunctionError
from abfm.functions.family import (
    NUMBER,
    POSITIVE_REAL,
    VERTICES,
    Family,
    Shape,
    Slider,
    choice,
    parameter,
)
from abfm.mesh import TriangleMesh
from abfm.types import FloatArray, IntArray

_AXIS = choice("x", "y", "z")


def _along(mesh: TriangleMesh, axis: str | None) -> FloatArray:
    assert axis is not None
    return mesh.vertices[:, "xyz".index(axis)]


@dataclass(frozen=True, kw_only=True)
class Coordinate(Family):
    """Coordinate x, y or z of the vertices, in the unit of length of the mesh."""

    family = "coordinate"
    positional = "axis"
    example = "coordinate:y"
    axis: str = parameter(_AXIS, "coordinate")

    def evaluate(self, mesh: TriangleMesh) -> FloatArray:
        return _along(mesh, self.axis)


def _of_point(summary: str) -> Any:
    return parameter(NUMBER, summary, unit="length", default=None, instead_of="vertex")


@dataclass(frozen=True, kw_only=True)
class AroundPoints(Family):
    """Base class of families with a centre.

    The centre is ``vertex=``, numbered as in the file, or the vertex nearest to ``x=,y=,z=``.
    """

    vertex: tuple[int, ...] | None = parameter(
        VERTICES,
        "centre, numbered as in the mesh file; several, separated by commas, for the nearest one",
        default=None,
        empty="at x, y, z",
    )
    x: float | None = _of_point("instead of vertex: point, replaced by the nearest vertex")
    y: float | None = _of_point("second coordinate of the point")
    z: float | None = _of_point("third coordinate of the point")

    def check(self) -> None:
        has_value = [value is not None for value in (self.x, self.y, self.z)]
        if self.vertex is None and not all(has_value):
            raise FunctionError(
                f"{self.family}: the centre is missing; expected vertex=, or all of x=, y= and z="
            )
        if self.vertex is not None and any(has_value):
            raise FunctionError(
                f"{self.family}: there are two centres; expected either vertex= or x=, y= and z="
            )

    def sources(self, mesh: TriangleMesh) -> IntArray:
        if self.vertex is not None:
            return np.array([mesh.local_vertex(index) for index in self.vertex])
        offsets = mesh.vertices - np.array([self.x, self.y, self.z])
        return np.array([np.argmin(np.linalg.norm(offsets, axis=1))])


def _size(summary: str, default: float | None) -> Any:
    unit, slider = "fraction of sqrt(area)", Slider(0.01, 1, log=True)
    return parameter(POSITIVE_REAL, summary, unit=unit, default=default, slider=slider)


@dataclass(frozen=True, kw_only=True)
class Geodesic(AroundPoints):
    """Distance along the surface to a vertex, or to the nearest of several, in units of length.

    It is exact on meshes of up to 6,000 vertices. On larger meshes it is computed by the heat
    method, with an error of 1 to 2%: see :func:`abfm.calculus.surface_distance`.
    """

    family = "geodesic"
    example = "geodesic:vertex={vertex}"

    def evaluate(self, mesh: TriangleMesh) -> FloatArray:
        return surface_distance(mesh, self.sources(mesh))


@dataclass(frozen=True, kw_only=True)
class Gaussian(AroundPoints):
    """Gaussian bump ``height exp(-d^2 / (2 width^2))`` of the distance d to a vertex.

    The distance is divided by the square root of the surface area, so that a width has the same
    meaning on every mesh. It is geodesic (:func:`~abfm.calculus.geodesic_distance`) or Euclidean.
    """

    family = "gaussian"
    example = "gaussian:vertex={vertex},width=0.1"
    width: float = _size("standard deviation", 0.1)
    height: float = parameter(NUMBER, "value at the centre", default=1.0, slider=Slider(-2, 2))
    metric: str = parameter(
        choice("geodesic", "euclidean"), "along the surface or through space", default="geodesic"
    )

    def evaluate(self, mesh: TriangleMesh) -> FloatArray:
        x, sources = mesh.vertices, self.sources(mesh)
        if self.metric == "geodesic":
            distance = geodesic_distance(mesh, sources)
        else:
            distance = np.min([np.linalg.norm(x - x[k], axis=1) for k in sources], axis=0)
        d = distance / mesh.length_scale
        return self.height * np.exp(-0.5 * (d / self.width) ** 2)


def _extent(function: Indicator, mesh: TriangleMesh) -> Slider | None:
    """Return the range of the bounded coordinate for a slider; None if the range is empty."""
    height = _along(mesh, function.axis)
    ends = Slider(float(height.min()), float(height.max()))
    return ends if ends.low < ends.high else None


def _bound(summary: str) -> Any:
    return parameter(NUMBER, summary, unit="length", default=None, slider=_extent, empty="no bound")


@dataclass(frozen=True, kw_only=True)
class Indicator(AroundPoints):
    """Indicator (1 inside, 0 outside) of a geodesic disc, or of a half-space or slab.

    ``indicator:vertex=12,radius=0.2`` is a disc, including its boundary; the radius is a fraction
    of sqrt(area). ``indicator:axis=x,above=0.2`` is the half-space x > 0.2, in the unit of the
    file, and ``below=0.2`` is x < 0.2. Both together define a slab.
    """

    family = "indicator"
    example = "indicator:vertex={vertex},radius=0.2"
    shapes: ClassVar[Mapping[str, Shape]] = {
        "disc": Shape("a geodesic disc", example, ("vertex", "x", "y", "z", "radius")),
        "half-space": Shape(
            "the part above or below a plane",
            "indicator:axis=y,above={middle}",
            ("axis", "above", "below"),
        ),
    }
    radius: float | None = _size("radius of the disc", None)
    axis: str | None = parameter(
        _AXIS, "coordinate that bounds the half-space", default=None, empty=""
    )
    above: float | None = _bound("lower bound of that coordinate")
    below: float | None = _bound("upper bound of that coordinate")

    def check(self) -> None:
        changed, disc = self._changed().keys(), {"vertex", "x", "y", "z", "radius"}
        is_disc, has_bound = bool(changed & disc), bool(changed & {"above", "below"})
        if is_disc == bool(changed - disc):
            raise FunctionError(
                "indicator: expected either a disc (vertex= or x=,y=,z=; radius=) or a half-space "
                "(axis=; above= or below=)"
            )
        if is_disc:
            super().check()
            if self.radius is None:
                raise FunctionError(
                    "indicator: the radius of the disc is missing; expected radius=, a fraction "
                    "of sqrt(area)"
                )
        elif self.axis is None or not has_bound:
            raise FunctionError(
                "indicator: the half-space is incomplete; expected axis=x, y or z, and above= or "
                "below="
            )

    def evaluate(self, mesh: TriangleMesh) -> FloatArray:
        if self.radius is not None:
            inside = geodesic_distance(mesh, self.sources(mesh)) <= self.radius * mesh.length_scale
        else:
            height = _along(mesh, self.axis)
            lower = -np.inf if self.above is None else self.above
            upper = np.inf if self.below is None else self.below
            inside = (lower < height) & (height < upper)
        return inside.astype(np.float64)
