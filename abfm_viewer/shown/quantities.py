"""Quantities of the flow that is shown: its field, streaks, arrows, lines and maps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray

import abfm
from abfm import AbfmError
from abfm.mesh import TriangleMesh
from abfm.pages.colormaps import ColorRange
from abfm.types import BoolArray, FloatArray
from abfm_viewer import shown
from abfm_viewer.computing.background import Jobs, Latest
from abfm_viewer.document.document import HODGE_PARTS, SIDES, Coloring, FieldPart
from abfm_viewer.document.surface_points import surface_points
from abfm_viewer.session.session import Session
from abfm_viewer.shown.arrows import ArrowLook, Arrows, arrow_spacing, arrows_of
from abfm_viewer.shown.eye import Eye
from abfm_viewer.shown.flow_state import FlowState
from abfm_viewer.shown.shown_flow import ShownFlow

# vertices of a mesh whose commuting fields are computed: twenty seconds, and a gigabyte
_COMMUTING_VERTICES_MAX = 15_000
# along a side; fewer in the window, where textures change while one looks
TEXELS = 1024
_TEXELS_OF_PICTURES = 2048
_LEAST_TEXELS_PER_FACE = 12
_MOST_TEXELS = 16384
_PHASES = 16  # of moving streaks that are computed; those between are blended
_SHOWN_PHASES = 32  # of moving streaks in the window
_SHARE_TOLERANCE = 1e-6
_OF_FIELD: tuple[Coloring, ...] = ("speed", "divergence", "curl")
_SPEED_MAX = 1e30  # that cards know


@dataclass(frozen=True, eq=False)
class Field:
    """A part of the flow's field, or a related one; `shares` are of the squared norm."""

    mesh: TriangleMesh
    velocity: FloatArray  # (F, 3), in the input's units
    speed: FloatArray  # (F,)
    shares: dict[FieldPart, float] = field(default_factory=dict)
    unit: str = "the mesh's length per time"  # of the speed
    of: FloatArray | None = None  # of a film's interval, of whose field it is a part
    part: FieldPart = "whole"
    note: str = ""  # what else is to be said, if anything
    dimension: int = 1  # the power of a length in the unit
    fast: float = 0.0  # of all fields in a row, for arrows' lengths; 0 where they are its own

    def relative_speed(self) -> tuple[FloatArray, str]:
        """Return the speed (F,) with sqrt(area) as the unit of length, and its unit; of a film in
        the mesh's unit, unless graphics cards know no such numbers.
        """
        if self.of is not None and self.speed.max() < _SPEED_MAX:
            return self.speed, self.unit
        unit = self.unit.replace("the mesh's length", "length").replace("length", "sqrt(area)")
        unit = unit.replace("the mesh's unit", "sqrt(area)")
        return self.speed * self.mesh.length_scale**-self.dimension, unit


def field_part(flow: FlowState, segment: int, part: FieldPart) -> Field:
    velocity, shares, note, fast = flow.velocity[segment], {}, "", 0.0
    if part == "whole" and len(flow.velocity) > 1:
        speeds = np.linalg.norm(flow.velocity, axis=2)
        fast = max(abfm.calculus.fast_speed(flow.mesh, speed) for speed in speeds)
    if part == "commuting":
        velocity, bracket = commuting(flow, segment)
        note = f"norm of the bracket relative to both fields: {bracket:.3g}, 0 if they commute"
    elif part != "whole":
        found = abfm.calculus.helmholtz_hodge(flow.mesh, velocity)
        parts = dict(zip(HODGE_PARTS, found, strict=True))
        areas = abfm.calculus.face_areas(flow.mesh)
        norms = {name: float(areas @ (v**2).sum(axis=1)) for name, v in parts.items()}
        shares = {name: norm / max(sum(norms.values()), 1e-300) for name, norm in norms.items()}
        velocity = parts[part]
    speed = np.linalg.norm(velocity, axis=1)
    return Field(flow.mesh, velocity, speed, shares, note=note, fast=fast)


def commuting(flow: FlowState, segment: int) -> tuple[FloatArray, float]:
    """The smoothest field (F, 3) that commutes, and the bracket, or why there is none."""
    if not flow.final:
        raise AbfmError("the field that commutes is computed when the run has ended")
    count = len(flow.mesh.vertices)
    if count > _COMMUTING_VERTICES_MAX:
        raise AbfmError(
            f"commuting fields are computed on up to {_COMMUTING_VERTICES_MAX:,} vertices; this "
            f"mesh has {count:,}"
        )
    velocity = flow.velocity[segment]
    if not velocity.any():
        raise AbfmError("the field is zero, with which every field commutes")
    found = abfm.calculus.commuting_fields(flow.mesh, velocity)[0]
    return found, abfm.calculus.relative_bracket(flow.mesh, velocity, found)


def carried_gradient(flow: FlowState, function: FloatArray, time: float) -> Field:
    """The gradient of a function (V,), carried along the flow's fields to a time."""
    mesh = flow.mesh
    gradient = (abfm.calculus.gradient(mesh) @ function).reshape(-1, 2)
    carried = abfm.calculus.to_ambient(mesh, gradient)
    ends = np.linspace(0, flow.parameters.tau, len(flow.velocity) + 1)
    ends[-1] = max(ends[-1], time)  # beyond tau the last field goes on
    for velocity, start, end in zip(flow.velocity, ends, ends[1:], strict=False):
        if time > start:
            carried = abfm.calculus.pushforward(mesh, velocity, carried, min(end, time) - start)
    speed = np.linalg.norm(carried, axis=1)
    return Field(mesh, carried, speed, unit="the source's unit per length", dimension=-1)


def field_arrows(
    field: Field, look: ArrowLook, eye: Eye, shares: FloatArray | None, interval: int
) -> Arrows:
    determined = None if shares is None else shares[interval]
    return arrows_of(field.mesh, field.velocity, look, eye, determined)


def derivative(field: Field, kind: Coloring) -> FloatArray:
    calculus, mesh = abfm.calculus, field.mesh
    operator = calculus.divergence if kind == "divergence" else calculus.curl
    return np.asarray(operator(mesh) @ calculus.to_frame(mesh, field.velocity).ravel())


@dataclass(frozen=True, eq=False)
class Streaks:
    """Grey textures (P, size, size), 0 to 255, phases of streaks, and their atlas."""

    field: Field
    atlas: abfm.streaks.TextureAtlas
    images: NDArray[np.uint8]
    look: tuple[bool, bool] = (False, False)  # whether they fade, and move

    def at(self, phase: float) -> NDArray[np.uint8]:
        place = phase % 1 * len(self.images)
        before, share = int(place), place % 1
        first: NDArray[np.uint8] = self.images[before % len(self.images)]
        if share < _SHARE_TOLERANCE or len(self.images) == 1:
            return first
        second = self.images[(before + 1) % len(self.images)]
        blended: NDArray[np.float32] = np.float32(1 - share) * first + np.float32(share) * second
        return (blended + np.float32(0.5)).astype(np.uint8)


@dataclass(frozen=True, eq=False)
class Texture:
    """Colours (size, size, 3) in linear light, on the streaks' atlas."""

    streaks: Streaks
    colors: abfm.streaks.FloatImage


def convolved(field: Field, size: int, fade: bool, moving: bool) -> Streaks:
    """Streaks along a field, in textures at least `size` wide, more on meshes with many faces."""
    needed = int(np.sqrt(_LEAST_TEXELS_PER_FACE * len(field.mesh.faces)))
    size = min(max(size, needed), _MOST_TEXELS)
    phases = np.arange(_PHASES) / _PHASES if moving else None
    atlas, images = abfm.streaks.line_integral_convolution(
        field.mesh, field.velocity, size=size, fade=fade, phase=phases
    )
    rounded = [
        (255 * image + np.float32(0.5)).astype(np.uint8) for image in images.reshape(-1, size, size)
    ]
    return Streaks(field, atlas, np.stack(rounded), (fade, moving))


def coloured(
    streaks: Streaks,
    phase: float,
    values: FloatArray,
    colors: ColorRange,
    unknown: BoolArray | None,
) -> Texture:
    image = streaks.at(phase)
    return Texture(streaks, shown.streak_texture(streaks.atlas, image, values, colors, unknown))


class FieldQuantities(Jobs):
    """Answers with what was computed last for the same mesh or field; None before."""

    def __init__(self, session: Session, flow: ShownFlow) -> None:
        super().__init__(session.at_once)
        self._session, self.flow = session, flow
        self._field: Latest[Field] = self.latest()
        self._scalar: Latest[FloatArray] = self.latest()
        self._arrows: Latest[Arrows] = self.latest()
        self._hidden_arrows: Latest[BoolArray] = self.latest()
        self._chords: Latest[abfm.maps.Distortion] = self.latest()
        self._quality: Latest[abfm.maps.FlowMapQuality] = self.latest()
        self._streaks: Latest[Streaks] = self.latest()
        self._texture: Latest[Texture] = self.latest()
        self._lines: Latest[list[abfm.flow.FlowLine]] = self.latest()
        self._paths: Latest[list[abfm.flow.FlowLine]] = self.latest()

    @property
    def finding(self) -> bool:
        return self._field.busy

    @property
    def is_behind(self) -> bool:
        """Return whether the field that the view shows is that of an earlier flow."""
        view, flow, known = self._session.view, self.flow.state, self._field.key
        of_field = view.coloring in _OF_FIELD or view.arrows or view.streaks
        if flow is None or not (of_field and isinstance(known, tuple)):
            return False
        return not any(one is flow for one in known[1])

    @property
    def convolving(self) -> bool:
        return self._streaks.busy

    def field(self) -> Field | None:
        flow, time, part = self.flow.state, self.flow.time, self._session.view.part
        if flow is None:
            return None
        if part == "carried gradient":
            source = self._session.work.flow_values("source")
            if source is None:
                return None
            return self._field.newest(flow.mesh, carried_gradient, flow, source, time)
        last = flow.count - 1
        segment = min(int(time / flow.parameters.tau * flow.count * (1 - 1e-12)), last)
        return self._part(flow, segment, part)

    def _part(self, flow: FlowState, segment: int, part: FieldPart) -> Field | None:
        return self._field.newest(flow.mesh, field_part, flow, segment, part)

    def scalar(self) -> FloatArray | None:
        if (field := self.field()) is None:
            return None
        return self._scalar.newest(field.mesh, derivative, field, self._session.view.coloring)

    def arrows(self, field: Field, scale: float, eye: Eye) -> Arrows | None:
        """Return a field's arrows for an eye that sees so many pixels for a length of sqrt(area),
        lately those of an earlier field or eye; None before there are any.
        """
        view = self._session.view
        if (fast := self.fast(field)) is None:
            return self._arrows.value
        look = ArrowLook(view.arrow_length, arrow_spacing(view.arrow_density, scale), fast)
        how = look, eye, self._determined_shares(), self._session.document.interval
        return self._arrows.newest(field.mesh, field_arrows, field, *how)

    def _determined_shares(self) -> FloatArray | None:
        """Return how well fields are determined, (intervals, F); None before that is known, and of
        fields of which that is not.
        """
        return None

    def fast(self, field: Field) -> float | None:
        """Return what speed counts as fast, 0 for the field's own; None before that is known."""
        return field.fast

    def hidden_arrows(self, arrows: Arrows, eye: Eye) -> BoolArray | None:
        """Tell which arrows the surface hides from an eye, lately from an earlier one, (A,); None
        before that is known of any.
        """
        return self._hidden_arrows.newest(arrows, Arrows.hidden, arrows, eye)

    def map_quality(self) -> abfm.maps.FlowMapQuality | None:
        """Judge the map of the shown time; while that moves, and lately, that of an earlier one."""
        flow, time = self.flow.state, self.flow.time
        if flow is None:
            return None
        known = self._quality.value
        if known is not None and not (self.at_once or self.flow.settled):
            return known if len(known.distortion.flipped) == len(flow.mesh.faces) else None
        return self._quality.newest(flow.mesh, lambda *of: flow.flow.map_quality(time), flow, time)

    def distortion(self) -> abfm.maps.Distortion | None:
        """Measure what the map does to faces; while the time moves by their corners alone."""
        flow, quality = self.flow.state, self.map_quality()
        is_exact = self.at_once or (self.flow.settled and not self._quality.busy)
        if flow is None or (is_exact and quality is not None):
            return quality.distortion if quality else None
        if (places := self.flow.destinations()) is None:
            return quality.distortion if quality else None
        return self._chords.newest(flow.mesh, abfm.maps.chord_distortion, flow.mesh, places)

    def texture(
        self, values: FloatArray, colors: ColorRange, unknown: BoolArray | None = None
    ) -> Texture | None:
        """Return streaks coloured by a function (V,), grey where it is unknown (V,), lately an
        earlier one; None before any.
        """
        field, view = self.field(), self._session.view
        if field is None or self._session.matching.running:
            return None
        about, streaks = self._streaks_of(field, view.fade, view.animate)
        if streaks is None:
            return None
        phase = 0.0 if len(streaks.images) == 1 else self._session.player.phase
        if not self.at_once:
            phase = round(phase * _SHOWN_PHASES) / _SHOWN_PHASES
        return self._texture.newest(about, coloured, streaks, phase, values, colors, unknown)

    def _streaks_of(self, field: Field, fade: bool, moving: bool) -> tuple[object, Streaks | None]:
        """Return streaks along a field, and what the texture is about."""
        size = _TEXELS_OF_PICTURES if self.at_once else TEXELS
        return field, self._streaks.newest(field, convolved, field, size, fade, moving)

    def lines(self) -> list[abfm.flow.FlowLine]:
        """Follow the points that were clicked on, against the flow for tau, and with it."""
        flow, field, points = self.flow.state, self.field(), self._session.document.lines
        if flow is None or field is None or not points:
            return []
        mesh = field.mesh

        def compute() -> list[abfm.flow.FlowLine]:
            tau = flow.line_time
            starts, lines = surface_points(mesh, points), partial(abfm.flow.flow_lines, mesh)
            return [line for t in (-tau, tau) for line in lines(field.velocity, starts, t)]

        about = mesh, points
        return self._lines.newest(about, lambda *_: compute(), field, flow.parameters.tau) or []

    def paths(self) -> list[abfm.flow.FlowLine]:
        """The ways of the points that are followed, to the end of the time bar."""
        flow, points = self.flow.state, self._session.document.points
        if flow is None or not points:
            return []

        def compute() -> list[abfm.flow.FlowLine]:
            starts, fields = surface_points(flow.mesh, points), flow.flow.fine_velocity
            return abfm.flow.flow_lines(
                flow.mesh, fields, starts, flow.duration, flow.parameters.tau
            )

        return self._paths.ask((flow, points), compute) or []

    @property
    def path_time(self) -> float:
        """The shown time as `paths` count it."""
        return self.flow.time

    def starts(self, paths: Sequence[abfm.flow.FlowLine]) -> FloatArray:
        """Return where points that are followed start on the source's surface, (P, 3)."""
        prepared = self._session.work.prepared
        if prepared is None:
            return np.array([path.positions[0] for path in paths])
        faces, weights = zip(*((path.faces[0], path.barycentric[0]) for path in paths), strict=True)
        mesh = self._session.surface().mesh
        on_b = abfm.maps.SurfacePoints(mesh, np.array(faces), np.array(weights))
        return prepared.initial.correspondence.points.at(on_b).positions


class MassTransport(Latest[FloatArray]):
    """Optimal transport between source and target at the shown time, at most tau."""

    def __init__(self, session: Session) -> None:
        super().__init__(session.at_once)
        self._session = session

    @property
    def note(self) -> str:
        """Say what transport leaves out of the functions; nothing if nothing."""
        found = [self._session.work.flow_values(side) for side in SIDES]
        known = [values for values in found if values is not None]
        least = min((float(values.min()) for values in known), default=0.0)
        if least >= 0 or len(known) < len(found) or self.error:
            return ""
        return f"optimal transport takes values below 0, down to {least:.3g}, as 0"

    def values(self) -> FloatArray | None:
        """The interpolation (V,); None before there is any, or where there cannot be."""
        session = self._session
        source, target = session.work.flow_values("source"), session.work.flow_values("target")
        if source is None or target is None:
            return None
        problem = (session.surface().mesh, source, target)
        share = min(session.time / session.document.tau, 1.0)
        transport = partial(abfm.baselines.optimal_transport, sharpen=True)
        return self.newest(problem, transport, *problem, share)
