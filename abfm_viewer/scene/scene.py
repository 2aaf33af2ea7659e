"""The surfaces in the window, each in its slot: draws what is shown of a session."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

import abfm
from abfm import TriangleMesh
from abfm.types import FloatArray
from abfm_viewer.appearance import theme
from abfm_viewer.computing.defaults import best_front
from abfm_viewer.document.document import Document, Front, Look, Point, triple
from abfm_viewer.scene import opengl
from abfm_viewer.scene.opengl import ps
from abfm_viewer.scene.overlays import Overlays
from abfm_viewer.scene.pacing import Pacing
from abfm_viewer.scene.placing import Placed, Placing
from abfm_viewer.scene.slot_view import Fit, SlotView
from abfm_viewer.scene.slots import slots
from abfm_viewer.scene.surface_quantities import edge_width, register, set_style, show_paint
from abfm_viewer.scene.turntable import Turntable, turntable
from abfm_viewer.scene.viewport import Viewport, viewport
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
    """Surfaces in slots: where each one is seen is a matter of transforms, which cost nothing.

    `names` are the slots that exist, in their order, and `shown` those of them that have room.
    """

    def __init__(self, shown: Shown, turns: bool = False) -> None:
        self._session = shown.session
        self._turns = turns  # the surfaces get room to turn in
        # another where nothing is drawn
        self.pick: Callable[[tuple[float, float]], Hit | None] = self._picked
        self.view: SlotView  # known once there are names
        self.paints: dict[str, Paint] = {}
        self.painter = Painter(shown)
        self.overlays = Overlays(shown)
        self.pacing = Pacing(shown.session)
        # pixels of names, in each slot, and of colour bars below all
        self.name_height = self.room_below = 0.0
        self._meshes: dict[str, TriangleMesh] = {}
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
        # nothing is shown that would turn as soon as the front is known
        names = () if front is None else view.shown_surfaces
        self._register({name: session.surface(name).mesh for name in names})
        if front is None:
            return
        self._look(rect, front)
        self._restyle()
        overlays_wait = self._paint()
        earlier, self._document = self._document, session.document
        # what the user changes is seen at once
        if earlier is not session.document or not overlays_wait:
            of_flow = earlier is None or earlier.view is not view or not self.pacing.begins
            self.overlays.update(self._meshes, self.paints, of_flow)
        self._place()

    def _paint(self) -> bool:
        """Show the surfaces' paints; whether the advected one waits."""
        advected_waits = False
        for name in self.shown:
            paint, before = self.painter.paint(name), self._drawn.get(name)
            waits = before is not None and self.pacing.waits(name, name == self.shown[0])
            advected_waits = advected_waits or (waits and name == "advected")
            if paint is None or waits:
                continue
            if name == "advected":
                self.pacing.count(paint is not self.paints.get(name), paint.kind == "texture")
            self.paints[name] = self._drawn[name] = paint
            show_paint(name, self._meshes[name], paint, before)
        return advected_waits

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(self._meshes)

    @property
    def shown(self) -> tuple[str, ...]:
        """Return those that got a slot in this frame: all, or the one that is shown large."""
        return tuple(name for name in self.names if name in self.view.slots)

    @property
    def look(self) -> Look | None:
        """Return how the surfaces are seen now; None before they are."""
        if self._session.view.look is None:
            front = self._front()
            return None if front is None else Look(front)
        return self._session.view.look

    def turn(self, degrees: float) -> None:
        """Turn every surface, with what is drawn on it, about its own upright axis; picks are
        wrong then.
        """
        self._degrees = degrees
        self._place()

    def rotate(self, name: str, start: tuple[float, float], end: tuple[float, float]) -> None:
        """Turn the surfaces as the mouse turns one of them; this and the next three are no steps
        of undo.
        """
        self._see(self.view.turned(name, start, end), self.view.zoom, None)

    def orbit(self, delta: tuple[float, float]) -> None:
        """Turn the surfaces by pixels as on a turntable: what stands upright stays so."""
        self._see(self.view.orbited(delta), self.view.zoom, None)

    def move(self, delta: tuple[float, float]) -> None:
        """Move them in their slots, by pixels."""
        self._see(self.view.rotation, self.view.zoom, self.view.moved(delta))

    def zoom(self, name: str, place: tuple[float, float], factor: float) -> None:
        """Come nearer to what is under the mouse in a surface's slot, or go farther."""
        zoom, target = self.view.zoomed(name, place, factor)
        self._see(self.view.rotation, zoom, target)

    def enlarge(self, name: str) -> None:
        """Give a surface the others' slots, too; with an empty name all are shown again."""
        self._session.editor.amend(view=replace(self._session.view, large=name))

    def projected(self, name: str, points: FloatArray) -> FloatArray:
        """Return places in the window and depths (P, 3) of points (P, 3) of a shown surface."""
        return self.view.projected(name, viewport(self._meshes[name]).drawn(np.atleast_2d(points)))

    def covers(self, name: str, place: tuple[float, float]) -> bool:
        """Return whether a shown surface is drawn at a place of the window, without drawing it."""
        mesh = self._meshes[name]
        corners = self.projected(name, mesh.vertices)[mesh.faces, :2] - place
        x, y = np.moveaxis(corners, -1, 0)
        sides = x * np.roll(y, -1, axis=1) - y * np.roll(x, -1, axis=1)
        return bool(((sides >= 0).all(axis=1) | (sides <= 0).all(axis=1)).any())

    def labels(self) -> dict[str, Rect]:
        """Return where to write each surface's name."""
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
        name = hit.structure_name
        if not hit.is_hit or name not in self.shown:
            return None
        mesh, face = self._meshes[name], int(hit.structure_data["index"])
        matrix = self.view.matrix(name, ps.get_window_size())
        place = (np.asarray(hit.position) - matrix[:3, 3]) @ matrix[:3, :3]
        corners = mesh.vertices[mesh.faces[face]]
        return self._hit(name, face, _barycentric(corners, viewport(mesh).undrawn(place)))

    def nearest(self, name: str, position: FloatArray) -> Hit:
        """The point of a surface nearest to a place in the mesh's own coordinates."""
        found = abfm.maps.project_onto_surface(self._meshes[name], position[None])
        return self._hit(name, int(found.faces[0]), found.barycentric[0])

    def _hit(self, name: str, face: int, weights: FloatArray) -> Hit:
        vertex = int(self._meshes[name].faces[face][np.argmax(weights)])
        return Hit(name, Point(face, triple(weights)), vertex)

    def _see(self, rotation: FloatArray, zoom: float, target: FloatArray | None) -> None:
        """Put a look into the document that the user did not choose from a menu.

        None keeps the target.
        """
        before, view = self.look, self.view
        assert before is not None
        seen = before.target
        if target is not None:
            is_home = np.allclose(target, view.home, rtol=0, atol=1e-9 * view.radius)
            seen = None if is_home else triple(self.viewport.undrawn(target))
        look = Look(Front(triple(rotation[2]), triple(rotation[1])), zoom, seen)
        if look != before:
            self._session.editor.amend(view=replace(self._session.view, look=look))

    def _front(self) -> Front | None:
        """Return the surface's front, chosen when its functions are known, and then kept.

        It is chosen for the mesh alone where default functions are to come, which will face it, or
        where functions cannot be evaluated.
        """
        session, surface = self._session, self._session.surface()
        if surface.front is not None:
            return surface.front
        functions = [session.values("source"), session.values("target")]
        known = [values for values in functions if values is not None]
        if len(known) < len(functions):
            if session.channels and not session.functions.problem(session.document):
                return None
            known = []
        front = best_front(surface.mesh, *known)
        session.editor.amend(surfaces=session.document.facing(front).surfaces)
        return front

    def _register(self, meshes: dict[str, TriangleMesh]) -> None:
        """Have surfaces of these meshes by their names, and no others."""
        if meshes == self._meshes and [*meshes] == [*self._meshes]:
            return
        gone = [name for name, mesh in self._meshes.items() if meshes.get(name) is not mesh]
        for name in gone:
            ps.remove_surface_mesh(name)
            self._drawn.pop(name, None)
            self.paints.pop(name, None)
        if gone:
            self.overlays.clear()
        for name, mesh in meshes.items():
            if name in gone or name not in self._meshes:
                surface = register(name, mesh)
                # else a pick near a vertex or an edge has no face
                surface.set_selection_mode("faces_only")
        self._meshes, self._style = meshes, None
        self._placing.forget()

    def _restyle(self) -> None:
        """Wireframe and shading."""
        view = self._session.view
        edges = {
            name: edge_width(len(mesh.faces), self.view.scale) if view.wireframe else 0.0
            for name, mesh in self._meshes.items()
        }
        style = (edges, view.flat, view.theme)
        if style != self._style:
            self._style = style
            for name, width in edges.items():
                set_style(ps.get_surface_mesh(name), width, view.flat, view.theme)

    @property
    def viewport(self) -> Viewport:
        """Return that of the document's surface, in whose units targets of looks are."""
        return viewport(self._session.surface().mesh)

    def _look(self, rect: Rect, front: Front) -> None:
        """Decide where everything is to be seen."""
        view, look, mesh = self._session.view, self.look, self._session.surface().mesh
        assert look is not None
        if self._fitted_to != (mesh, front):
            self._fitted_to = (mesh, front)
            self._turntable = turntable(mesh, front.axes[1])
            extent = self._turntable.rims() if self._turns else mesh.vertices
            self._fit = Fit(self.viewport.drawn(extent), front)
        left, top, right, bottom = rect
        free = (left, top, right, max(bottom - self.room_below, top + 1))
        names = (view.large,) if view.large in self.names else self.names
        places = slots(names, free, self._fit.shape, view.layout, self.name_height)
        target = None
        if look.target is not None and not self._turns:
            target = self.viewport.drawn(np.array(look.target))
        self.view = self._fit.view(places, look.front, 1.0 if self._turns else look.zoom, target)

    def _place(self) -> None:
        """Put everything there."""
        if not self.names:
            return
        turned = np.eye(4)
        if self._turns:
            middle = self.viewport.drawn(self._turntable.middle)
            turned = self._turntable.turned(self._degrees, middle)
        surfaces: list[Placed] = [
            (name, name, None, ps.get_surface_mesh(name)) for name in self.names
        ]
        self._placing.place(self.view, turned, [*surfaces, *self.overlays.structures()])


def _barycentric(corners: FloatArray, place: FloatArray) -> FloatArray:
    """Find the weights (3,) of the point of a triangle (3, 3) at a place in its plane."""
    edges = corners[1:] - corners[0]
    found = np.linalg.lstsq(edges.T, place - corners[0], rcond=None)[0]
    inside = np.maximum(np.array([1 - found.sum(), *found]), 0.0)
    weights: FloatArray = inside / inside.sum()
    return weights
