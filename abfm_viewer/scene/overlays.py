"""What is drawn over the advected surface: arrows of the field, flow lines, and points that are followed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np

from abfm_viewer.appearance import theme
from abfm_viewer.computing.memo import same
from abfm_viewer.scene import marks
from abfm_viewer.scene.opengl import ps
from abfm_viewer.scene.placing import Placed
from abfm_viewer.scene.ribbons import course_of, isoline_ribbons
from abfm_viewer.scene.viewport import Viewport
from abfm_viewer.shown.paint import Paint
from abfm_viewer.shown.shown import Shown

_ARROWS, _LINES, _PATHS = "arrows", "flow lines", "ways of points"
_ISOLINES = "isolines of "  # and the surface's name
_NOW, _START = "followed points", "starts of points"
_MESH = (ps.get_surface_mesh, ps.remove_surface_mesh)
_CLOUD = (ps.get_point_cloud, ps.remove_point_cloud)
_THIN, _ISOLINE, _POINT = 0.0025, 0.0016, 0.014  # half widths of lines, radii of points


class Overlays:
    """polyscope's structures besides the surfaces; they are made anew when what they show changes."""

    def __init__(self, shown: Shown) -> None:
        self._shown = shown
        self._drawn: dict[str, tuple[object, ...]] = {}
        self._versions: Counter[str] = Counter()

    def update(
        self, surfaces: tuple[str, ...], viewport: Viewport, paints: Mapping[str, Paint], of_flow: bool = True
    ) -> None:
        """Show what the view and the document ask for, on surfaces with their paints; of the flow only if so told."""
        for surface in surfaces:
            self._draw_isolines(surface, paints.get(surface), viewport)
        if "advected" not in surfaces:
            return
        session, quantities = self._shown.session, self._shown.quantities
        mesh, view = session.mesh, session.view
        palette, look = theme.palette(view.theme), (view.theme,)
        ink, marker = theme.linear(palette.ink), theme.linear(palette.marker)
        placed, length, density = viewport.drawn, view.arrow_length, view.arrow_density
        field = quantities.field() if view.arrows and of_flow else None
        if self._is_new(_ARROWS, (field, length, density, *look) if field and field.speed.any() else None):
            assert field is not None
            marks.draw_arrows(_ARROWS, mesh, field.velocity, length, density, placed, ink)
        lines, paths = (tuple(quantities.lines()), tuple(quantities.paths())) if of_flow else ((), ())
        time = self._shown.flow.time
        for name, curves in ((_LINES, lines), (_PATHS, paths)):
            if self._is_new(name, (curves, *look) if curves else None):
                courses = [course_of(mesh, line) for line in curves if len(line.times) > 1]
                marks.draw_lines(name, mesh, courses, placed, marker, _THIN)
        if self._is_new(_NOW, (paths, time, *look) if paths else None):
            marks.draw_points(_NOW, np.array([path.at(time) for path in paths]), placed, marker, _POINT)
        if self._is_new(_START, (paths, *look) if paths and "source" in surfaces else None):
            starts = np.array([path.positions[0] for path in paths])
            marks.draw_points(_START, starts, placed, marker, _POINT)

    def _draw_isolines(self, surface: str, paint: Paint | None, viewport: Viewport) -> None:
        """Lines of a function's equal values; none at the ends of its range nor in the middle, where it is constant."""
        view, name = self._shown.session.view, _ISOLINES + surface
        wanted = view.isolines and paint is not None and paint.kind == "vertex values" and surface != "error"
        if self._is_new(name, (paint, view.isoline_count, view.theme) if wanted else None):
            assert paint is not None
            assert paint.colors is not None
            mesh, low, high = self._shown.session.mesh, paint.colors.low, paint.colors.high
            levels = low + (high - low) * (np.arange(view.isoline_count) + 0.5) / view.isoline_count
            lines = isoline_ribbons(mesh, np.asarray(paint.values, dtype=np.float64), levels, _ISOLINE)
            marks.draw_ribbons(name, mesh, lines, viewport.drawn, theme.linear(theme.palette(view.theme).ink))

    def structures(self) -> Iterator[Placed]:
        """What is drawn now."""
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
        """Whether a structure is to be drawn anew; what is of something else, or of nothing, is removed."""
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
    """How to get a structure, and how to remove it."""
    return _CLOUD if name in (_NOW, _START) else _MESH
