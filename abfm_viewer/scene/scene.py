"""The surfaces in the window, side by side on one camera: draws what is shown of a session, and nothing else does."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

import abfm
from abfm import TriangleMesh
from abfm.types import FloatArray
from abfm_viewer.appearance import theme
from abfm_viewer.computing.memo import Memo
from abfm_viewer.document.document import Camera, Front, Layout, Point, triple
from abfm_viewer.scene.camera import best_front, fitted
from abfm_viewer.scene.opengl import ps
from abfm_viewer.scene.overlays import Overlays
from abfm_viewer.scene.pacing import Pacing
from abfm_viewer.scene.surface_quantities import register, show_paint
from abfm_viewer.scene.turntable import Turntable, turntable
from abfm_viewer.scene.viewport import Viewport
from abfm_viewer.shown.paint import Paint, Painter, surfaces
from abfm_viewer.shown.shown import Shown
from abfm_viewer.widgets.widget_record import Rect

_SPACING, _STACKING = 1.15, 1.25
_FIELD_OF_VIEW, _MARGIN = 9.0, 0.05  # degrees: so narrow that the surfaces in a row look alike


@dataclass(frozen=True, eq=False)
class Hit:
    """A point of a surface under the mouse."""

    surface: str
    point: Point
    vertex: int


class Scene:
    """Copies of the mesh, moved apart in the vertices themselves (picks are wrong on structures with a transform)."""

    def __init__(self, shown: Shown, turns: bool = False) -> None:
        self._session = shown.session
        self._turns = turns  # the surfaces get room to turn in
        self.pick: Callable[[tuple[float, float]], Hit | None] = self._picked  # another where nothing is drawn
        self.names: tuple[str, ...] = ()  # of the surfaces, in their order
        self.offsets: dict[str, FloatArray] = {}  # (3,): how far each one was moved
        self.viewport: Viewport  # known from the first `update` on
        self.paints: dict[str, Paint] = {}
        self.painter = Painter(shown)
        self.overlays = Overlays(shown)
        self.pacing = Pacing(shown.session)
        self.room_above = self.room_below = 0.0  # pixels of names and colour bars, which a fitted camera leaves free
        self._mesh: TriangleMesh | None = None
        self._front = Memo[Front]()
        self._heads: FloatArray = np.zeros((0, 3))
        self._turntable: Turntable
        self._extent: FloatArray = np.zeros((0, 3))
        self._layout: Layout = "row"
        self._rect: Rect = (0, 0, 1, 1)
        self._camera: Camera | None = None
        self._placed: object = None
        self._drawn: dict[str, Paint] = {}
        ps.remove_all_structures()
        ps.set_ground_plane_mode("none")

    def update(self, rect: Rect) -> None:
        """Make polyscope's structures show the session, in a rectangle of the window."""
        session, view = self._session, self._session.view
        session.after_match.draws_quickly = self.pacing.draws_quickly
        ground = theme.palette(view.theme).ground
        ps.set_background_color([*theme.linear(ground), 1.0])
        front = self._front_view()
        structure = (session.mesh, surfaces(session), view.layout, front)
        if structure != (self._mesh, self.names, self._layout, self._placed):
            if session.mesh is self._mesh and session.view.camera is not None:  # it saw other surfaces
                session.amend(view=replace(session.view, camera=None))
            self._mesh, self.names, self._layout, self._placed = structure
            self._register(session.mesh, front)
            self.frame(rect)
        elif rect != self._rect:
            self.frame(rect)
        else:
            self._keep_camera()
        for name in self.names:
            paint, before = self.painter.paint(name), self._drawn.get(name)
            if paint is None or (before is not None and self.pacing.waits(name, name == self.names[0])):
                continue
            if name == "advected":
                self.pacing.count(paint is not self.paints.get(name), paint.kind == "texture")
            self.paints[name] = paint
            show_paint(name, session.mesh, paint, before)
            self._drawn[name] = paint
        if "advected" in self.offsets:
            self.overlays.update(self.offsets, self.viewport, self.paints)

    def frame(self, rect: Rect, camera: Camera | None = None, whole: bool = False) -> None:
        """Look through a camera, or the view's, or from the front so that everything fits (`whole`: see `place`)."""
        self._rect = rect
        wanted = camera or self._session.view.camera
        if wanted is None or self._turns:
            assert self._placed is not None
            vertices = np.concatenate([self._extent + offset for offset in self.offsets.values()])
            head = rect[1] + max(self.room_above, 0.06 * (rect[3] - rect[1]))
            free = (rect[0], head, rect[2], max(rect[3] - self.room_below, head + 1))
            front = self._front_view() if wanted is None else wanted.front
            aspect = (free[2] - free[0]) / (free[3] - free[1])
            self.viewport.place(fitted(vertices, front, aspect, _FIELD_OF_VIEW, _MARGIN), free, whole)
        else:
            self.viewport.place(wanted, rect, whole)
        self._camera = self.viewport.seen(rect)

    def camera(self) -> Camera:
        """What the window shows now."""
        return self.viewport.seen(self._rect)

    def reset_camera(self) -> None:
        """Look from the front again."""
        self._session.amend(view=replace(self._session.view, camera=None))
        self.frame(self._rect)

    def turn(self, degrees: float) -> None:
        """Turn every surface, with what is drawn on it, about its own upright axis; picks are wrong then."""
        of_surfaces = [(name, ps.get_surface_mesh(name)) for name in self.names]
        for name, structure in [*of_surfaces, *self.overlays.structures()]:
            center = self.viewport.drawn(self._turntable.middle + self.offsets[name])
            structure.set_transform(self._turntable.turned(degrees, center))

    @property
    def stacked(self) -> bool:
        """Whether the surfaces stand one above the other."""
        return self._layout == "column"

    def labels(self) -> dict[str, tuple[float, float]]:
        """Where to write each surface's name: above this place, or to its left where they are stacked."""
        places = self.viewport.projected(self._heads)
        return {name: (x, y) for name, (x, y, depth) in zip(self.names, places, strict=True) if depth > 0}

    def _picked(self, position: tuple[float, float]) -> Hit | None:
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
        assert self._mesh is not None
        found = abfm.maps.project_onto_surface(self._mesh, position[None])
        return self._hit(surface, int(found.faces[0]), found.barycentric[0])

    def _hit(self, surface: str, face: int, weights: FloatArray) -> Hit:
        assert self._mesh is not None
        vertex = int(self._mesh.faces[face][np.argmax(weights)])
        return Hit(surface, Point(face, triple(weights)), vertex)

    def _keep_camera(self) -> None:
        """Put the camera into the document when the user moved it; that is no step of undo."""
        now, before = self.camera(), self._camera
        if before is None or not self.viewport.alike(now, before):
            self._camera = now
            self._session.amend(view=replace(self._session.view, camera=now))

    def _front_view(self) -> Front:
        """Chosen when the mesh's first functions are known, and then kept in the document."""
        session = self._session
        mesh, source, target = session.mesh, session.values("source"), session.values("target")
        front = session.view.front
        if front is None and source is not None and target is not None:
            front = best_front(mesh, source, target)
            session.amend(view=replace(session.view, front=front))
        return front or self._front.get((mesh,), lambda: best_front(mesh))

    def _register(self, mesh: TriangleMesh, front: Front) -> None:
        for name in list(self._drawn) + list(self.offsets):
            if ps.has_surface_mesh(name):
                ps.remove_surface_mesh(name)
        self._drawn, self.paints = {}, {}
        self.overlays.clear()
        self.viewport = Viewport(mesh)
        sideways, up, _ = front.axes
        axis, spacing = (-up, _STACKING) if self._layout == "column" else (sideways, _SPACING)
        self._turntable = turntable(mesh, up)
        self._extent = self._turntable.rims() if self._turns else mesh.vertices
        along = self._extent @ axis
        step = spacing * (along.max() - along.min()) * axis
        self.offsets = {name: number * step for number, name in enumerate(self.names)}
        middle = self.viewport.center
        outwards = -sideways if self._layout == "column" else up
        head = middle + ((self._extent @ outwards).max() - middle @ outwards) * outwards
        self._heads = np.array([head + offset for offset in self.offsets.values()])
        self.viewport.set_extent(np.concatenate([self._extent + offset for offset in self.offsets.values()]))
        for name, offset in self.offsets.items():
            surface = register(name, mesh, self.viewport.drawn(mesh.vertices + offset))
            surface.reset_transform()  # polyscope remembers that of an earlier surface of this name
            surface.set_selection_mode("faces_only")  # else a pick near a vertex or an edge has no face
