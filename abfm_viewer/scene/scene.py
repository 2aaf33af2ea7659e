"""The surfaces in the window, each in its slot: draws what is shown of a session."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

import abfm
from abfm import TriangleMesh
from abfm.pages.colormaps import place_colors
from abfm.pages.front import Front, triple
from abfm.types import FloatArray
from abfm_viewer.appearance import theme
from abfm_viewer.computing.background import Memo
from abfm_viewer.document.document import SIDES, Document, Point, Side, Viewpoint
from abfm_viewer.scene import opengl, surfaces
from abfm_viewer.scene.opengl import ps
from abfm_viewer.scene.overlays import Overlays, Placed, evenly_spread
from abfm_viewer.scene.pacing import Pacing
from abfm_viewer.scene.slots import Fit, Place, SlotView, rotation, slots
from abfm_viewer.scene.surfaces import Viewport, viewport
from abfm_viewer.shown.landmarks import LandmarkPoints
from abfm_viewer.shown.paint import Paint, Painter
from abfm_viewer.shown.ribbons import unit, vertex_normals
from abfm_viewer.shown.shown import Shown
from abfm_viewer.widgets.widget_record import Rect

# the viewer, in radii of a surface, of which a part may be two radii before its slot's middle
_VIEWER_DISTANCE = 4.0
_POINTS_OF_A_RIM = 32
MARK_RADIUS = 9.0
"""Of landmarks, in pixels at a scale of 1."""
NO_VALUE = "no value"
"""What grey means, in the legend."""


@dataclass(frozen=True, eq=False)
class Hit:
    surface: str
    point: Point
    vertex: int


class Scene:
    """Surfaces in slots: `names` are those that exist, `shown` those that have room."""

    def __init__(self, shown: Shown, turns: bool = False) -> None:
        self._shown, self._session = shown, shown.session
        self._turns = turns  # the surfaces get room to turn in
        # another where nothing is drawn
        self.pick: Callable[[Place], Hit | None] = self._picked
        self.view: SlotView  # known once there are names
        self.paints: dict[str, Paint] = {}
        self.painter = Painter(shown)
        self._links = Memo[Links]()
        self._placing = Placing()
        self.overlays = Overlays(shown, self._placing.placed.discard)
        self.pacing = Pacing(shown.session)
        # pixels of names, in each slot, of colour bars below all, and of a length at a scale of 1
        self.name_height = self.room_below = 0.0
        self.pixels = 1.0
        self._meshes: dict[str, TriangleMesh] = {}
        self._fits: dict[str, Fitted] = {}  # by surfaces' names
        self._views: dict[str, SlotView] = {}
        self._style: object = None
        self._document: Document | None = None
        self._changed = False  # it was, by the user, and that is still to be seen
        self._degrees = 0.0
        opengl.clear()

    def update(self, rect: Rect) -> None:
        session, view = self._session, self._session.view
        session.draws_quickly = self.pacing.draws_quickly
        ground = theme.palette(view.theme).ground
        ps.set_background_color([*theme.linear(ground), 1.0])
        fronts = [self._front(slot) for slot in ("advected", "source")]
        is_seen = all(front is not None for front in fronts)
        # nothing is shown that would turn as soon as the front is known
        names = view.shown_surfaces if is_seen else ()
        self._register({name: self.mesh(name) for name in names})
        if not is_seen:
            return
        self._look(rect)
        self._restyle()
        overlays_wait = self._paint()
        earlier, self._document = self._document, session.document
        # what the user changes is seen at once, or as soon as it is known
        self._changed = self._changed or earlier is not session.document
        if self._changed or not overlays_wait:
            of_flow = earlier is None or earlier.view is not view or not self.pacing.begins
            scale = self.view.scale / self.pixels
            self.overlays.update(self._meshes, self.paints, of_flow, scale)
            self._changed = False
        self._place()

    def mesh(self, name: str) -> TriangleMesh:
        """Return what a surface is drawn on: its own mesh, or a finer one that has its values."""
        paint = self.painter.paint(name)
        return (paint and paint.mesh) or self._session.surface(name).mesh

    def _paint(self) -> bool:
        """Show the surfaces' paints; whether the advected one waits."""
        advected_waits = False
        for name in self.shown:
            paint, before = self.painter.paint(name), self.paints.get(name)
            waits = before is not None and self.pacing.waits(name, name == self.shown[0])
            advected_waits = advected_waits or (waits and name == "advected")
            if paint is None or waits:
                continue
            if name == "advected":
                self.pacing.count(paint is not before, paint.kind == "texture")
            self.paints[name] = paint
            surfaces.show_paint(name, self._meshes[name], paint, before)
        return advected_waits

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(self._meshes)

    @property
    def shown(self) -> tuple[str, ...]:
        """Return those that got a slot in this frame: all, or the one that is shown large."""
        return tuple(name for name in self.names if name in self.view.slots)

    @property
    def behind(self) -> tuple[str, ...]:
        """Return the shown surfaces that still have an earlier result."""
        is_behind = self._shown.is_behind
        return tuple(name for name in self.shown if is_behind and name in ("advected", "error"))

    @property
    def viewpoint(self) -> Viewpoint | None:
        """Return how the surfaces are seen now; None before they are."""
        if viewpoint := self._session.view.viewpoint:
            return viewpoint
        return Viewpoint(front) if (front := self._front("advected")) else None

    def turn(self, degrees: float) -> None:
        """Turn all about their upright axes; picks are wrong then."""
        self._degrees = degrees
        self._place()

    def see(self, view: SlotView) -> None:
        """Look at the surfaces as the mouse wants it, which is no step of undo."""
        before = self.viewpoint
        assert before is not None
        target = before.target
        if view.target is not self.view.target:
            is_home = np.allclose(view.target, view.home, rtol=0, atol=1e-9 * view.radius)
            target = None if is_home else triple(self._viewport.undrawn(view.target))
        viewpoint = Viewpoint(
            Front(triple(view.rotation[2]), triple(view.rotation[1])), view.zoom, target
        )
        if viewpoint != before:
            self._session.editor.amend(view=replace(self._session.view, viewpoint=viewpoint))

    def look_at(self, name: str, viewpoint: Viewpoint) -> Viewpoint:
        """Return how all are seen where one surface is seen by a look of its own."""
        if name not in self._views:
            return viewpoint
        own, all_of_them = self._fitted("source"), self._fitted("advected")
        drawn = (
            None
            if viewpoint.target is None
            else viewport(own.mesh).drawn(np.array(viewpoint.target))
        )
        seen = own.fit.view(self.view.slots, viewpoint.front, viewpoint.zoom, drawn)
        view = seen.seen_alike(own.front, all_of_them.fit, all_of_them.front)
        front = Front(triple(view.rotation[2]), triple(view.rotation[1]))
        return Viewpoint(front, view.zoom, triple(self._viewport.undrawn(view.target)))

    def links(self) -> list[Link]:
        """Return lines from points of surface A to where they are on B at the shown time, as far as
        both are in view.
        """
        session, ends = self._session, ("source", "advected")
        if not session.view.links or self._has_one_surface:
            return []
        origins = self._shown.flow.coordinates()
        if origins is None or not set(ends) <= set(self.shown):
            return []
        a, b = (session.surface(name).mesh for name in ends)
        links = self._links.get((origins, a, b), lambda: Links.between(a, b, origins))
        towards = self.view.rotation[2]
        starts, stops = (
            self.projected(name, places)
            for name, places in zip(ends, (links.starts, links.ends), strict=True)
        )
        rects = [self.view.slots[name].rect for name in ends]
        inside = (
            (links.normals @ towards > 0) & _inside(starts, rects[0]) & _inside(stops, rects[1])
        )
        return [
            ((float(start[0]), float(start[1])), (float(stop[0]), float(stop[1])), color)
            for start, stop, color in zip(
                starts[inside], stops[inside], links.colors[inside], strict=True
            )
        ]

    def legend(self) -> tuple[str, ...]:
        """Return the kinds of critical points whose ways are drawn, and `NO_VALUE` where some are
        missing.
        """
        kinds = tuple(self._shown.tracks.counts()) if "advected" in self.shown else ()
        paints = [self.paints[name] for name in self.shown if name in self.paints]
        is_missing = any(paint.unknown is not None for paint in paints)
        return (*kinds, NO_VALUE) if is_missing else kinds

    def landmarks(self) -> list[DrawnMark]:
        """Return the landmarks that are in view, where they are in the window."""
        found: list[DrawnMark] = []
        for name in self.shown:
            side: Side = "source" if name == "source" else "target"
            is_placed = name in SIDES
            found += self._drawn(name, side, self._shown.landmarks.placed(side), not is_placed)
            if name == "advected":
                found += self._drawn(name, None, self._shown.landmarks.moved(), False)
        return found

    def landmark_at(self, place: Place) -> DrawnMark | None:
        """Return the landmark that a place of the window is on, and that can be moved there."""
        reach = MARK_RADIUS * self.pixels
        near = [
            (math.dist(mark.place, place), mark)
            for mark in self.landmarks()
            if mark.side is not None and math.dist(mark.place, place) <= reach
        ]
        return min(near, key=lambda one: one[0])[1] if near else None

    def _drawn(
        self, name: str, side: Side | None, marks: LandmarkPoints | None, is_goal: bool
    ) -> list[DrawnMark]:
        if marks is None or self._session.surface(name).mesh is not marks.mesh:
            return []
        at, axes = self.projected(name, marks.places)[:, :2], self.view_of(name).rotation
        hidden = self._shown.landmarks.hidden(name, side, marks, axes)
        seen = _inside(at, self.view.slots[name].rect) & ~hidden
        return [
            DrawnMark(name, side, number, (float(x), float(y)), is_goal)
            for number, (x, y), is_seen in zip(marks.numbers, at, seen, strict=True)
            if is_seen
        ]

    def projected(self, name: str, points: FloatArray) -> FloatArray:
        """Return places in the window and depths (P, 3) of points (P, 3) of a shown surface."""
        drawn = viewport(self._meshes[name]).drawn(np.atleast_2d(points))
        return self.view_of(name).projected(name, drawn)

    def view_of(self, name: str) -> SlotView:
        """Return how a surface is seen: as all are, from a front of its own."""
        return self._views.get(name, self.view)

    def covers(self, name: str, place: Place) -> bool:
        """Return whether a shown surface is drawn at a place of the window, without drawing it."""
        mesh = self._meshes[name]
        corners = self.projected(name, mesh.vertices)[mesh.faces, :2] - place
        x, y = np.moveaxis(corners, -1, 0)
        sides = x * np.roll(y, -1, axis=1) - y * np.roll(x, -1, axis=1)
        return bool(((sides >= 0).all(axis=1) | (sides <= 0).all(axis=1)).any())

    def _picked(self, position: Place) -> Hit | None:
        hit = ps.pick(screen_coords=position)
        if hit.is_hit and hit.structure_name not in self.names:
            with self.overlays.hidden():
                hit = ps.pick(screen_coords=position)
        name = hit.structure_name
        if not hit.is_hit or name not in self.shown:
            return None
        mesh, drawn = self._session.surface(name).mesh, self._meshes[name]
        # a finer one has the children of each face side by side
        face = int(hit.structure_data["index"]) * len(mesh.faces) // len(drawn.faces)
        matrix = self.view_of(name).matrix(name, ps.get_window_size(), self.view.scale)
        away: FloatArray = np.asarray(hit.position) - matrix[:3, 3]
        place = viewport(mesh).undrawn(np.linalg.inv(matrix[:3, :3]) @ away)
        a, b, c = mesh.vertices[mesh.faces[face]]
        found = np.linalg.lstsq(np.stack([b - a, c - a], axis=1), place - a, rcond=None)[0]
        inside = np.maximum(np.array([1 - found.sum(), *found]), 0.0)
        return self._hit(name, face, inside / inside.sum())

    def nearest(self, name: str, position: FloatArray) -> Hit:
        mesh = self._session.surface(name).mesh
        found = abfm.maps.project_onto_surface(mesh, position[None])
        return self._hit(name, int(found.faces[0]), found.barycentric[0])

    def _hit(self, name: str, face: int, weights: FloatArray) -> Hit:
        vertex = int(self._session.surface(name).mesh.faces[face][np.argmax(weights)])
        return Hit(name, Point(face, triple(weights)), vertex)

    def _front(self, slot: str) -> Front | None:
        """Choose the front when functions are known, or without any if there will be none."""
        session, surface = self._session, self._session.surface(slot)
        if surface.front is not None:
            return surface.front
        on_it = (side for side in SIDES if session.surface(side) is surface)
        functions = [session.values(side) for side in on_it]
        known = [values for values in functions if values is not None]
        if len(known) < len(functions):
            if session.channels and not session.work.blocking_problem:
                return None
            known = []
        front = session.document.front(slot, *known)
        session.editor.amend(surfaces=session.document.facing(front, slot).surfaces)
        return front

    def _register(self, meshes: dict[str, TriangleMesh]) -> None:
        if meshes == self._meshes and [*meshes] == [*self._meshes]:
            return
        gone = [name for name, mesh in self._meshes.items() if meshes.get(name) is not mesh]
        for name in gone:
            ps.remove_surface_mesh(name)
            self.paints.pop(name, None)
        if gone:
            self.overlays.clear()
        for name, mesh in meshes.items():
            if name in gone or name not in self._meshes:
                # else a pick near a vertex or an edge has no face
                surfaces.register(name, mesh).set_selection_mode("faces_only")
        self._meshes, self._style = meshes, None
        self._placing.placed.clear()

    def _restyle(self) -> None:
        view, scale = self._session.view, self.view.scale
        edges = dict.fromkeys(self._meshes, 0.0)
        if view.wireframe:
            for name, mesh in self._meshes.items():
                edges[name] = surfaces.edge_width(len(mesh.faces), scale)
        style = (edges, view.flat, view.theme)
        if style != self._style:
            self._style = style
            for name, width in edges.items():
                surfaces.set_style(name, width, view.flat, view.theme)

    @property
    def _has_one_surface(self) -> bool:
        return len(self._session.document.surfaces) == 1

    @property
    def _viewport(self) -> Viewport:
        return viewport(self._session.surface().mesh)

    def _fitted(self, slot: str) -> Fitted:
        slot = "advected" if self._has_one_surface else slot
        surface, known = self._session.surface(slot), self._fits.get(slot)
        assert surface.front is not None
        if known is None or (known.mesh, known.front) != (surface.mesh, surface.front):
            known = self._fits[slot] = Fitted(surface.mesh, surface.front, self._turns)
        return known

    def _look(self, rect: Rect) -> None:
        view, viewpoint, fitted = self._session.view, self.viewpoint, self._fitted("advected")
        assert viewpoint is not None
        left, top, right, bottom = rect
        free = (left, top, right, max(bottom - self.room_below, top + 1))
        names = (view.enlarged,) if view.enlarged in self.names else self.names
        other = self._fitted("source")
        width, height = np.maximum(fitted.fit.shape, other.fit.shape).tolist()
        places = slots(names, free, (width, height), view.layout, self.name_height)
        zoom, target = viewpoint.zoom, viewpoint.target
        if self._turns:
            zoom, target = 1.0, None
        drawn = None if target is None else self._viewport.drawn(np.array(target))
        self.view, self._views = fitted.fit.view(places, viewpoint.front, zoom, drawn), {}
        if not self._has_one_surface:
            self._views["source"] = self.view.seen_alike(fitted.front, other.fit, other.front)

    def _place(self) -> None:
        if not self.names:
            return
        transforms = {}
        for name in self.shown:
            transform = self.view_of(name).matrix(name, ps.get_window_size(), self.view.scale)
            if self._turns:
                axis = self._fitted("source" if name in self._views else "advected").axis
                transform[:3, :3] @= rotation(axis, np.radians(self._degrees))
            transforms[name] = transform
        if "advected" in transforms:
            self.overlays.look(unit(transforms["advected"][:3, :3]))
        placed = [(name, name, ps.get_surface_mesh(name)) for name in self.names]
        self._placing.place(self.view, transforms, [*placed, *self.overlays.structures()])


@dataclass(frozen=True)
class DrawnMark:
    """A landmark in the window: as it was placed on a side, and can be moved, or where a flow has
    brought it. A goal is drawn as a ring, which leaves room for what comes there.
    """

    surface: str
    side: Side | None
    number: int  # from 0
    place: Place
    is_goal: bool


Link = tuple[Place, Place, FloatArray]
"""Both ends in the window, and a colour (3,)."""


@dataclass(frozen=True, eq=False)
class Links:
    """Points of A, where they are on B, the normals there, and colours by where they start, each
    (P, 3).
    """

    starts: FloatArray
    ends: FloatArray
    normals: FloatArray
    colors: FloatArray

    @classmethod
    def between(cls, a: TriangleMesh, b: TriangleMesh, origins: FloatArray) -> Links:
        """Choose vertices of B evenly; their origins (V_B, 3) are on A."""
        chosen = np.unique(b.faces[evenly_spread(b)][:, 0])
        colors = place_colors(a.vertices, origins[chosen]) ** (1 / 2.2)  # as screens have them
        return cls(origins[chosen], b.vertices[chosen], vertex_normals(b)[chosen], colors)


def _inside(places: FloatArray, rect: Rect) -> NDArray[np.bool_]:
    left, top, right, bottom = rect
    x, y = places[:, 0], places[:, 1]
    return (left < x) & (x < right) & (top < y) & (y < bottom)


class Fitted:
    """How large a mesh is from its front, and the axis about which it turns upright."""

    def __init__(self, mesh: TriangleMesh, front: Front, turns: bool) -> None:
        self.mesh, self.front = mesh, front
        up = front.axes[1]
        upright = int(np.argmax(np.abs(up)))
        self.axis: FloatArray = np.sign(up[upright]) * np.eye(3)[upright]
        extent = _rims(mesh, self.axis) if turns else mesh.vertices
        self.fit = Fit(viewport(mesh).drawn(extent), front)


def _rims(mesh: TriangleMesh, axis: FloatArray) -> FloatArray:
    """Points (2 n, 3) of both rims of the cylinder in which a mesh turns about an axis."""
    middle = viewport(mesh).center
    along = (mesh.vertices - middle) @ axis
    radius = np.linalg.norm(mesh.vertices - middle - along[:, None] * axis, axis=1).max()
    first = np.roll(axis, 1)
    angles = np.linspace(0, 2 * np.pi, _POINTS_OF_A_RIM, endpoint=False)[:, None]
    circle = radius * (np.cos(angles) * first + np.sin(angles) * np.cross(axis, first))
    return np.concatenate([middle + circle + end * axis for end in (along.min(), along.max())])


_Side = tuple[int, float, int]  # across x or y (0, 1), at pixels, and which side of it is kept


class Placing:
    """Gives structures the transform of their slot, and planes at its sides if clipped."""

    def __init__(self) -> None:
        # names: a handle that outlives its plane spoils later ones at its address
        self._planes: list[str] = []
        self._sides: list[_Side] = []
        self._seen: object = None
        self.placed: set[str] = set()  # structures that need not be told again

    def place(
        self, view: SlotView, transforms: Mapping[str, FloatArray], structures: Iterable[Placed]
    ) -> None:
        """Give each structure the transform (4, 4) of its surface."""
        window = ps.get_window_size()
        arrays = (view.rotation, view.target, *transforms.values())
        seen = (window, view.scale, *view.slots.items(), *(array.tobytes() for array in arrays))
        if seen != self._seen:
            self._seen = seen
            self.placed.clear()
            # in parallel projection along z, the window's middle at 0
            half, radius = window[1] / (2 * view.scale), view.radius
            ps.set_view_projection_mode("orthographic")
            ps.set_length_scale(radius)  # it sees 20 times as far, and twice as high
            ps.set_vertical_fov_degrees(float(np.degrees(2 * np.arctan(half / (2 * radius)))))
            ps.look_at_dir((0.0, 0.0, _VIEWER_DISTANCE * radius), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0))
            self._place_planes(view, window)
        for surface, name, structure in structures:
            if name in self.placed:
                continue
            self.placed.add(name)
            structure.set_enabled(surface in view.slots)
            if surface not in view.slots:
                continue
            structure.set_transform(transforms[surface])
            kept = _sides(view, surface)
            for plane, side in zip(self._planes, self._sides, strict=False):
                ignored = side not in kept
                if structure.get_ignore_slice_plane(plane) != ignored:
                    structure.set_ignore_slice_plane(plane, ignored)

    def _place_planes(self, view: SlotView, window: tuple[int, int]) -> None:
        sides = [side for name in view.slots for side in _sides(view, name)]
        self._sides = [*dict.fromkeys(sides)] if view.is_clipped else []
        while len(self._planes) < len(self._sides):
            plane = ps.add_slice_plane()
            plane.set_draw_plane(False)
            plane.set_draw_widget(False)
            self._planes.append(plane.get_name())
        for number, name in enumerate(self._planes):
            plane, is_used = ps.get_slice_plane(name), number < len(self._sides)
            if plane.get_active() != is_used:
                plane.set_active(is_used)
            if is_used:
                axis, at, sign = self._sides[number]
                position, normal = [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]
                position[axis] = float(view.drawn((at, at), window)[axis])
                normal[axis] = float(sign)
                plane.set_pose(position, normal)


def _sides(view: SlotView, name: str) -> tuple[_Side, ...]:
    left, top, right, bottom = view.slots[name].rect
    return (0, left, 1), (0, right, -1), (1, top, -1), (1, bottom, 1)
