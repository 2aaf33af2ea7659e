"""What is drawn over the surfaces: arrows of the field, flow lines, points and isolines."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np

from abfm.mesh import TriangleMesh
from abfm_viewer.appearance import theme
from abfm_viewer.computing.background import same
from abfm_viewer.scene import marks
from abfm_viewer.scene.opengl import ps
from abfm_viewer.scene.placing import Placed
from abfm_viewer.scene.ribbons import course_of, isoline_ribbons, line_ribbons
from abfm_viewer.shown.paint import Paint
from abfm_viewer.shown.shown import Shown

_ARROWS, _LINES, _PATHS = "arrows", "flow lines", "ways of points"
_ISOLINES = "isolines of "  # and the surface's name
_NOW, _START = "followed points", "starts of points"
_MESH = (ps.get_surface_mesh, ps.remove_surface_mesh)
_CLOUD = (ps.get_point_cloud, ps.remove_point_cloud)
_THIN, _ISOLINE, _POINT = 0.0025, 0.0016, 0.014  # half widths of lines, radii of points


class Overlays:
    """polyscope's structures besides the surfaces, made anew when what they show changes."""

    def __init__(self, shown: Shown) -> None:
        self._shown = shown
        self._drawn: dict[str, tuple[object, ...]] = {}
        self._versions: Counter[str] = Counter()

    def update(
        self, meshes: Mapping[str, TriangleMesh], paints: Mapping[str, Paint], of_flow: bool = True
    ) -> None:
        """Show what the view and the document ask for; of the flow only if so told.

        That is on surfaces with these meshes and paints, by their names.
        """
        for name, mesh in meshes.items():
            self._draw_isolines(name, mesh, paints.get(name))
        if "advected" in meshes:
            self._draw_arrows(meshes["advected"], of_flow)
            self._draw_curves(meshes["advected"], of_flow, "source" in meshes)

    def _draw_isolines(self, surface: str, mesh: TriangleMesh, paint: Paint | None) -> None:
        """Show lines of a function's equal values.

        There are none at the ends of its range nor in the middle, where it is constant.
        """
        view, name = self._shown.session.view, _ISOLINES + surface
        colors = paint.colors if paint and paint.kind == "vertex values" else None
        wanted = view.isolines and colors is not None and surface != "error"
        if not self._is_new(name, (paint, view.isoline_count, view.theme) if wanted else None):
            return
        assert paint is not None
        assert colors is not None
        shares = (np.arange(view.isoline_count) + 0.5) / view.isoline_count
        levels = colors.low + (colors.high - colors.low) * shares
        values = np.asarray(paint.values, dtype=np.float64)
        lines = isoline_ribbons(mesh, values, levels, _ISOLINE)
        marks.draw_ribbons(name, mesh, lines, theme.linear(theme.palette(view.theme).ink))

    def _draw_arrows(self, mesh: TriangleMesh, of_flow: bool) -> None:
        view = self._shown.session.view
        field = self._shown.quantities.field() if view.arrows and of_flow else None
        length, density = view.arrow_length, view.arrow_density
        is_wanted = field is not None and field.speed.any()
        if self._is_new(_ARROWS, (field, length, density, view.theme) if is_wanted else None):
            assert field is not None
            courses = marks.arrow_courses(mesh, field.velocity, length, density)
            ink = theme.linear(theme.palette(view.theme).ink)
            marks.draw_arrows(_ARROWS, mesh, courses, ink)

    def _draw_curves(self, mesh: TriangleMesh, of_flow: bool, has_source: bool) -> None:
        """Show flow lines, and points that are followed."""
        quantities, look = self._shown.quantities, self._shown.session.view.theme
        marker = theme.linear(theme.palette(look).marker)
        lines = tuple(quantities.lines()) if of_flow else ()
        paths = tuple(quantities.paths()) if of_flow else ()
        for name, curves in ((_LINES, lines), (_PATHS, paths)):
            if self._is_new(name, (curves, look) if curves else None):
                courses = [course_of(mesh, line) for line in curves if len(line.times) > 1]
                marks.draw_ribbons(name, mesh, line_ribbons(courses, _THIN), marker)
        time = self._shown.flow.time
        if self._is_new(_NOW, (paths, time, look) if paths else None):
            places = np.array([path.at(time) for path in paths])
            marks.draw_points(_NOW, mesh, places, marker, _POINT)
        if self._is_new(_START, (paths, look) if paths and has_source else None):
            starts = np.array([path.positions[0] for path in paths])
            marks.draw_points(_START, mesh, starts, marker, _POINT)

    def structures(self) -> Iterator[Placed]:
        """List what is drawn now."""
        for name in self._drawn:
            surface = "source" if name == _START else "advected"
            surface = name.removeprefix(_ISOLINES) if name.startswith(_ISOLINES) else surface
            yield surface, name, self._versions[name], _access(name)[0](name)

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
            _access(name)[1](name, error_if_absent=False)


def _access(name: str) -> tuple[Callable[..., Any], Callable[..., None]]:
    """Return how to get a structure, and how to remove it."""
    return _CLOUD if name in (_NOW, _START) else _MESH
