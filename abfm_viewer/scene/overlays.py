"""Structures drawn over the surfaces: arrows, flow lines, paths, points and isolines."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

import abfm
from abfm.mesh import TriangleMesh, per_mesh
from abfm.pages.sequence_motion import CRITICAL_COLORS
from abfm.types import BoolArray, FloatArray, IntArray
from abfm_viewer.appearance import theme
from abfm_viewer.computing.background import Memo, same
from abfm_viewer.scene.opengl import MATERIAL, draw_transparency, ps
from abfm_viewer.scene.surfaces import viewport
from abfm_viewer.shown.arrows import Arrows
from abfm_viewer.shown.eye import Eye
from abfm_viewer.shown.paint import Paint
from abfm_viewer.shown.quantities import Field
from abfm_viewer.shown.ribbons import Triangles, normals_at, outward, strips, unit
from abfm_viewer.shown.shown import Shown
from abfm_viewer.shown.tracks import KINDS

_ARROWS = "arrows"
_LINES = "flow lines"
_PATHS = "paths of points"
# names of polyscope's quantities of arrows
_INK = "ink"
_OPACITY = "opacity"
_ISOLINES = "isolines of "  # followed by the name of the surface
_TRACKS = {kind: f"tracks of each {kind}" for kind in KINDS}
_POINT_NAMES = {kind: f"each {kind} now" for kind in KINDS}
_POINTS_NOW = "followed points"
_STARTS = "starts of points"
_POINTS = (_POINTS_NOW, _STARTS, *_POINT_NAMES.values())
_LIFT = 0.0025  # height above the curved surface, which would hide a flat strip, in sqrt(area)
# size of an arrowhead on a line, in half widths of the line
_HEAD_WIDTH = 2.6
_HEAD_LENGTH = 7.5
_HEAD_LENGTH_SHARE_MAX = 0.55  # of the longest smooth section of a line
_HEAD_NODES = 4
_TURN_COSINE_MIN = 0.7  # a strip ends at sharper turns
_DISC_CORNERS = 12
_OFF_NORMAL = (0.1, 0.2, 0.3)  # added to a normal, changes its direction
# The following lengths are in sqrt(area).
_HEAD_DISTANCE = 0.16  # between heads of a line
_NODE_DISTANCE = 0.008  # between nodes of a ribbon
_CUBE = 0.15  # side of the grid from which evenly spread faces are chosen
_LINE_HALF_WIDTH = 0.0025
_ISOLINE_HALF_WIDTH = 0.0016
_POINT_RADIUS = 0.014
_TRACK_HALF_WIDTH = 0.005
_CRITICAL_POINT_RADIUS = 0.02

Rgb = Sequence[float]
Meshes = Mapping[str, TriangleMesh]
PlacedStructure = tuple[str, str, Any]
"""The name of the surface below a structure, the structure's name, and polyscope's handle."""


@dataclass(frozen=True, eq=False)
class SurfacePath:
    """A curve on a surface, as a polygonal line."""

    places: FloatArray  # (K, 3), in sqrt(area)
    normals: FloatArray  # (K, 3), unit normals of the surface

    @property
    def lengths(self) -> FloatArray:
        """Distances of the curve's points from its start, measured along the curve, (K,)."""
        steps = np.linalg.norm(np.diff(self.places, axis=0), axis=1)
        return np.concatenate([[0.0], np.cumsum(steps)])

    def at(self, lengths: FloatArray) -> SurfacePath:
        """Return the curve through the points at distances (N,) from the start of this curve."""
        nodes = self.lengths
        places, normals = (
            np.stack([np.interp(lengths, nodes, values[:, x]) for x in range(3)], axis=1)
            for values in (self.places, self.normals)
        )
        return SurfacePath(places, unit(normals))


def path_of_line(mesh: TriangleMesh, line: abfm.flow.FlowLine) -> SurfacePath:
    order = slice(None) if line.times[-1] >= 0 else slice(None, None, -1)
    normals = normals_at(mesh, line.faces, line.barycentric)
    return SurfacePath(line.positions[order] / mesh.length_scale, normals[order])


def path_through(mesh: TriangleMesh, places: FloatArray) -> SurfacePath:
    """Return the curve through points (K, 3) near a surface, with the surface's normals there."""
    return _path_at(mesh, places, abfm.maps.project_onto_surface(mesh, places))


def _path_at(
    mesh: TriangleMesh, places: FloatArray, points: abfm.maps.SurfacePoints
) -> SurfacePath:
    normals = normals_at(mesh, points.faces, points.barycentric)
    return SurfacePath(places / mesh.length_scale, normals)


@per_mesh
def evenly_spread(mesh: TriangleMesh) -> IntArray:
    """Return the indices of evenly spread faces: the largest face in each cube of a grid."""
    centres = mesh.vertices[mesh.faces].mean(axis=1) / mesh.length_scale
    by_size = np.argsort(-abfm.calculus.face_areas(mesh), kind="stable")
    cells = np.floor(centres[by_size] / _CUBE).astype(np.int64)
    return np.sort(by_size[np.unique(cells, axis=0, return_index=True)[1]])


def line_ribbons(paths: Iterable[SurfacePath], half_width: float) -> Triangles:
    """Return a ribbon along each path, rounded at sharp turns, with arrowheads on it."""
    parts: list[Triangles] = []
    shares = np.linspace(0, 1, _HEAD_NODES)
    for path in paths:
        length, ends = float(path.lengths[-1]), _smooth_sections(path)
        for start, end in pairwise(ends):
            nodes = path.at(
                np.linspace(start, end, max(int(np.ceil((end - start) / _NODE_DISTANCE)), 1) + 1)
            )
            half_widths = np.full((1, len(nodes.places)), half_width)
            parts.append(_strips(nodes.places[None], nodes.normals[None], half_widths))
        parts.append(_discs(path.at(ends[1:-1]), half_width))
        head = min(_HEAD_LENGTH * half_width, _HEAD_LENGTH_SHARE_MAX * float(np.diff(ends).max()))
        widest = _HEAD_WIDTH * head / _HEAD_LENGTH
        count = max(round(length / _HEAD_DISTANCE), 1)
        for middle in (np.arange(count) + 0.5) * length / count:
            start = _fitting_start(ends, float(middle) - head / 2, head)
            nodes = path.at(start + head * shares)
            half_widths = widest * (1 - shares)[None]
            parts.append(_strips(nodes.places[None], nodes.normals[None], half_widths))
    return _joined(parts)


def _smooth_sections(path: SurfacePath) -> FloatArray:
    """Return the ends of a path's parts without sharp turns, as distances from its start."""
    lengths = path.lengths
    moved = np.flatnonzero(np.diff(lengths, prepend=-1.0) > 0)
    along = unit(np.diff(path.places[moved], axis=0))
    turns = (along[1:] * along[:-1]).sum(axis=1) < _TURN_COSINE_MIN
    return np.concatenate([[0.0], lengths[moved[1:-1][turns]], lengths[-1:]])


def _fitting_start(ends: FloatArray, start: float, length: float) -> float:
    """Return the distance nearest to ``start`` where an arrowhead of a length avoids sharp turns.

    ``ends`` are the distances of the start of the path, its sharp turns and its end.
    """
    first, last = ends[:-1], ends[1:] - length
    fits = last >= first - 1e-12
    places = np.clip(start, first[fits], np.maximum(last, first)[fits])
    return float(places[np.argmin(np.abs(places - start))])


def _discs(nodes: SurfacePath, radius: float) -> Triangles:
    one = unit(np.cross(nodes.normals, np.roll(nodes.normals, 1, axis=1) + _OFF_NORMAL))
    other = np.cross(nodes.normals, one)
    angles = 2 * np.pi * np.arange(_DISC_CORNERS) / _DISC_CORNERS
    ring = np.cos(angles)[:, None] * one[:, None] + np.sin(angles)[:, None] * other[:, None]
    middles = (nodes.places + _LIFT * nodes.normals)[:, None]
    vertices = np.concatenate([middles, middles + radius * ring], axis=1)
    rim = np.arange(_DISC_CORNERS)
    fan = np.stack([np.zeros_like(rim), 1 + rim, 1 + (rim + 1) % _DISC_CORNERS], axis=1)
    firsts = (1 + _DISC_CORNERS) * np.arange(len(vertices))[:, None, None]
    return vertices.reshape(-1, 3), (firsts + fan).reshape(-1, 3)


def isoline_ribbons(
    mesh: TriangleMesh, values: FloatArray, levels: Sequence[float] | FloatArray, half_width: float
) -> Triangles:
    """Return strips along the level sets of a function (V,); none where it is constant."""
    corners, at_corners = mesh.vertices[mesh.faces] / mesh.length_scale, values[mesh.faces]
    normals = outward(mesh) * abfm.calculus.face_normals(mesh)
    low, high = at_corners.min(axis=1), at_corners.max(axis=1)
    parts: list[Triangles] = []
    for level in levels:
        crossed = np.flatnonzero((low < level) & (level <= high))
        if not crossed.size:
            continue
        f, triangles, rows = at_corners[crossed], corners[crossed], np.arange(len(crossed))
        above = f >= level
        single = np.where(above.sum(axis=1) == 1, above.argmax(axis=1), (~above).argmax(axis=1))
        start, ends = triangles[rows, single], []
        for other in ((single + 1) % 3, (single + 2) % 3):
            share = (level - f[rows, single]) / (f[rows, other] - f[rows, single])
            ends.append(start + share[:, None] * (triangles[rows, other] - start))
        along, normal = unit(ends[1] - ends[0]), normals[crossed]
        side, lift = half_width * np.cross(normal, along), _LIFT * normal
        # longer than the level set, so that there are no gaps between strips
        first, last = ends[0] - half_width / 2 * along, ends[1] + half_width / 2 * along
        around = first - side, last - side, last + side, first + side
        vertices = np.stack([corner + lift for corner in around], axis=1)
        faces = np.array([[0, 1, 2], [0, 2, 3]]) + 4 * rows[:, None, None]
        parts.append((vertices.reshape(-1, 3), faces.reshape(-1, 3)))
    return _joined(parts)


def _strips(places: FloatArray, normals: FloatArray, half_widths: FloatArray) -> Triangles:
    return strips(places + _LIFT * normals, normals, half_widths)


def _joined(parts: list[Triangles]) -> Triangles:
    if not parts:
        return np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64)
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in parts)])
    faces = [part + start for (_, part), start in zip(parts, starts, strict=False)]
    return np.concatenate([vertices for vertices, _ in parts]), np.concatenate(faces)


def draw_arrows(name: str, arrows: Arrows, ink: Rgb, rim: Rgb) -> None:
    """Draw all arrows with rims; call `show_visible_arrows` next to hide the invisible ones."""
    vertices = arrows.vertices.reshape(-1, 3)
    places = viewport(arrows.mesh).drawn(arrows.mesh.length_scale * vertices)
    options = {"smooth_shade": False, "material": MATERIAL}
    drawn = ps.register_surface_mesh(name, places, arrows.faces, **options)
    drawn.reset_transform()
    colors = np.where(arrows.rims[:, None], np.array(rim[:3]), np.array(ink[:3]))
    drawn.add_color_quantity(_INK, colors, defined_on="faces", enabled=True)
    is_transparent = bool((arrows.opacities < 1).any())
    draw_transparency(is_transparent)
    if is_transparent:
        each = len(arrows.faces) // len(arrows.opacities)
        drawn.add_scalar_quantity(_OPACITY, np.repeat(arrows.opacities, each), defined_on="faces")
        drawn.set_transparency_quantity(_OPACITY)


def show_visible_arrows(name: str, arrows: Arrows, eye: Eye, hidden: BoolArray | None) -> None:
    """Show the arrows that are completely visible; ``hidden`` masks the covered ones."""
    vertices = arrows.mesh.length_scale * arrows.seen(eye, hidden)
    ps.get_surface_mesh(name).update_vertex_positions(viewport(arrows.mesh).drawn(vertices))


def draw_ribbons(name: str, mesh: TriangleMesh, triangles: Triangles, color: Rgb) -> None:
    vertices, faces = triangles
    places = viewport(mesh).drawn(mesh.length_scale * vertices)
    options = {"smooth_shade": False, "material": MATERIAL, "color": color[:3]}
    # backs are culled, so that no ribbon is visible beyond an outline
    drawn = ps.register_surface_mesh(name, places, faces, back_face_policy="cull", **options)
    # polyscope would reuse the transform of an earlier structure of the same name
    drawn.reset_transform()


def draw_points(
    name: str, mesh: TriangleMesh, positions: FloatArray, color: Rgb, radius: float
) -> None:
    """Draw points (P, 3) of a surface as balls; their radius is in units of sqrt(area)."""
    places = viewport(mesh).drawn(positions)
    cloud = ps.register_point_cloud(name, places, color=color[:3], material=MATERIAL)
    cloud.reset_transform()
    cloud.set_radius(radius, relative=False)


class Overlays:
    """Structures over the surfaces, which are redrawn when their inputs change.

    ``on_redraw`` is called with the name of each redrawn structure.
    """

    def __init__(self, shown: Shown, on_redraw: Callable[[str], object]) -> None:
        self._shown, self._on_redraw = shown, on_redraw
        # by name of the structure: its surface and the inputs of its drawing
        self._drawn: dict[str, tuple[str, tuple[object, ...]]] = {}
        self._eye = Memo[Eye]()
        self._visible_arrows: object = None  # inputs of the last choice of visible arrows
        self._field: Field | None = None  # of the shown arrows
        self._scale = 1.0

    def update(
        self, meshes: Meshes, paints: Mapping[str, Paint], of_flow: bool, scale: float
    ) -> None:
        """Draw the structures that the view requests on the given surfaces.

        ``meshes`` and ``paints`` are by name of the surface. Arrows, flow lines and paths are drawn
        only if ``of_flow``. ``scale`` is the number of pixels per unit length.
        """
        self._scale = scale
        for name, mesh in meshes.items():
            self._draw_isolines(name, mesh, paints.get(name))
        if "advected" in meshes:
            mesh = self._shown.session.surface("advected").mesh
            self._draw_of_flow(mesh, of_flow, "source" in meshes)

    def update_arrows(self, axes: FloatArray) -> None:
        """Show the visible arrows; the rows of ``axes`` point right, up, towards the viewer."""
        quantities, view = self._shown.quantities, self._shown.session.view
        eye = self._eye.get((axes.tobytes(),), lambda: Eye(axes))
        field = self._field
        arrows = None if field is None else quantities.arrows(field, self._scale, eye)
        if arrows is None or not len(arrows.spines):
            self._remove(_ARROWS)
            draw_transparency(False)
            return
        if self._is_new("advected", _ARROWS, (arrows, view.theme)):
            colors = theme.palette(view.theme)
            draw_arrows(_ARROWS, arrows, theme.linear(colors.ink), theme.linear(colors.ground))
            self._visible_arrows = None
        hidden = quantities.hidden_arrows(arrows, eye)
        inputs = arrows, hidden, axes.tobytes()
        if not same(inputs, self._visible_arrows):
            self._visible_arrows = inputs
            show_visible_arrows(_ARROWS, arrows, eye, hidden)

    def _draw_isolines(self, surface: str, mesh: TriangleMesh, paint: Paint | None) -> None:
        """Draw level sets of the shown function at evenly spaced levels.

        No level is at an end of the colour range, or in its middle if their number is even.
        Functions are often constant there.
        """
        view, name = self._shown.session.view, _ISOLINES + surface
        colors = paint.colors if paint and paint.kind == "vertex values" else None
        if not view.isolines or surface == "error" or paint is None or colors is None:
            self._remove(name)
        elif self._is_new(surface, name, (paint, view.isoline_count, view.theme)):
            shares = (np.arange(view.isoline_count) + 0.5) / view.isoline_count
            levels = colors.low + (colors.high - colors.low) * shares
            values = np.asarray(paint.values, dtype=np.float64)
            if paint.unknown is not None:  # NaN has no level sets
                values = np.where(paint.unknown, np.nan, values)
            lines = isoline_ribbons(mesh, values, levels, _ISOLINE_HALF_WIDTH)
            draw_ribbons(name, mesh, lines, theme.linear(theme.palette(view.theme).ink))

    def _draw_of_flow(self, mesh: TriangleMesh, of_flow: bool, has_source: bool) -> None:
        quantities, view = self._shown.quantities, self._shown.session.view
        colors = theme.palette(view.theme)
        self._field = quantities.field() if view.arrows and of_flow else None
        marker = theme.linear(colors.marker)
        paths = tuple(quantities.paths()) if of_flow else ()
        lines = tuple(quantities.lines()) if of_flow else ()
        for name, curves in ((_LINES, lines), (_PATHS, paths)):
            if self._is_new("advected", name, (curves, view.theme) if curves else None):
                drawn = [path_of_line(mesh, line) for line in curves if len(line.times) > 1]
                draw_ribbons(name, mesh, line_ribbons(drawn, _LINE_HALF_WIDTH), marker)
        self._draw_tracks(mesh)
        time = quantities.path_time
        if self._is_new("advected", _POINTS_NOW, (paths, time, view.theme) if paths else None):
            places = np.array([path.at(time) for path in paths])
            draw_points(_POINTS_NOW, mesh, places, marker, _POINT_RADIUS)
        if self._is_new("source", _STARTS, (paths, view.theme) if paths and has_source else None):
            source_mesh = self._shown.session.surface("source").mesh
            draw_points(_STARTS, source_mesh, quantities.starts(paths), marker, _POINT_RADIUS)

    def _draw_tracks(self, mesh: TriangleMesh) -> None:
        tracks, now = self._shown.tracks.paths(), self._shown.tracks.now()
        time = self._shown.session.document.time
        for kind in KINDS:
            of_kind = tuple(track for track in tracks if track.kind == kind)
            color = theme.linear(CRITICAL_COLORS[kind])
            name = _TRACKS[kind]
            if self._is_new("advected", name, (tracks,) if of_kind else None):
                paths = [_path_at(mesh, each.points.positions, each.points) for each in of_kind]
                moved = [path for path in paths if path.lengths[-1] > 0]
                draw_ribbons(name, mesh, line_ribbons(moved, _TRACK_HALF_WIDTH), color)
            name = _POINT_NAMES[kind]
            if self._is_new("advected", name, (tracks, time) if kind in now else None):
                draw_points(name, mesh, now[kind], color, _CRITICAL_POINT_RADIUS)

    def structures(self) -> Iterator[PlacedStructure]:
        for name, (surface, _) in self._drawn.items():
            get = ps.get_point_cloud if name in _POINTS else ps.get_surface_mesh
            yield surface, name, get(name)

    @contextmanager
    def hidden(self) -> Iterator[None]:
        """Hide all structures in the block, so that picking hits the surface behind them."""
        structures = [structure for *_, structure in self.structures() if structure.is_enabled()]
        for structure in structures:
            structure.set_enabled(False)
        try:
            yield
        finally:
            for structure in structures:
                structure.set_enabled(True)

    def clear(self) -> None:
        for name in list(self._drawn):
            self._remove(name)

    def _is_new(self, surface: str, name: str, inputs: tuple[object, ...] | None) -> bool:
        """Return whether a structure with these inputs must be drawn; remove an outdated one."""
        if name in self._drawn and same(self._drawn[name][1], inputs):
            return False
        self._remove(name)
        if inputs is not None:
            self._drawn[name] = surface, inputs
            self._on_redraw(name)
        return inputs is not None

    def _remove(self, name: str) -> None:
        if self._drawn.pop(name, None) is not None:
            remove = ps.remove_point_cloud if name in _POINTS else ps.remove_surface_mesh
            remove(name, error_if_absent=False)
