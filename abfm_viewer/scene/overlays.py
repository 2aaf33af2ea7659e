"""What is drawn over the surfaces: arrows of the field, flow lines, points and isolines."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np

from abfm.mesh import TriangleMesh
from abfm.types import FloatArray
from abfm_viewer.appearance import theme
from abfm_viewer.computing.background import same
from abfm_viewer.scene import ribbons
from abfm_viewer.scene.opengl import MATERIAL, ps
from abfm_viewer.scene.surfaces import viewport
from abfm_viewer.shown.paint import Paint
from abfm_viewer.shown.shown import Shown

_ARROWS, _LINES, _PATHS = "arrows", "flow lines", "ways of points"
_ISOLINES = "isolines of "  # and the surface's name
_NOW, _START = _POINTS = "followed points", "starts of points"
# half widths of arrows and lines, radii of points
_THICK, _THIN, _ISOLINE, _POINT = 0.0035, 0.0025, 0.0016, 0.014

Rgb = Sequence[float]
Placed = tuple[str, str, object, Any]
"""The surface that a structure belongs to, its own name, a version that changes with it, and
polyscope's handle.
"""


def draw_arrows(
    name: str, mesh: TriangleMesh, velocity: FloatArray, look: tuple[float, float], color: Rgb
) -> None:
    """Show a field (F, 3) as arrows on a surface; the look is their length and density."""
    courses = ribbons.arrow_courses(mesh, velocity, *look)
    draw_ribbons(name, mesh, ribbons.arrow_ribbons(courses, _THICK), color)


def draw_ribbons(name: str, mesh: TriangleMesh, triangles: ribbons.Triangles, color: Rgb) -> None:
    """Show ribbons on a surface."""
    vertices, faces = triangles
    places = viewport(mesh).drawn(mesh.length_scale * vertices)
    look = {"smooth_shade": False, "material": MATERIAL, "color": color[:3]}
    # none peeps over an edge
    drawn = ps.register_surface_mesh(name, places, faces, back_face_policy="cull", **look)
    # polyscope remembers that of earlier structures of this name; likewise below
    drawn.reset_transform()


def draw_points(
    name: str, mesh: TriangleMesh, positions: FloatArray, color: Rgb, radius: float
) -> None:
    """Show points (P, 3) of a surface as balls."""
    places = viewport(mesh).drawn(positions)
    cloud = ps.register_point_cloud(name, places, color=color[:3], material=MATERIAL)
    cloud.reset_transform()
    cloud.set_radius(radius, relative=False)


class Overlays:
    """polyscope's structures besides the surfaces, made anew when what they show changes."""

    def __init__(self, shown: Shown) -> None:
        self._shown = shown
        self._drawn: dict[str, tuple[object, ...]] = {}
        self._versions: Counter[str] = Counter()

    def update(
        self, meshes: Mapping[str, TriangleMesh], paints: Mapping[str, Paint], of_flow: bool
    ) -> None:
        """Show what is asked for on surfaces by name; of the flow only if so told."""
        for name, mesh in meshes.items():
            self._draw_isolines(name, mesh, paints.get(name))
        if "advected" in meshes:
            self._draw_of_flow(meshes["advected"], of_flow, "source" in meshes)

    def _draw_isolines(self, surface: str, mesh: TriangleMesh, paint: Paint | None) -> None:
        """Show equal values, but not the range's ends and middle, where it may be constant."""
        view, name = self._shown.session.view, _ISOLINES + surface
        colors = paint.colors if paint and paint.kind == "vertex values" else None
        if not view.isolines or surface == "error" or paint is None or colors is None:
            self._remove(name)
        elif self._is_new(name, (paint, view.isoline_count, view.theme)):
            shares = (np.arange(view.isoline_count) + 0.5) / view.isoline_count
            levels = colors.low + (colors.high - colors.low) * shares
            values = np.asarray(paint.values, dtype=np.float64)
            ink = theme.linear(theme.palette(view.theme).ink)
            lines = ribbons.isoline_ribbons(mesh, values, levels, _ISOLINE)
            draw_ribbons(name, mesh, lines, ink)

    def _draw_of_flow(self, mesh: TriangleMesh, of_flow: bool, has_source: bool) -> None:
        """Show arrows, flow lines, and points that are followed."""
        quantities, view = self._shown.quantities, self._shown.session.view
        colors, look = theme.palette(view.theme), (view.arrow_length, view.arrow_density)
        field = quantities.field() if view.arrows and of_flow else None
        if field is None or not field.speed.any():
            self._remove(_ARROWS)
        elif self._is_new(_ARROWS, (field, *look, view.theme)):
            draw_arrows(_ARROWS, mesh, field.velocity, look, theme.linear(colors.ink))
        marker = theme.linear(colors.marker)
        paths = tuple(quantities.paths()) if of_flow else ()
        for name, curves in (
            (_LINES, tuple(quantities.lines()) if of_flow else ()),
            (_PATHS, paths),
        ):
            if self._is_new(name, (curves, view.theme) if curves else None):
                courses = [ribbons.course_of(mesh, line) for line in curves if len(line.times) > 1]
                draw_ribbons(name, mesh, ribbons.line_ribbons(courses, _THIN), marker)
        time = self._shown.flow.time
        if self._is_new(_NOW, (paths, time, view.theme) if paths else None):
            places = np.array([path.at(time) for path in paths])
            draw_points(_NOW, mesh, places, marker, _POINT)
        if self._is_new(_START, (paths, view.theme) if paths and has_source else None):
            places = np.array([path.positions[0] for path in paths])
            draw_points(_START, mesh, places, marker, _POINT)

    def structures(self) -> Iterator[Placed]:
        """List what is drawn now."""
        for name in self._drawn:
            surface = "source" if name == _START else "advected"
            surface = name.removeprefix(_ISOLINES) if name.startswith(_ISOLINES) else surface
            get = ps.get_point_cloud if name in _POINTS else ps.get_surface_mesh
            yield surface, name, self._versions[name], get(name)

    @contextmanager
    def hidden(self) -> Iterator[None]:
        """Nothing of it is in the way of a pick in the block."""
        structures = [structure for *_, structure in self.structures() if structure.is_enabled()]
        for structure in structures:
            structure.set_enabled(False)
        try:
            yield
        finally:
            for structure in structures:
                structure.set_enabled(True)

    def clear(self) -> None:
        """Forget what was drawn: polyscope's structures were removed."""
        for name in list(self._drawn):
            self._remove(name)

    def _is_new(self, name: str, made_of: tuple[object, ...] | None) -> bool:
        """Return whether a structure is to be drawn anew, and remove what is outdated."""
        if made_of is not None and same(self._drawn.get(name), made_of):
            return False
        self._remove(name)
        if made_of is not None:
            self._drawn[name] = made_of
            self._versions[name] += 1
        return made_of is not None

    def _remove(self, name: str) -> None:
        if self._drawn.pop(name, None) is not None:
            remove = ps.remove_point_cloud if name in _POINTS else ps.remove_surface_mesh
            remove(name, error_if_absent=False)
