"""What is drawn over the advected surface: arrows of the field, flow lines, and points that are followed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from abfm_viewer.appearance import theme
from abfm_viewer.computing.memo import same
from abfm_viewer.scene import marks
from abfm_viewer.scene.opengl import ps
from abfm_viewer.scene.placing import Placed
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
        self._versions: Counter[str] = Counter()

    def update(self, surfaces: tuple[str, ...], viewport: Viewport) -> None:
        """Show what the view and the document ask for on surfaces, of which the advected one is there."""
        session, quantities = self._shown.session, self._shown.quantities
        mesh, view = session.mesh, session.view
        palette, look = theme.palette(view.theme), (view.theme,)
        placed, length, density = viewport.drawn, view.arrow_length, view.arrow_density
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
        if self._is_new(_START, (paths, *look) if paths and "source" in surfaces else None):
            starts = np.array([path.positions[0] for path in paths])
            marks.draw_points(_START, starts, placed, palette.marker, _POINT)

    def structures(self) -> Iterator[Placed]:
        """What is drawn now."""
        for name in self._drawn:
            yield "source" if name == _START else "advected", name, self._versions[name], _STRUCTURES[name][0](name)

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
            _STRUCTURES[name][1](name, error_if_absent=False)
