"""What is drawn over the advected surface: arrows of the field, flow lines, and points that are followed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from abfm.mesh import FloatArray, IntArray, TriangleMesh
from abfm_viewer import material, theme, viewport
from abfm_viewer.arrow_mesh import arrow_mesh
from abfm_viewer.field_quantities import Field
from abfm_viewer.opengl import ps
from abfm_viewer.session import Session
from abfm_viewer.theme import Color

if TYPE_CHECKING:
    from abfm.flow_lines import FlowLine

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
_FAST = 98  # percentile of the speeds shown that gets the view's length
_SLOW, _LONGEST = 0.01, 1.25  # of it: below there is no arrow, and none is longer
_HIGH = 0.012  # as _LIFT, for arrows, which are thicker
_LIFT = 0.004  # of sqrt(area): what lies on a surface is hidden by it where it bends
_THIN, _THICK, _POINT = 0.0025, 0.0035, 0.014  # radii of lines, arrows and points


class Overlays:
    """polyscope's structures besides the surfaces; they are made anew when what they show changes."""

    def __init__(self) -> None:
        self._shown: dict[str, tuple[object, ...]] = {}

    def update(self, session: Session, offsets: dict[str, FloatArray]) -> None:
        """Show what the view and the document ask for."""
        quantities = session.quantities
        view, colors = session.view, theme.palette(session.view.theme)
        home = offsets["advected"]
        place = tuple(home)
        field = quantities.field(session) if view.arrows else None
        if field is None or not field.speed.any():
            self._remove(_ARROWS)
        elif self._is_new(_ARROWS, (field, view.arrow_length, view.arrow_density, view.theme, place)):
            _draw_arrows(field, view.arrow_length, view.arrow_density, home, colors.ink)
        lines = quantities.lines(session)
        if not lines:
            self._remove(_LINES)
        elif self._is_new(_LINES, (tuple(lines), view.theme, place)):
            _draw_curves(_LINES, session.mesh, lines, home, colors.marker)
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
            _draw_curves(_PATHS, mesh, paths, home, color)
        now = np.array([path.at(session.shown.time) for path in paths])
        if self._is_new(_NOW, (tuple(paths), session.shown.time, view.theme, tuple(home))):
            _draw_points(_NOW, now + home, color)
        start = offsets.get("source")
        if start is None:
            self._remove(_START)
        elif self._is_new(_START, (tuple(paths), view.theme, tuple(start))):
            _draw_points(_START, np.array([path.positions[0] for path in paths]) + start, color)

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


def evenly_spread(mesh: TriangleMesh, density: float) -> IntArray:
    """Faces spread over the surface: the largest in each cube of a grid whose size falls with the density, 0 to 1."""
    from abfm.operators import face_areas

    centers = mesh.vertices[mesh.faces].mean(axis=1) / mesh.length_scale
    side = 0.12 * (0.15 / 0.12) ** (1 - min(max(density, 0.0), 1.0)) * 10 ** (-0.9 * min(max(density, 0.0), 1.0))
    by_size = np.argsort(-face_areas(mesh), kind="stable")
    cells = np.floor(centers[by_size] / side).astype(np.int64)
    return np.asarray(np.sort(by_size[np.unique(cells, axis=0, return_index=True)[1]]))


def _draw_arrows(field: Field, length: float, density: float, home: FloatArray, color: Color) -> None:
    mesh = field.mesh
    faces = evenly_spread(mesh, density)
    if not field.speed[faces].any():
        faces = np.array([field.speed.argmax()])
    fast = np.percentile(field.speed[faces][field.speed[faces] > 0], _FAST)  # the speed of slivers runs wild
    faces = faces[field.speed[faces] > _SLOW * fast]
    capped = np.minimum(1, _LONGEST * fast / field.speed[faces])
    vectors = (length / fast * capped)[:, None] * field.velocity[faces]
    centers = mesh.vertices[mesh.faces[faces]].mean(axis=1) + _HIGH * mesh.length_scale * _normals(mesh)[faces]
    triangles = arrow_mesh(viewport.units.drawn(centers + home), vectors, _THICK)
    arrows = ps.register_surface_mesh(_ARROWS, *triangles, smooth_shade=False, material=material.NAME, color=color[:3])
    arrows.reset_transform()  # polyscope remembers that of earlier structures of this name; likewise below


def _draw_curves(name: str, mesh: TriangleMesh, lines: list[FlowLine], home: FloatArray, color: Color) -> None:
    nodes = np.concatenate([line.positions + _LIFT * mesh.length_scale * _normals(mesh)[line.faces] for line in lines])
    counts = np.cumsum([len(line.positions) for line in lines])
    edges = np.stack([np.arange(len(nodes) - 1), np.arange(1, len(nodes))], axis=1)
    edges = edges[~np.isin(edges[:, 1], counts)]
    places = viewport.units.drawn(nodes + home)
    network = ps.register_curve_network(name, places, edges, color=color[:3], material=material.NAME)
    network.reset_transform()
    network.set_radius(_THIN, relative=False)


def _draw_points(name: str, positions: FloatArray, color: Color) -> None:
    cloud = ps.register_point_cloud(name, viewport.units.drawn(positions), color=color[:3], material=material.NAME)
    cloud.reset_transform()
    cloud.set_radius(_POINT, relative=False)


def _normals(mesh: TriangleMesh) -> FloatArray:
    from abfm.operators import face_normals

    return face_normals(mesh)
