"""What is drawn over the advected surface: arrows of the field, flow lines, and points that are followed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from abfm.types import FloatArray
from abfm_viewer.appearance import theme
from abfm_viewer.computing.memo import same
from abfm_viewer.scene import marks
from abfm_viewer.scene.marks import Drawn
from abfm_viewer.scene.opengl import ps
from abfm_viewer.scene.ribbons import course_of
from abfm_viewer.scene.viewport import Viewport
from abfm_viewer.shown.shown import Shown

_ARROWS, _LINES, _PATHS = "arrows", "flow lines", "ways of points"
_NOW, _START = "followed points", "starts of points"
_MESH = (ps.get_surface_mesh, ps.remove_surface_mesh)
_CLOUD = (ps.get_point_cloud, ps.remove_point_cloud)
_STRUCTURES: dict[str, tuple[Callable[..., Any], Callable[..., None]]] = {  # how to get and how to remove each
    _ARROWS: _MESH,
    _LINES: _MESH,
    _PATHS: _MESH,
    _NOW: _CLOUD,
    _START: _CLOUD,
}
_THIN, _POINT = 0.0025, 0.014  # half widths of lines, radii of points


class Overlays:
    """polyscope's structures besides the surfaces; they are made anew when what they show changes."""

    def __init__(self, shown: Shown) -> None:
        self._shown = shown
        self._drawn: dict[str, tuple[object, ...]] = {}

    def update(self, offsets: dict[str, FloatArray], viewport: Viewport) -> None:
        """Show what the view and the document ask for."""
        session, quantities = self._shown.session, self._shown.quantities
        mesh, view, home, start = session.mesh, session.view, offsets["advected"], offsets.get("source")
        palette, look = theme.palette(view.theme), (view.theme, *home)
        placed, length, density = _placed(viewport, home), view.arrow_length, view.arrow_density
        field = quantities.field() if view.arrows else None
        if self._is_new(_ARROWS, (field, length, density, *look) if field and field.speed.any() else None):
            assert field is not None
            marks.draw_arrows(_ARROWS, mesh, field.velocity, length, density, placed, palette.ink)
        lines, paths, time = tuple(quantities.lines()), tuple(quantities.paths()), self._shown.flow.time
        for name, curves in ((_LINES, lines), (_PATHS, paths)):
            if self._is_new(name, (curves, *look) if curves else None):
                courses = [course_of(mesh, line) for line in curves if len(line.times) > 1]
                marks.draw_lines(name, mesh, courses, placed, palette.marker, _THIN)
        if self._is_new(_NOW, (paths, time, *look) if paths else None):
            marks.draw_points(_NOW, np.array([path.at(time) for path in paths]), placed, palette.marker, _POINT)
        if self._is_new(_START, (paths, view.theme, *start) if paths and start is not None else None):
            assert start is not None
            starts = np.array([path.positions[0] for path in paths])
            marks.draw_points(_START, starts, _placed(viewport, start), palette.marker, _POINT)

    def structures(self) -> Iterator[tuple[str, Any]]:
        """What is drawn now, each with the surface that it belongs to."""
        for name in self._drawn:
            yield "source" if name == _START else "advected", _STRUCTURES[name][0](name)

    @contextmanager
    def hidden(self) -> Iterator[None]:
        """Nothing of it is in the way of a pick in the block."""
        structures = [structure for _, structure in self.structures()]
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
        return made_of is not None

    def _remove(self, name: str) -> None:
        if self._drawn.pop(name, None) is not None:
            _STRUCTURES[name][1](name, error_if_absent=False)


def _placed(viewport: Viewport, home: FloatArray) -> Drawn:
    """Where things go on a surface that was moved."""
    return lambda places: viewport.drawn(places + home)
