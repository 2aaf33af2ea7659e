"""What can be told of the field and its flow besides the advected function; all computed off the frame loop."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from abfm.mesh import TriangleMesh
from abfm.types import FloatArray, IntArray
from abfm_viewer.appearance.colormaps import ColorRange
from abfm_viewer.computing.background import Latest
from abfm_viewer.document.document import EXTRAPOLATION, HODGE_PARTS, FieldPart, Point
from abfm_viewer.shown.carried import FlowState, Same
from abfm_viewer.shown.map_quantities import flow_distortion, flow_quality
from abfm_viewer.shown.related_fields import carried_gradient, commuting

if TYPE_CHECKING:
    from abfm.flow.flow_lines import FlowLine
    from abfm.maps.quality import MapQuality
    from abfm.maps.surface_points import Distortion
    from abfm.streaks.texels import FloatImage
    from abfm.streaks.texture_atlas import TextureAtlas
    from abfm_viewer.session.session import Session

_TEXELS, _TEXELS_OF_PICTURES = 1024, 2048  # along a side; fewer in the window, where textures change while one looks
_LEAST_TEXELS_PER_FACE = 12
_MOST_TEXELS = 16384
_PHASES = 16  # of moving streaks that are computed; those between are blended
_SHOWN_PHASES = 32  # in the window
_EXACT = 1e-6


@dataclass(frozen=True, eq=False)
class Field:
    """One part of one of the flow's fields, or a field that belongs to it.

    Attributes
    ----------
    velocity : (F, 3) array
        In the input's units.
    speed : (F,) array
    shares : dict of FieldPart to float
        Of the squared norm of the whole field, for each Helmholtz-Hodge part; empty where these were not asked for.
    unit : str
        Of the speed.
    note : str
        What else is to be said, if anything.
    dimension : int
        The power of a length in that unit.
    """

    mesh: TriangleMesh
    velocity: FloatArray
    speed: FloatArray
    shares: dict[FieldPart, float] = field(default_factory=dict)
    unit: str = "the mesh's length per time"
    note: str = ""
    dimension: int = 1


@dataclass(frozen=True, eq=False)
class Streaks:
    """Grey textures (P, size, size), from 0 to 255, with streaks along a field, and the atlas that says what is where.

    More than one show phases of the streaks' way along the field.
    """

    field: Field
    atlas: TextureAtlas
    images: NDArray[np.uint8]

    def at(self, phase: float) -> NDArray[np.uint8]:
        """The texture of a phase from 0 to 1."""
        place = phase % 1 * len(self.images)
        before, share = int(place), place % 1
        first: NDArray[np.uint8] = self.images[before % len(self.images)]
        if share < _EXACT or len(self.images) == 1:
            return first
        second = self.images[(before + 1) % len(self.images)]
        blended: NDArray[np.float32] = np.float32(1 - share) * first + np.float32(share) * second
        return (blended + np.float32(0.5)).astype(np.uint8)


@dataclass(frozen=True, eq=False)
class Texture:
    """Colours (size, size, 3), linear light, and where the faces' corners lie in them, (3F, 2)."""

    streaks: Streaks
    colors: FloatImage
    corners: FloatArray


class FieldQuantities:
    """Answers with what was computed last for the same view, and None before there is anything."""

    def __init__(self) -> None:
        self._field: Latest[Field] = Latest("field")
        self._scalar: Latest[FloatArray] = Latest("field values")
        self._distortion: Latest[Distortion] = Latest("distortion")
        self._quality: Latest[tuple[TriangleMesh, MapQuality]] = Latest("map's quality")
        self._streaks: Latest[Streaks] = Latest("streaks")
        self._texture: Latest[Texture] = Latest("coloured streaks")
        self._lines: Latest[list[FlowLine]] = Latest("flow lines")
        self._paths: Latest[list[FlowLine]] = Latest("paths")
        self._services: Sequence[Latest[object]] = (
            self._field,
            self._scalar,
            self._distortion,
            self._quality,
            self._streaks,
            self._texture,
            self._lines,
            self._paths,
        )  # type: ignore[assignment]

    @property
    def error(self) -> str:
        """What could not be computed, in one line; empty if all could."""
        return next((service.error for service in self._services if service.error), "")

    @property
    def busy(self) -> bool:
        """Whether something is still to come."""
        return any(service.busy for service in self._services)

    @property
    def finding(self) -> bool:
        """Whether the field that the view asks for is still to come."""
        return self._field.busy

    @property
    def convolving(self) -> bool:
        """Whether streaks that the view asks for are still to come."""
        return self._streaks.busy

    def field(self, session: Session) -> Field | None:
        """The part of the field that the view asks for, at the shown time."""
        flow = session.shown.flow
        if flow is None:
            return None
        segment = _segment(flow, session.shown.time)
        part = session.view.part
        source, time = session.values("source"), session.shown.time
        if part != "carried gradient":
            found = self._field.ask((flow, segment, part), partial(_field, flow, segment, part))
        elif source is None:
            return None
        else:
            found = self._field.ask((flow, time, part, Same(source)), partial(_carried, flow, source, time))
        stale = self._field.value
        return found or (stale if stale is not None and stale.mesh is session.mesh else None)

    def scalar(self, session: Session) -> FloatArray | None:
        """Divergence or curl of the field at the vertices, (V,)."""
        field, kind = self.field(session), session.view.coloring
        if field is None:
            return None
        found = self._scalar.ask((field, kind), partial(_scalar, field, kind))
        stale = self._scalar.value
        return found if found is not None else stale if stale is not None and _fits(stale, session) else None

    def distortion(self, session: Session) -> Distortion | None:
        """Distortion of the flow's map at the shown time."""
        flow, time = session.shown.flow, session.shown.time
        if flow is None:
            return None
        found = self._distortion.ask((flow, time), partial(flow_distortion, flow, time))
        stale = self._distortion.value
        fits = stale is not None and len(stale.area) == len(session.mesh.faces)
        return found or (stale if fits else None)

    def map_quality(self, session: Session) -> MapQuality | None:
        """Whether what is shown of the flow as a map can be trusted: where values came from, or where faces go."""
        flow, time = session.shown.flow, session.shown.time
        if flow is None:
            return None
        time = -time if session.view.coloring in ("area distortion", "conformal distortion") else time
        found = self._quality.ask((flow, time), partial(flow_quality, flow, time)) or self._quality.value
        return found[1] if found is not None and found[0] is session.mesh else None

    def texture(self, session: Session, values: FloatArray, colors: ColorRange) -> Texture | None:
        """Streaks along the field, coloured by a function (V,), lately by an earlier one; None before there are any."""
        field = self.field(session)
        if field is None or session.solver.running:
            return None
        view = session.view
        streaks = self._streaks.ask((field, view.fade, view.animate), partial(_streaks, field, view.fade, view.animate))
        if streaks is None:
            streaks = self._streaks.value
            if streaks is None or streaks.field is not field:
                return None
        phase = 0.0 if len(streaks.images) == 1 else session.player.phase
        if not Latest.at_once:
            phase = round(phase * _SHOWN_PHASES) / _SHOWN_PHASES
        key = (streaks, id(values), colors, phase)
        found = self._texture.ask(key, partial(_texture, streaks, phase, values, colors))
        stale = self._texture.value
        return found or (stale if stale is not None and stale.streaks.field is field else None)

    def lines(self, session: Session) -> list[FlowLine]:
        """Flow lines through the points that were clicked on: against the flow for tau, and with it for tau."""
        field, points = self.field(session), session.document.lines
        if field is None or not points:
            return []
        assert session.shown.flow is not None
        tau = session.shown.flow.parameters.tau
        found = self._lines.ask((field, points, tau), partial(_lines, field, points, tau))
        return found or []

    def paths(self, session: Session) -> list[FlowLine]:
        """The ways of the points that are followed, to the end of the time bar."""
        flow, points = session.shown.flow, session.document.points
        if flow is None or not points:
            return []
        return self._paths.ask((flow, points), partial(_paths, flow, points)) or []

    def close(self) -> None:
        """Stop the threads."""
        for service in self._services:
            service.close()


def _fits(values: FloatArray, session: Session) -> bool:
    return len(values) == len(session.mesh.vertices)


def _segment(flow: FlowState, time: float) -> int:
    """Which of N fields acts at a time."""
    count = flow.parameters.segments
    return min(int(time / flow.parameters.tau * count * (1 - 1e-12)), count - 1)


def _field(flow: FlowState, segment: int, part: FieldPart) -> Field:
    velocity = flow.velocity[segment]
    shares: dict[FieldPart, float] = {}
    note = ""
    if part == "commuting":
        velocity, bracket = commuting(flow, segment)
        note = f"norm of the bracket relative to both fields: {bracket:.3g}, 0 if they commute"
    elif part != "whole":
        from abfm.calculus.helmholtz_hodge import helmholtz_hodge
        from abfm.calculus.operators import face_areas

        parts = dict(zip(HODGE_PARTS, helmholtz_hodge(flow.mesh, velocity), strict=True))
        norms = {name: float(face_areas(flow.mesh) @ (v**2).sum(axis=1)) for name, v in parts.items()}
        shares = {name: norm / max(sum(norms.values()), 1e-300) for name, norm in norms.items()}
        velocity = parts[part]
    return Field(flow.mesh, velocity, np.linalg.norm(velocity, axis=1), shares, note=note)


def _carried(flow: FlowState, function: FloatArray, time: float) -> Field:
    velocity = carried_gradient(flow, function, time)
    return Field(
        flow.mesh, velocity, np.linalg.norm(velocity, axis=1), unit="the source's unit per length", dimension=-1
    )


def _scalar(field: Field, kind: str) -> FloatArray:
    from abfm.calculus.operators import curl, divergence
    from abfm.calculus.vector_fields import to_frame

    operator = divergence(field.mesh) if kind == "divergence" else curl(field.mesh)
    return np.asarray(operator @ to_frame(field.mesh, field.velocity).ravel())


def _streaks(field: Field, fade: bool, moving: bool) -> Streaks:
    from abfm.streaks.line_integral import line_integral_convolution

    size = _TEXELS_OF_PICTURES if Latest.at_once else _TEXELS
    size = min(max(size, int(np.sqrt(_LEAST_TEXELS_PER_FACE * len(field.mesh.faces)))), _MOST_TEXELS)
    phases = np.arange(_PHASES) / _PHASES if moving else None
    atlas, images = line_integral_convolution(field.mesh, field.velocity, size=size, fade=fade, phase=phases)
    return Streaks(field, atlas, np.stack([_in_steps(image) for image in images.reshape(-1, size, size)]))


def _in_steps(image: FloatImage) -> NDArray[np.uint8]:
    return (255 * image + np.float32(0.5)).astype(np.uint8)


def _texture(streaks: Streaks, phase: float, values: FloatArray, colors: ColorRange) -> Texture:
    from abfm_viewer.shown.streak_texture import streak_texture

    texture = streak_texture(streaks.atlas, streaks.at(phase), values, colors)
    return Texture(streaks, texture, streaks.atlas.corner_coordinates)


@dataclass(frozen=True, eq=False)
class _Starts:
    faces: IntArray
    barycentric: FloatArray


def _starts(points: tuple[Point, ...]) -> _Starts:
    return _Starts(np.array([p.face for p in points]), np.array([p.barycentric for p in points]))


def _lines(field: Field, points: tuple[Point, ...], tau: float) -> list[FlowLine]:
    from abfm.flow.flow_lines import flow_lines

    starts = _starts(points)
    return [line for time in (-tau, tau) for line in flow_lines(field.mesh, field.velocity, starts, time)]


def _paths(flow: FlowState, points: tuple[Point, ...]) -> list[FlowLine]:
    from abfm.flow.flow_lines import flow_lines

    tau = flow.parameters.tau
    return flow_lines(flow.mesh, flow.velocity, _starts(points), EXTRAPOLATION * tau, tau)
