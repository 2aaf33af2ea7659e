"""What is drawn over the advected surface: arrows of the field, flow lines, and points that are followed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from abfm.mesh import TriangleMesh
from abfm.types import FloatArray
from abfm_viewer.appearance import theme
from abfm_viewer.appearance.theme import Color
from abfm_viewer.scene import marks
from abfm_viewer.scene.marks import Drawn
from abfm_viewer.scene.opengl import ps
from abfm_viewer.scene.viewport import Viewport
from abfm_viewer.session.session import Session

if TYPE_CHECKING:
    from abfm.flow.flow_lines import FlowLine

_ARROWS, _LINES, _PATHS, _NOW, _START = (
    "arrows",
    "flow lines",
    "ways of points",
    "followed points",
    "starts of points",
)
_CURVES = (ps.get_curve_network, ps.remove_curve_network)
_CLOUD = (ps.get_point_cloud, ps.remove_point_cloud)
_STRUCTURES: dict[str, tuple[Callable[..., Any], Callable[..., None]]] = {
    _ARROWS: (ps.get_surface_mesh, ps.remove_surface_mesh),
    _LINES: _CURVES,
    _PATHS: _CURVES,
    _NOW: _CLOUD,
    _START: _CLOUD,
}
"""How to get and how to remove each of them."""
_LIFT = 0.004  # of sqrt(area): what lies on a surface is hidden by it where it bends
_THIN, _POINT = 0.0025, 0.014  # radii of lines and points


class Overlays:
    """polyscope's structures besides the surfaces; they are made anew when what they show changes."""

    def __init__(self) -> None:
        self._shown: dict[str, tuple[object, ...]] = {}
        self._viewport: Viewport

    def update(self, session: Session, offsets: dict[str, FloatArray], viewport: Viewport) -> None:
        """Show what the view and the document ask for."""
        self._viewport = viewport
        quantities = session.quantities
        view, colors = session.view, theme.palette(session.view.theme)
        home = offsets["advected"]
        place = tuple(home)
        field = quantities.field(session) if view.arrows else None
        if field is None or not field.speed.any():
            self._remove(_ARROWS)
        elif self._is_new(_ARROWS, (field, view.arrow_length, view.arrow_density, view.theme, place)):
            length, density = view.arrow_length, view.arrow_density
            marks.draw_arrows(_ARROWS, field.mesh, field.velocity, length, density, self._placed(home), colors.ink)
        lines = quantities.lines(session)
        if not lines:
            self._remove(_LINES)
        elif self._is_new(_LINES, (tuple(lines), view.theme, place)):
            _draw_lines(_LINES, session.mesh, lines, self._placed(home), colors.marker)
        self._update_paths(session, quantities.paths(session), offsets)

    def _update_paths(self, session: Session, paths: list[FlowLine], offsets: dict[str, FloatArray]) -> None:
        """The ways of points, and where they are now."""
        if not paths:
            for name in (_PATHS, _NOW, _START):
                self._remove(name)
            return
        mesh, view, home = session.mesh, session.view, offsets["advected"]
        color = theme.palette(view.theme).marker
        if self._is_new(_PATHS, (tuple(paths), view.theme, tuple(home))):
            _draw_lines(_PATHS, mesh, paths, self._placed(home), color)
        now = np.array([path.at(session.shown.time) for path in paths])
        if self._is_new(_NOW, (tuple(paths), session.shown.time, view.theme, tuple(home))):
            marks.draw_points(_NOW, now, self._placed(home), color, _POINT)
        start = offsets.get("source")
        if start is None:
            self._remove(_START)
        elif self._is_new(_START, (tuple(paths), view.theme, tuple(start))):
            starts = np.array([path.positions[0] for path in paths])
            marks.draw_points(_START, starts, self._placed(start), color, _POINT)

    def structures(self) -> Iterator[tuple[str, Any]]:
        """What is drawn now, each with the surface that it belongs to."""
        for name in self._shown:
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
        for name in list(self._shown):
            self._remove(name)

    def _placed(self, home: FloatArray) -> Drawn:
        """Where things go on a surface that was moved."""
        return lambda places: self._viewport.drawn(places + home)

    def _is_new(self, name: str, made_of: tuple[object, ...]) -> bool:
        if self._shown.get(name) == made_of:
            return False
        self._remove(name)
        self._shown[name] = made_of
        return True

    def _remove(self, name: str) -> None:
        if self._shown.pop(name, None) is None:
            return
        _STRUCTURES[name][1](name, error_if_absent=False)


def _draw_lines(name: str, mesh: TriangleMesh, lines: list[FlowLine], drawn: Drawn, color: Color) -> None:
    marks.draw_curves(name, [_lifted(mesh, line) for line in lines], drawn, color, _THIN)


def _lifted(mesh: TriangleMesh, line: FlowLine) -> FloatArray:
    from abfm.calculus.operators import face_normals

    return line.positions + _LIFT * mesh.length_scale * face_normals(mesh)[line.faces]
