"""Functions of where vertices are: coordinates, distances from points, and what is made of them."""

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
    """Return the coordinate x, y or z of every vertex, (V,)."""
    assert axis is not None
    return mesh.vertices[:, "xyz".index(axis)]


@dataclass(frozen=True, kw_only=True)
class Coordinate(Family):
    """Coordinate x, y or z of the vertices, in the mesh's units of length."""

    family = "coordinate"
    positional = "axis"
    example = "coordinate:y"
    axis: str = parameter(_AXIS, "which coordinate")

    def evaluate(self, mesh: TriangleMesh) -> FloatArray:
        return _along(mesh, self.axis)


def _of_point(summary: str) -> Any:
    return parameter(NUMBER, summary, unit="length", default=None, instead_of="vertex")


@dataclass(frozen=True, kw_only=True)
class AroundPoints(Family):
    """A family centred at ``vertex=``, as the file counts, or near ``x=,y=,z=`` in its units."""

    vertex: tuple[int, ...] | None = parameter(
        VERTICES,
        "where it is, counted as in the mesh file; of several, with commas, the nearest counts",
        default=None,
        empty="at x, y, z",
    )
    x: float | None = _of_point("instead of vertex: nearest vertex to this point")
    y: float | None = _of_point("second coordinate of the point")
    z: float | None = _of_point("third coordinate of the point")

    def check(self) -> None:
        given = [value is not None for value in (self.x, self.y, self.z)]
        if self.vertex is None and not all(given):
            raise FunctionError(f"{self.family}: give vertex=, or all of x=, y= and z=")
        if self.vertex is not None and any(given):
            raise FunctionError(f"{self.family}: give either vertex= or x=, y= and z=, not both")

    def sources(self, mesh: TriangleMesh) -> IntArray:
        """Return the indices of the centres among the mesh's vertices, (n,)."""
        if self.vertex is not None:
            return np.array([mesh.local_vertex(index) for index in self.vertex])
        offsets = mesh.vertices - np.array([self.x, self.y, self.z])
        return np.array([np.argmin(np.linalg.norm(offsets, axis=1))])


def _size(summary: str, default: float | None) -> Any:
    unit, slider = "fraction of sqrt(area)", Slider(0.01, 1, log=True)
    return parameter(POSITIVE_REAL, summary, unit=unit, default=default, slider=slider)


@dataclass(frozen=True, kw_only=True)
class Geodesic(AroundPoints):
    """Distance along the surface to a vertex, or the nearest of several, in its units of length.

    It is exact up to 6,000 vertices, and by heat on larger meshes, 1 to 2% off: see
    :func:`abfm.calculus.surface_distance`.
    """

    family = "geodesic"
    example = "geodesic:vertex={vertex}"

    def evaluate(self, mesh: TriangleMesh) -> FloatArray:
        return surface_distance(mesh, self.sources(mesh))


@dataclass(frozen=True, kw_only=True)
class Gaussian(AroundPoints):
    """Gaussian bump ``height exp(-d^2 / (2 width^2))`` of the distance d to a vertex.

    d is a length divided by the square root of the surface's area, so a width means the same on
    every mesh: geodesic (:func:`~abfm.calculus.geodesic_distance`) or straight through space.
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
    """Return the least and the largest value of the coordinate, if they differ."""
    height = _along(mesh, function.axis)
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

    family = "indicator"
    example = "indicator:vertex={vertex},radius=0.2"
    shapes: ClassVar[Mapping[str, Shape]] = {
        "disc": Shape("a geodesic disc", example, ("vertex", "x", "y", "z", "radius")),
        "half-space": Shape(
            "what lies above or below a plane",
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
        given, disc = self._given().keys(), {"vertex", "x", "y", "z", "radius"}
        is_disc, has_bound = bool(given & disc), bool(given & {"above", "below"})
        if is_disc == bool(given - disc):
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
            height = _along(mesh, self.axis)
            lower = -np.inf if self.above is None else self.above
            upper = np.inf if self.below is None else self.below
            inside = (lower < height) & (height < upper)
        return inside.astype(np.float64)
