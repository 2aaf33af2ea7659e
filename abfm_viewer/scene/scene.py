"""The surfaces in the window, each in its slot: draws what is shown of a session, and nothing else does."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

import abfm
from abfm import TriangleMesh
from abfm.types import FloatArray
from abfm_viewer.appearance import theme
from abfm_viewer.document.document import Document, Front, Look, Point, triple
from abfm_viewer.document.fronts import best_front
from abfm_viewer.scene import opengl
from abfm_viewer.scene.opengl import ps
from abfm_viewer.scene.overlays import Overlays
from abfm_viewer.scene.pacing import Pacing
from abfm_viewer.scene.placing import Placed, Placing
from abfm_viewer.scene.slot_view import Fit, SlotView
from abfm_viewer.scene.slots import slots
from abfm_viewer.scene.surface_quantities import edge_width, register, set_style, show_paint
from abfm_viewer.scene.turntable import Turntable, turntable
from abfm_viewer.scene.viewport import Viewport
from abfm_viewer.shown.paint import Paint, Painter
from abfm_viewer.shown.shown import Shown
from abfm_viewer.widgets.widget_record import Rect


@dataclass(frozen=True, eq=False)
class Hit:
    """A point of a surface under the mouse."""

    surface: str
    point: Point
    vertex: int


class Scene:
    """Copies of the mesh, all alike: where each one is seen is a matter of transforms, which cost nothing.

    `names` are the surfaces that exist, in their order, and `shown` those of them that have a slot.
    """

    def __init__(self, shown: Shown, turns: bool = False) -> None:
        self._session = shown.session
        self._turns = turns  # the surfaces get room to turn in
        self.pick: Callable[[tuple[float, float]], Hit | None] = self._picked  # another where nothing is drawn
        self.names: tuple[str, ...] = ()
        self.viewport: Viewport  # these are known once there are names
        self.view: SlotView
        self.paints: dict[str, Paint] = {}
        self.painter = Painter(shown)
        self.overlays = Overlays(shown)
        self.pacing = Pacing(shown.session)
        self.name_height = self.room_below = 0.0  # pixels of names, in each slot, and of colour bars below all
        self._mesh: TriangleMesh | None = None
        self._turntable: Turntable
        self._fit: Fit
        self._fitted_to: object = None
        self._placing = Placing()
        self._style: object = None
        self._document: Document | None = None
        self._degrees = 0.0
        self._drawn: dict[str, Paint] = {}
        opengl.clear()

    def update(self, rect: Rect) -> None:
        """Make polyscope's structures show the session, in a rectangle of the window."""
        session, view = self._session, self._session.view
        session.after_match.draws_quickly = self.pacing.draws_quickly
        ground = theme.palette(view.theme).ground
        ps.set_background_color([*theme.linear(ground), 1.0])
        front = self._front()
        names = () if front is None else view.shown_surfaces
        if session.mesh is not self._mesh or not names:
            self._remove(self.names)
        if front is None:
            return  # nothing is shown that would turn as soon as it is known
        if session.mesh is not self._mesh:
            self._mesh, self.viewport = session.mesh, Viewport(session.mesh)
        if names != self.names:
            self._register(names)
        self._look(rect, front)
        self._restyle()
        overlays_wait = False
        for name in self.shown:
            paint, before = self.painter.paint(name), self._drawn.get(name)
            waits = before is not None and self.pacing.waits(name, name == self.shown[0])
            overlays_wait = overlays_wait or (waits and name == "advected")
            if paint is None or waits:
                continue
            if name == "advected":
                self.pacing.count(paint is not self.paints.get(name), paint.kind == "texture")
            self.paints[name] = paint
            show_paint(name, session.mesh, paint, before)
            self._drawn[name] = paint
        earlier, self._document = self._document, session.document
        if earlier is not session.document or not overlays_wait:  # what the user changes is seen at once
            of_flow = earlier is None or earlier.view is not view or not self.pacing.begins
            self.overlays.update(self.names, self.viewport, self.paints, of_flow)
        self._place()

    @property
    def shown(self) -> tuple[str, ...]:
        """Those that got a slot in this frame, whatever was done since: all, or the one that is shown large."""
        return tuple(name for name in self.names if name in self.view.slots)

    @property
    def look(self) -> Look | None:
        """How the surfaces are seen now; None before they are."""
        if self._session.view.look is None:
            front = self._front()
            return None if front is None else Look(front)
        return self._session.view.look

    def turn(self, degrees: float) -> None:
        """Turn every surface, with what is drawn on it, about its own upright axis; picks are wrong then."""
        self._degrees = degrees
        self._place()

    def rotate(self, name: str, start: tuple[float, float], end: tuple[float, float]) -> None:
        """Turn the surfaces as the mouse turns one of them; this and the next two are no steps of undo."""
        self._see(self.view.turned(name, start, end), self.view.zoom, None)

    def move(self, delta: tuple[float, float]) -> None:
        """Move them in their slots, by pixels."""
        self._see(self.view.rotation, self.view.zoom, self.view.moved(delta))

    def zoom(self, name: str, place: tuple[float, float], factor: float) -> None:
        """Come nearer to what is under the mouse in a surface's slot, or go farther."""
        zoom, target = self.view.zoomed(name, place, factor)
        self._see(self.view.rotation, zoom, target)

    def enlarge(self, name: str) -> None:
        """Give a surface the others' slots, too; with an empty name all are shown again."""
        self._session.amend(view=replace(self._session.view, large=name))

    def projected(self, name: str, points: FloatArray) -> FloatArray:
        """Places in the window and depths (P, 3) of points (P, 3) of a shown surface, in the mesh's units."""
        return self.view.projected(name, self.viewport.drawn(np.atleast_2d(points)))

    def labels(self) -> dict[str, Rect]:
        """Where to write each surface's name."""
        return {name: self.view.label(name) for name in self.shown}

    def borders(self) -> list[tuple[tuple[float, float], tuple[float, float]]]:
        """Lines to draw between slots."""
        return self.view.borders() if self.shown else []

    def _picked(self, position: tuple[float, float]) -> Hit | None:
        """The point of a surface under a place of the window."""
        hit = ps.pick(screen_coords=position)
        if hit.is_hit and hit.structure_name not in self.names:
            with self.overlays.hidden():
                hit = ps.pick(screen_coords=position)
        if not hit.is_hit or hit.structure_name not in self.shown or self._mesh is None:
            return None
        face = int(hit.structure_data["index"])
        matrix = self.view.matrix(hit.structure_name, ps.get_window_size())
        place = self.viewport.undrawn((np.asarray(hit.position) - matrix[:3, 3]) @ matrix[:3, :3])
        return self._hit(hit.structure_name, face, _barycentric(self._mesh.vertices[self._mesh.faces[face]], place))

    def nearest(self, surface: str, position: FloatArray) -> Hit:
        """The point of a surface nearest to a place in the mesh's own coordinates."""
        assert self._mesh is not None
        found = abfm.maps.project_onto_surface(self._mesh, position[None])
        return self._hit(surface, int(found.faces[0]), found.barycentric[0])

    def _hit(self, surface: str, face: int, weights: FloatArray) -> Hit:
        assert self._mesh is not None
        vertex = int(self._mesh.faces[face][np.argmax(weights)])
        return Hit(surface, Point(face, triple(weights)), vertex)

    def _see(self, rotation: FloatArray, zoom: float, target: FloatArray | None) -> None:
        """Put a look into the document that the user did not choose from a menu; None keeps the target."""
        before = self.look
        assert before is not None
        seen = before.target if target is None else triple(self.viewport.undrawn(target))
        if target is not None and np.allclose(target, self.view.home, rtol=0, atol=1e-9 * self.view.radius):
            seen = None
        look = Look(Front(triple(rotation[2]), triple(rotation[1])), zoom, seen)
        if look != before:
            self._session.amend(view=replace(self._session.view, look=look))

    def _front(self) -> Front | None:
        """Chosen from the mesh, whose default functions will face it, or when its functions are known; then kept."""
        session = self._session
        front = session.view.front
        if front is None:
            source, target = session.values("source"), session.values("target")
            if not session.channels:
                front = best_front(session.mesh)
            elif source is not None and target is not None:
                front = best_front(session.mesh, source, target)
            elif any(session.error(spec) for spec in session.specs):
                front = best_front(session.mesh)
            if front is not None:
                session.amend(view=replace(session.view, front=front))
        return front

    def _register(self, names: tuple[str, ...]) -> None:
        """Have surfaces of these names, and no others."""
        assert self._mesh is not None
        self._remove(tuple(name for name in self.names if name not in names))
        for name in names:
            if name not in self.names:
                surface = register(name, self._mesh, self.viewport.drawn(self._mesh.vertices))
                surface.set_selection_mode("faces_only")  # else a pick near a vertex or an edge has no face
        self.names, self._style = names, None
        self._placing.forget()

    def _remove(self, names: tuple[str, ...]) -> None:
        for name in names:
            ps.remove_surface_mesh(name)
            self._drawn.pop(name, None)
            self.paints.pop(name, None)
        self.names = tuple(name for name in self.names if name not in names)
        if names:
            self.overlays.clear()

    def _restyle(self) -> None:
        """Wireframe and shading."""
        view = self._session.view
        assert self._mesh is not None
        edges = edge_width(len(self._mesh.faces), self.view.scale) if view.wireframe else 0.0
        style = (edges, view.flat, view.theme)
        if style != self._style:
            self._style = style
            for name in self.names:
                set_style(ps.get_surface_mesh(name), edges, view.flat, view.theme)

    def _look(self, rect: Rect, front: Front) -> None:
        """Decide where everything is to be seen."""
        view, look = self._session.view, self.look
        assert look is not None
        assert self._mesh is not None
        if self._fitted_to != (self._mesh, front):
            self._fitted_to = (self._mesh, front)
            self._turntable = turntable(self._mesh, front.axes[1])
            extent = self._turntable.rims() if self._turns else self._mesh.vertices
            self._fit = Fit(self.viewport.drawn(extent), front)
        left, top, right, bottom = rect
        free = (left, top, right, max(bottom - self.room_below, top + 1))
        names = (view.large,) if view.large in self.names else self.names
        places = slots(names, free, self._fit.shape, view.layout, self.name_height)
        target = None if look.target is None or self._turns else self.viewport.drawn(np.array(look.target))
        self.view = self._fit.view(places, look.front, 1.0 if self._turns else look.zoom, target)

    def _place(self) -> None:
        """Put everything there."""
        if not self.names:
            return
        turned = np.eye(4)
        if self._turns:
            turned = self._turntable.turned(self._degrees, self.viewport.drawn(self._turntable.middle))
        surfaces: list[Placed] = [(name, name, None, ps.get_surface_mesh(name)) for name in self.names]
        self._placing.place(self.viewport, self.view, turned, [*surfaces, *self.overlays.structures()])


def _barycentric(corners: FloatArray, place: FloatArray) -> FloatArray:
    """Weights (3,) of the point of a triangle (3, 3) at a place in its plane; a pixel at an edge may lie beyond it."""
    edges = corners[1:] - corners[0]
    found = np.linalg.lstsq(edges.T, place - corners[0], rcond=None)[0]
    inside = np.maximum(np.array([1 - found.sum(), *found]), 0.0)
    weights: FloatArray = inside / inside.sum()
    return weights
