"""The surfaces in the window, side by side on one camera: draws what the session says, and nothing else does."""

from __future__ import annotations

import time as clock
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from abfm import TriangleMesh
from abfm.types import FloatArray
from abfm_viewer.appearance import theme
from abfm_viewer.document.document import Camera, Front, Layout, Point
from abfm_viewer.scene import surface_quantities, viewport
from abfm_viewer.scene.camera import View, best_view
from abfm_viewer.scene.creases import drawn_mesh
from abfm_viewer.scene.drawing_units import drawing_units
from abfm_viewer.scene.opengl import ps
from abfm_viewer.scene.overlays import Overlays
from abfm_viewer.scene.turntable import Turntable, turntable
from abfm_viewer.scene.viewport import Rect
from abfm_viewer.session.session import Session
from abfm_viewer.shown.paint import Paint, Painter, surfaces

_SPACING, _STACKING = 1.15, 1.25
_SLOW_REDRAW, _FRAMES_PER_SLOW_REDRAW = 0.025, 25
_FRAMES_PER_SECOND_OF_REDRAW = 120  # at 30 a second: a fifth of the time for drawing
_AT_ONCE = 3  # pictures of a run that do not wait: the start, and that something moves
_CHECKER = 0.03
_SLOW_REDRAWS_APART = 2.0  # new textures, of moving streaks
_STRIPES = 0.8  # of the light that every other stripe between isolines keeps


@dataclass(frozen=True, eq=False)
class Hit:
    """A point of a surface under the mouse."""

    surface: str
    point: Point
    vertex: int


class Scene:
    """Copies of the mesh, moved apart in the vertices themselves (picks are wrong on structures with a transform).

    Parameters
    ----------
    turns : bool
        Whether the surfaces get room to turn in.

    Attributes
    ----------
    names : tuple of str
        The surfaces, in their order.
    offsets : dict of str to (3,) array
        How far each one was moved.
    paints : dict of str to Paint
        What each one shows.
    room_above, room_below : float
        What the names and the colour bars cover, in pixels: a fitted camera leaves it free.
    redraw_seconds : float
        How long it took to draw the surfaces lately.
    """

    def __init__(self, turns: bool = False) -> None:
        self._turns = turns
        self.names: tuple[str, ...] = ()
        self.offsets: dict[str, FloatArray] = {}
        self.paints: dict[str, Paint] = {}
        self.painter = Painter()
        self.overlays = Overlays()
        self.redraw_seconds = self.room_above = self.room_below = 0.0
        self._mesh: TriangleMesh | None = None
        self._front: tuple[TriangleMesh, Front | None, View] | None = None
        self._heads: FloatArray = np.zeros((0, 3))
        self._turntable: Turntable
        self._extent: FloatArray = np.zeros((0, 3))
        self._frames_behind = 0
        self._run = 0
        self._pictures_of_run = 0
        self._layout: Layout = "row"
        self._rect: Rect = (0, 0, 1, 1)
        self._camera: Camera | None = None
        self._placed: object = None
        self._drawn: dict[str, Paint] = {}
        self._textured_at = 0.0
        self._isolines: tuple[bool, int] = (False, 0)
        ps.remove_all_structures()
        ps.set_ground_plane_mode("none")

    def update(self, session: Session, rect: Rect) -> None:
        """Make polyscope's structures show the session, in a rectangle of the window."""
        ground = theme.palette(session.view.theme).ground
        ps.set_background_color([*(channel**2.2 for channel in ground[:3]), 1.0])  # polyscope wants linear light
        names = surfaces(session)
        front = self._front_view(session)
        structure = (session.mesh, names, session.view.layout, front)
        if structure != (self._mesh, self.names, self._layout, self._placed):
            if session.mesh is self._mesh and session.view.camera is not None:  # it saw other surfaces
                session.amend(view=replace(session.view, camera=None))
            self._mesh, self.names, self._layout, self._placed = structure
            self._register(session.mesh, front)
            self.frame(session, rect)
        elif rect != self._rect:
            self.frame(session, rect)
        else:
            self._keep_camera(session)
        isolines = (session.view.isolines, session.view.isoline_count)
        if isolines != self._isolines:
            self._isolines, self._drawn = isolines, {}
        for name in self.names:
            paint = self.painter.paint(session, name)
            if paint is not None and not self._waits(session, name):
                self._count(session, name, paint)
                self.paints[name] = paint
                self._show(name, paint)
        if "advected" in self.offsets:
            self.overlays.update(session, self.offsets)

    def _waits(self, session: Session, name: str) -> bool:
        """Whether a surface that follows a solve keeps its colours for this frame.

        Where drawing the surfaces takes longer than a frame, as without a graphics card, they follow the solver in one
        of many frames only, so that the window answers in the others. So do streaks that move.
        """
        if session.view.animate and name == "advected" and name in self._drawn and self.redraw_seconds > _SLOW_REDRAW:
            return clock.perf_counter() < self._textured_at + _SLOW_REDRAWS_APART * self.redraw_seconds
        if not session.solver.running or self.redraw_seconds <= _SLOW_REDRAW or name not in self._drawn:
            return False
        if session.solver.started != self._run or self._pictures_of_run < _AT_ONCE:
            return False
        if name == self.names[0]:
            frames = max(_FRAMES_PER_SLOW_REDRAW, round(_FRAMES_PER_SECOND_OF_REDRAW * self.redraw_seconds))
            self._frames_behind = (self._frames_behind + 1) % frames
        return self._frames_behind != 0 and not session.dragging

    def _count(self, session: Session, name: str, paint: Paint) -> None:
        """Count the pictures of a run."""
        run = session.solver.started
        if run != self._run:
            self._run, self._pictures_of_run = run, 0
        if name == "advected" and paint is not self.paints.get(name):
            self._pictures_of_run += 1

    def frame(self, session: Session, rect: Rect, camera: Camera | None = None, whole: bool = False) -> None:
        """Look through a camera, or the view's, or from the front so that everything fits (`whole`: see `place`)."""
        self._rect = rect
        size = ps.get_window_size()
        wanted = camera or session.view.camera
        if wanted is None or self._turns:
            assert self._placed is not None
            vertices = np.concatenate([self._extent + offset for offset in self.offsets.values()])
            head = rect[1] + max(self.room_above, 0.06 * (rect[3] - rect[1]))
            free = (rect[0], head, rect[2], max(rect[3] - self.room_below, head + 1))
            view = self._front_view(session) if wanted is None else viewport.view_of(wanted)
            viewport.place(viewport.fitted(vertices, view, free), free, size, whole)
        else:
            viewport.place(wanted, rect, size, whole)
        self._camera = viewport.seen(rect, size)

    def camera(self) -> Camera:
        """What the window shows now."""
        return viewport.seen(self._rect, ps.get_window_size())

    def reset_camera(self, session: Session) -> None:
        """Look from the front again."""
        session.amend(view=replace(session.view, camera=None))
        self.frame(session, self._rect)

    def turn(self, degrees: float) -> None:
        """Turn every surface, with what is drawn on it, about its own upright axis; picks are wrong then."""
        surfaces = [(name, ps.get_surface_mesh(name)) for name in self.names]
        for name, structure in [*surfaces, *self.overlays.structures()]:
            center = viewport.units.drawn(self._turntable.middle + self.offsets[name])
            structure.set_transform(self._turntable.turned(degrees, center))

    @property
    def stacked(self) -> bool:
        """Whether the surfaces stand one above the other."""
        return self._layout == "column"

    def labels(self) -> dict[str, tuple[float, float]]:
        """Where to write each surface's name: above this place, or to its left where they are stacked."""
        places = viewport.projected(self._heads)
        return {name: (x, y) for name, (x, y, depth) in zip(self.names, places, strict=True) if depth > 0}

    def pick(self, position: tuple[float, float]) -> Hit | None:
        """The point of a surface under a place of the window."""
        hit = ps.pick(screen_coords=position)
        if hit.is_hit and hit.structure_name not in self.names:
            with self.overlays.hidden():
                hit = ps.pick(screen_coords=position)
        if not hit.is_hit or hit.structure_name not in self.names or self._mesh is None:
            return None
        weights = np.maximum(hit.structure_data["bary_coords"], 0.0)  # a pixel at an edge may lie beyond it
        return self._hit(hit.structure_name, int(hit.structure_data["index"]), weights / weights.sum())

    def nearest(self, surface: str, position: FloatArray) -> Hit:
        """The point of a surface nearest to a place in the mesh's own coordinates."""
        from abfm.maps.surface_points import project_onto_surface

        assert self._mesh is not None
        found = project_onto_surface(self._mesh, position[None])
        return self._hit(surface, int(found.faces[0]), found.barycentric[0])

    def _hit(self, surface: str, face: int, weights: FloatArray) -> Hit:
        assert self._mesh is not None
        vertex = int(self._mesh.faces[face][np.argmax(weights)])
        a, b, c = map(float, weights)
        return Hit(surface, Point(face, (a, b, c)), vertex)

    def _keep_camera(self, session: Session) -> None:
        """Put the camera into the document when the user moved it; that is no step of undo."""
        now, before = viewport.seen(self._rect, ps.get_window_size()), self._camera
        if before is None or not viewport.alike(now, before):
            self._camera = now
            session.amend(view=replace(session.view, camera=now))

    def _front_view(self, session: Session) -> View:
        """Chosen when the mesh's first functions are known, and then kept in the document."""
        source, target = session.values("source"), session.values("target")
        front, known = session.view.front, self._front
        if front is None and source is not None and target is not None:
            view = best_view(session.mesh, source, target)
            front = Front(_vector(view.direction), _vector(view.up))
            session.amend(view=replace(session.view, front=front))
        if known is None or known[0] is not session.mesh or known[1] != front:
            view = best_view(session.mesh) if front is None else View(np.array(front.direction), np.array(front.up))
            self._front = known = (session.mesh, front, view)
        return known[2]

    def _register(self, mesh: TriangleMesh, front: View) -> None:
        for name in list(self._drawn) + list(self.offsets):
            if ps.has_surface_mesh(name):
                ps.remove_surface_mesh(name)
        self._drawn, self.paints = {}, {}
        self.overlays.clear()
        viewport.set_units(drawing_units(mesh))
        sideways = np.cross(front.up, front.direction)
        axis, spacing = (-front.up, _STACKING) if self._layout == "column" else (sideways, _SPACING)
        self._turntable = turntable(mesh, front.up)
        self._extent = self._turntable.rims() if self._turns else mesh.vertices
        along = self._extent @ axis
        step = spacing * (along.max() - along.min()) * axis
        self.offsets = {name: number * step for number, name in enumerate(self.names)}
        middle = (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2
        outwards = -sideways if self._layout == "column" else front.up
        head = middle + ((self._extent @ outwards).max() - middle @ outwards) * outwards
        self._heads = np.array([head + offset for offset in self.offsets.values()])
        ends = viewport.units.drawn(np.concatenate([self._extent + offset for offset in self.offsets.values()]))
        viewport.set_extent(ends)
        for name, offset in self.offsets.items():
            surface = surface_quantities.register(name, mesh, viewport.units.drawn(mesh.vertices + offset))
            surface.reset_transform()  # polyscope remembers that of an earlier surface of this name
            surface.set_selection_mode("faces_only")  # else a pick near a vertex or an edge has no face

    def _show(self, name: str, paint: Paint) -> None:
        before = self._drawn.get(name)
        if before is not None and before.kind == paint.kind and before.colors == paint.colors:
            if before.values is paint.values:
                return
            if paint.kind in ("vertex values", "face values"):
                ps.get_surface_mesh(name).get_quantity_buffer(paint.kind, "values").update_data(self._values(paint))
                self._drawn[name] = paint
                return
        if before is not None and before.kind == paint.kind == "texture" and before.corners is paint.corners:
            colors = paint.values.reshape(-1, 3)  # much cheaper than a new quantity
            ps.get_surface_mesh(name).get_quantity_buffer(paint.kind, "colors").update_data(colors)
            self._drawn[name], self._textured_at = paint, clock.perf_counter()
            return
        surface, mesh = ps.get_surface_mesh(name), self._mesh
        assert mesh is not None
        if paint.kind in ("vertex values", "face values"):
            assert paint.colors is not None
            on_vertices, isolines = paint.kind == "vertex values", self._isolines_of(paint)
            surface_quantities.show_values(surface, paint.kind, mesh, paint.values, paint.colors, on_vertices, isolines)
        elif paint.kind == "colors":
            surface_quantities.show_colors(surface, paint.kind, mesh, paint.values)
        elif paint.kind == "texture":
            surface_quantities.show_texture(surface, paint.kind, paint.values, paint.corners)
        else:
            surface_quantities.show_checker(surface, paint.kind, mesh, paint.values, _CHECKER)
        self._drawn[name] = paint

    def _isolines_of(self, paint: Paint) -> dict[str, Any]:
        """Polyscope's options for the isolines of a function."""
        shown = self._isolines[0] and paint.kind == "vertex values"
        if not shown or paint.colors is None:
            return {"isolines_enabled": False}  # polyscope would remember the last ones
        return {  # each of these alone switches them on
            "isolines_enabled": True,
            "isoline_style": "stripe",  # contours are black where a function hardly changes
            "isoline_period": (paint.colors.high - paint.colors.low) / max(self._isolines[1], 1),
            "isoline_darkness": _STRIPES,
        }

    def _values(self, paint: Paint) -> NDArray[Any]:
        """A paint's values as polyscope's mesh needs them."""
        assert self._mesh is not None
        return paint.values if paint.kind == "face values" else drawn_mesh(self._mesh).values(paint.values)


def _vector(values: FloatArray) -> tuple[float, float, float]:
    x, y, z = map(float, values)
    return x, y, z
