"""The scene: the surfaces of a session, each drawn in its slot of the window."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

import abfm
from abfm import TriangleMesh
from abfm.display import BEST_VIEW
from abfm.pages.colormaps import place_colors
from abfm.pages.front import Front, triple
from abfm.types import FloatArray
from abfm_viewer.appearance import theme
from abfm_viewer.computing.background import Memo
from abfm_viewer.document.document import SIDES, Document, InitialMap, Point, Side, Viewpoint
from abfm_viewer.document.kinds import PairDocument
from abfm_viewer.scene import opengl, surfaces
from abfm_viewer.scene.opengl import ps
from abfm_viewer.scene.overlays import Overlays, PlacedStructure, evenly_spread
from abfm_viewer.scene.pacing import Pacing
from abfm_viewer.scene.slots import Fit, Place, SlotView, rotation, slots
from abfm_viewer.scene.surfaces import Viewport, viewport
from abfm_viewer.shown.landmarks import LandmarkPoints
from abfm_viewer.shown.paint import Paint, Painter
from abfm_viewer.shown.quantities import FIELD_COLORINGS
from abfm_viewer.shown.ribbons import unit, vertex_normals
from abfm_viewer.shown.shown import Shown
from abfm_viewer.widgets.widget_record import Rect

# Distance of the viewer, in radii of a surface; parts of it may be two radii in front of its slot.
_VIEWER_DISTANCE = 4.0
_RIM_POINTS = 32
# cosine between the fronts of A from which a new map turns A, so that small changes do not
_SAME_SIDE_COSINE = 0.7
LANDMARK_RADIUS = 9.0  # radius of landmarks, in pixels at a scale of 1
FAINT_TEXT = "faint: the data do not determine the motion"
NO_VALUE = "no value"  # text for grey in the legend


@dataclass(frozen=True, eq=False)
class Hit:
    """A point of a surface below the mouse, and the nearest corner of its face."""

    surface: str
    point: Point
    vertex: int


class Scene:
    """The surfaces of a session, each drawn in its slot, a rectangle of the window.

    `names` are the names of all surfaces, `shown` those with a slot. With ``turns``, surfaces are
    so small that they can turn about their upright axes within their slots.
    """

    def __init__(self, shown: Shown, turns: bool = False) -> None:
        self._shown, self._session = shown, shown.session
        self._turns = turns
        # replaced if the backend cannot pick
        self.pick: Callable[[Place], Hit | None] = self._picked
        self.view: SlotView  # set as soon as there are names
        self.paints: dict[str, Paint] = {}
        self.painter = Painter(shown)
        self._links = Memo[Links]()
        self._placing = Placing()
        self.overlays = Overlays(shown, self._placing.placed.discard)
        self.pacing = Pacing(shown.session)
        self.name_height = 0.0  # in each slot, in pixels
        self.bars_height = 0.0  # of the colour bars below all slots, in pixels
        self.pixels = 1.0  # per pixel at a scale of 1
        self._meshes: dict[str, TriangleMesh] = {}
        self._fits: dict[str, Fitted] = {}  # by the name of the surface
        self._views: dict[str, SlotView] = {}
        self._style: object = None
        self._document: Document | None = None
        self._changed = False  # whether a change by the user is not yet drawn
        self._degrees = 0.0
        self._seen_map: InitialMap | None = None  # by which A's front was chosen
        opengl.clear()

    def update(self, rect: Rect) -> None:
        """Update all structures of polyscope for the next frame, with surfaces within ``rect``."""
        session, view = self._session, self._session.view
        session.draws_quickly = self.pacing.draws_quickly
        ground = theme.palette(view.theme).ground
        ps.set_background_color([*theme.linear(ground), 1.0])
        has_fronts = self.choose_fronts()
        # nothing is shown until the front is known, because the surfaces would then turn
        names = view.shown_surfaces if has_fronts else ()
        paints = {name: self.painter.paint(name) for name in names}
        own = {name: session.surface(name).mesh for name in names}  # values may be on a finer one
        self._register(
            {name: (paint and paint.mesh) or own[name] for name, paint in paints.items()}
        )
        if not has_fronts:
            return
        self._update_views(rect)
        self._restyle()
        overlays_wait = self._paint(paints)
        earlier, self._document = self._document, session.document
        # changes by the user are drawn without a wait
        self._changed = self._changed or earlier is not session.document
        if self._changed or not overlays_wait:
            of_flow = earlier is None or earlier.view is not view or not self.pacing.is_beginning
            scale = self.view.scale / self.pixels
            self.overlays.update(self._meshes, self.paints, of_flow, scale)
            self._changed = False
        self._place()

    def _paint(self, paints: Mapping[str, Paint | None]) -> bool:
        """Paint the shown surfaces; return whether the advected one keeps its earlier colours."""
        advected_waits = False
        for name in self.shown:
            paint, before = paints[name], self.paints.get(name)
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
        """Names of the surfaces with a slot in this frame: all, or only the enlarged one."""
        return tuple(name for name in self.names if name in self.view.slots)

    @property
    def outdated(self) -> tuple[str, ...]:
        """Names of the shown surfaces that still show an earlier result."""
        is_behind = self._shown.is_behind
        return tuple(name for name in self.shown if is_behind and name in ("advected", "error"))

    @property
    def viewpoint(self) -> Viewpoint | None:
        """The current viewpoint; None while the front view of the surfaces is not yet chosen."""
        if viewpoint := self._session.view.viewpoint:
            return viewpoint
        return Viewpoint(front) if (front := self._session.surface().front) else None

    def turn(self, degrees: float) -> None:
        """Turn all surfaces about their upright axes; clicks are then located wrongly."""
        self._degrees = degrees
        self._place()

    def set_view(self, view: SlotView) -> None:
        """Set the session's viewpoint to that of a view, without an undo step."""
        before = self.viewpoint
        assert before is not None
        target = before.target
        if view.target is not self.view.target:
            is_centred = np.allclose(view.target, view.centre, rtol=0, atol=1e-9 * view.radius)
            target = None if is_centred else triple(self._viewport.undrawn(view.target))
        viewpoint = Viewpoint(
            Front(triple(view.rotation[2]), triple(view.rotation[1])), view.zoom, target
        )
        if viewpoint != before:
            self._session.editor.amend(view=replace(self._session.view, viewpoint=viewpoint))

    def common_viewpoint(self, name: str, viewpoint: Viewpoint) -> Viewpoint:
        """Return the viewpoint of all surfaces that shows one of them from the given viewpoint.

        The viewpoint of all surfaces is relative to the front of each.
        """
        if name not in self._views:
            return viewpoint
        source, common, target = self._fitted("source"), self._fitted("advected"), viewpoint.target
        drawn = None if target is None else viewport(source.mesh).drawn(np.array(target))
        of_source = source.fit.view(self.view.slots, viewpoint.front, viewpoint.zoom, drawn)
        view = of_source.transferred(source.front, common.fit, common.front)
        front = Front(triple(view.rotation[2]), triple(view.rotation[1]))
        moved = None if target is None else triple(self._viewport.undrawn(view.target))
        return Viewpoint(front, view.zoom, moved)

    def links(self) -> list[Link]:
        """Return the visible lines from points of A to their images on B at the shown time."""
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
        """Return the kinds of critical points with tracks, and explanations of faint and grey."""
        kinds = tuple(self._shown.tracks.counts()) if "advected" in self.shown else ()
        view = self._session.view
        is_of_field = view.arrows or view.streaks or view.coloring in FIELD_COLORINGS
        if is_of_field and "advected" in self.shown:
            kinds = kinds if self._shown.quantities.determined() is None else (*kinds, FAINT_TEXT)
        paints = [self.paints[name] for name in self.shown if name in self.paints]
        is_missing = any(paint.unknown is not None for paint in paints)
        return (*kinds, NO_VALUE) if is_missing else kinds

    def landmarks(self) -> list[DrawnLandmark]:
        """Return the visible landmarks, with their positions in the window."""
        found: list[DrawnLandmark] = []
        for name in self.shown:
            side: Side = "source" if name == "source" else "target"
            is_placed = name in SIDES
            placed = self._shown.landmarks.placed(side)
            found += self._drawn_landmarks(name, side, placed, not is_placed)
            if name == "advected":
                moved = self._shown.landmarks.moved()
                found += self._drawn_landmarks(name, None, moved, False)
        return found

    def landmark_at(self, place: Place) -> DrawnLandmark | None:
        reach = LANDMARK_RADIUS * self.pixels
        near = [
            (math.dist(landmark.place, place), landmark)
            for landmark in self.landmarks()
            if landmark.side is not None and math.dist(landmark.place, place) <= reach
        ]
        return min(near, key=lambda one: one[0])[1] if near else None

    def _drawn_landmarks(
        self, name: str, side: Side | None, points: LandmarkPoints | None, is_goal: bool
    ) -> list[DrawnLandmark]:
        if points is None or self._session.surface(name).mesh is not points.mesh:
            return []
        at, axes = self.projected(name, points.places)[:, :2], self.view_of(name).rotation
        hidden = self._shown.landmarks.hidden(name, side, points, axes)
        visible = _inside(at, self.view.slots[name].rect) & ~hidden
        return [
            DrawnLandmark(name, side, number, (float(x), float(y)), is_goal)
            for number, (x, y), is_visible in zip(points.numbers, at, visible, strict=True)
            if is_visible
        ]

    def projected(self, name: str, points: FloatArray) -> FloatArray:
        """Return window positions in pixels and depths, (P, 3), of a surface's points (P, 3)."""
        drawn = viewport(self._meshes[name]).drawn(np.atleast_2d(points))
        return self.view_of(name).projected(name, drawn)

    def view_of(self, name: str) -> SlotView:
        """Return the view of a surface: the common view, relative to the surface's front."""
        return self._views.get(name, self.view)

    def covers(self, name: str, place: Place) -> bool:
        """Return whether a surface covers a position in the window, computed from its faces."""
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
        # a finer mesh has the children of each face one after another
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

    def choose_fronts(self) -> bool:
        """Choose missing fronts; return False until the functions that determine them are known."""
        session, document = self._session, self._session.document
        if document.surface().front is None:
            sides = (side for side in SIDES if session.surface(side) is document.surface())
            functions = [session.values(side) for side in sides]
            known = [values for values in functions if values is not None]
            if len(known) < len(functions):
                if session.channels and not session.work.blocking_problem:
                    return False
                known = []
            session.editor.amend(surfaces=document.facing(BEST_VIEW, *known).surfaces)
        if isinstance(document := session.document, PairDocument):
            self._turn_to_corresponding_side(document)
        return True

    def _turn_to_corresponding_side(self, document: PairDocument) -> None:
        """Show A from the side of B, by the latest map; small differences do not turn it."""
        initial, work = document.initial_map, self._session.work
        if initial is None and not work.busy and (prepared := work.prepared) is not None:
            initial = prepared.initial
        before = document.surfaces[0].front
        if before is not None and (initial is None or initial is self._seen_map):
            return
        self._seen_map, turned = initial, document.with_corresponding_front(initial)
        after = turned.surfaces[0].front
        is_same = before and after and np.dot(before.direction, after.direction) > _SAME_SIDE_COSINE
        if not is_same:
            self._session.editor.amend(surfaces=turned.surfaces)

    def _register(self, meshes: dict[str, TriangleMesh]) -> None:
        if meshes == self._meshes and [*meshes] == [*self._meshes]:
            return
        removed = [name for name, mesh in self._meshes.items() if meshes.get(name) is not mesh]
        for name in removed:
            ps.remove_surface_mesh(name)
            self.paints.pop(name, None)
        if removed:
            self.overlays.clear()
        for name, mesh in meshes.items():
            if name in removed or name not in self._meshes:
                # by default a pick near a vertex or an edge has no face
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

    def _update_views(self, rect: Rect) -> None:
        view, viewpoint, fitted = self._session.view, self.viewpoint, self._fitted("advected")
        assert viewpoint is not None
        left, top, right, bottom = rect
        free = (left, top, right, max(bottom - self.bars_height, top + 1))
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
            self._views["source"] = self.view.transferred(fitted.front, other.fit, other.front)

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
            self.overlays.update_arrows(unit(transforms["advected"][:3, :3]))
        placed = [(name, name, ps.get_surface_mesh(name)) for name in self.names]
        self._placing.place(self.view, transforms, [*placed, *self.overlays.structures()])


@dataclass(frozen=True)
class DrawnLandmark:
    surface: str
    side: Side | None  # of a placed point, which can be moved; None for one moved by the flow
    number: int  # from 0
    place: Place
    is_goal: bool  # drawn as a ring, around the point that the flow should move there


Link = tuple[Place, Place, FloatArray]  # both ends of a line in the window, and its colour (3,)


@dataclass(frozen=True, eq=False)
class Links:
    starts: FloatArray  # on A
    ends: FloatArray  # on B
    normals: FloatArray  # of B at the ends
    colors: FloatArray  # by the position of the starts

    @classmethod
    def between(cls, a: TriangleMesh, b: TriangleMesh, origins: FloatArray) -> Links:
        """Return links from vertices of B to their points of A, which are ``origins`` (V_B, 3)."""
        chosen = np.unique(b.faces[evenly_spread(b)][:, 0])
        colors = place_colors(a.vertices, origins[chosen]) ** (1 / 2.2)  # sRGB
        return cls(origins[chosen], b.vertices[chosen], vertex_normals(b)[chosen], colors)


def _inside(places: FloatArray, rect: Rect) -> NDArray[np.bool_]:
    left, top, right, bottom = rect
    x, y = places[:, 0], places[:, 1]
    return (left < x) & (x < right) & (top < y) & (y < bottom)


class Fitted:
    """The extent of a mesh seen from its front, and the upright axis about which it turns."""

    def __init__(self, mesh: TriangleMesh, front: Front, turns: bool) -> None:
        self.mesh, self.front = mesh, front
        up = front.axes[1]
        upright = int(np.argmax(np.abs(up)))
        self.axis: FloatArray = np.sign(up[upright]) * np.eye(3)[upright]
        extent = _rims(mesh, self.axis) if turns else mesh.vertices
        self.fit = Fit(viewport(mesh).drawn(extent), front)


def _rims(mesh: TriangleMesh, axis: FloatArray) -> FloatArray:
    """Return points (2 n, 3) on both rims of the cylinder in which a mesh turns about an axis."""
    middle = viewport(mesh).centre
    along = (mesh.vertices - middle) @ axis
    radius = np.linalg.norm(mesh.vertices - middle - along[:, None] * axis, axis=1).max()
    first = np.roll(axis, 1)
    angles = np.linspace(0, 2 * np.pi, _RIM_POINTS, endpoint=False)[:, None]
    circle = radius * (np.cos(angles) * first + np.sin(angles) * np.cross(axis, first))
    return np.concatenate([middle + circle + end * axis for end in (along.min(), along.max())])


_Side = tuple[int, float, int]
"""A side of a slot: axis (0 or 1), position in pixels, and sign of the direction inwards."""


class Placing:
    """Transforms that move structures into their slots, and slice planes that clip them there."""

    def __init__(self) -> None:
        # names instead of handles: a handle of a removed plane can damage a plane at its address
        self._planes: list[str] = []
        self._sides: list[_Side] = []
        self._inputs: object = None
        self.placed: set[str] = set()  # names of structures with an up-to-date transform

    def place(
        self,
        view: SlotView,
        transforms: Mapping[str, FloatArray],
        structures: Iterable[PlacedStructure],
    ) -> None:
        window = ps.get_window_size()
        arrays = (view.rotation, view.target, *transforms.values())
        inputs = (window, view.scale, *view.slots.items(), *(array.tobytes() for array in arrays))
        if inputs != self._inputs:
            self._inputs = inputs
            self.placed.clear()
            # parallel projection along z, with the origin in the middle of the window
            half, radius = window[1] / (2 * view.scale), view.radius
            ps.set_view_projection_mode("orthographic")
            ps.set_length_scale(radius)  # depths of 20 and heights of 2 such lengths are visible
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
            clipping = _sides(view, surface)
            for plane, side in zip(self._planes, self._sides, strict=False):
                ignored = side not in clipping
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
