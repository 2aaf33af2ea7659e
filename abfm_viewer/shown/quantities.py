"""Quantities of the shown flow: fields, streaks, arrows, flow lines and distortion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from operator import attrgetter

import numpy as np
from numpy.typing import NDArray

import abfm
from abfm import AbfmError
from abfm.mesh import TriangleMesh
from abfm.types import BoolArray, FloatArray
from abfm_viewer import shown
from abfm_viewer.computing.background import Jobs, Latest, Memo
from abfm_viewer.document.document import HODGE_PARTS, SIDES, Coloring, FieldPart
from abfm_viewer.document.surface_points import surface_points
from abfm_viewer.session.session import Session
from abfm_viewer.shown.arrows import Arrows, ArrowStyle, arrow_spacing, arrows_of
from abfm_viewer.shown.colored_values import ColoredValues
from abfm_viewer.shown.eye import Eye
from abfm_viewer.shown.flow_state import FlowState
from abfm_viewer.shown.shown_flow import ShownFlow

_COMMUTING_VERTICES_MAX = 15_000  # commuting fields then take 20 s and 1 GB
# texels along a side of a texture; fewer in the window, where textures change often
TEXELS = 1024
_TEXELS_OF_PICTURES = 2048
_TEXELS_PER_FACE_MIN = 12
_TEXELS_MAX = 16384
_PHASES = 16  # computed phases of moving streaks; others are blends of these
_SHOWN_PHASES = 32  # phases of moving streaks that the window distinguishes
_SHARE_TOLERANCE = 1e-6
FIELD_COLORINGS: tuple[Coloring, ...] = ("speed", "divergence", "curl")
_OPACITY_MIN = 0.2  # smallest share of the opacity of arrows and of the contrast of streaks
_SPEED_MAX = 1e30  # largest speed that is shown, because of single precision


@dataclass(frozen=True, eq=False)
class Field:
    """A tangent field to be shown: the flow's field, a part of it, or a related field."""

    mesh: TriangleMesh
    velocity: FloatArray  # (F, 3), in the input's units
    speed: FloatArray  # (F,)
    shares: dict[FieldPart, float] = field(default_factory=dict)  # parts of the squared norm
    unit: str = "the mesh's length per time"  # unit of the speed
    interval_field: FloatArray | None = None  # field of the interval of a sequence
    part: FieldPart = "complete"
    note: str = ""  # for the user
    dimension: int = 1  # exponent of length in the unit
    fast: float = 0.0  # speed of the longest arrows; 0 for `fast_speed` of this field alone

    def relative_speed(self) -> tuple[FloatArray, str]:
        """Return the speed (F,) and its unit, in which length is measured by sqrt(area).

        The speed of a sequence is in the mesh's unit of length, unless it is too large for single
        precision.
        """
        if self.interval_field is not None and self.speed.max() < _SPEED_MAX:
            return self.speed, self.unit
        unit = self.unit.replace("the mesh's length", "length").replace("length", "sqrt(area)")
        unit = unit.replace("the mesh's unit", "sqrt(area)")
        return self.speed * self.mesh.length_scale**-self.dimension, unit


def field_part(flow: FlowState, segment: int, part: FieldPart) -> Field:
    velocity, shares, note, fast = flow.velocity[segment], {}, "", 0.0
    if part == "complete" and len(flow.velocity) > 1:
        speeds = np.linalg.norm(flow.velocity, axis=2)
        fast = max(abfm.calculus.fast_speed(flow.mesh, speed) for speed in speeds)
    if part == "commuting":
        velocity, bracket = commuting(flow, segment)
        note = f"norm of the Lie bracket relative to both fields: {bracket:.3g} (0 if they commute)"
    elif part != "complete":
        found = abfm.calculus.helmholtz_hodge(flow.mesh, velocity)
        parts = dict(zip(HODGE_PARTS, found, strict=True))
        areas = abfm.calculus.face_areas(flow.mesh)
        norms = {name: float(areas @ (v**2).sum(axis=1)) for name, v in parts.items()}
        shares = {name: norm / max(sum(norms.values()), 1e-300) for name, norm in norms.items()}
        velocity = parts[part]
    speed = np.linalg.norm(velocity, axis=1)
    return Field(flow.mesh, velocity, speed, shares, note=note, fast=fast)


def commuting(flow: FlowState, segment: int) -> tuple[FloatArray, float]:
    """Return the smoothest field (F, 3) that commutes with the shown one, number ``segment``.

    The second value is the relative norm of their Lie bracket, 0 if the flows commute.
    """
    if not flow.final:
        raise AbfmError("a commuting field is not computed during a run; wait until it has ended")
    count = len(flow.mesh.vertices)
    if count > _COMMUTING_VERTICES_MAX:
        raise AbfmError(
            f"commuting fields are computed for at most {_COMMUTING_VERTICES_MAX:,} vertices, but "
            f"this mesh has {count:,}"
        )
    velocity = flow.velocity[segment]
    if not velocity.any():
        raise AbfmError("the field is zero, so every field commutes with it")
    found = abfm.calculus.commuting_fields(flow.mesh, velocity)[0]
    return found, abfm.calculus.relative_bracket(flow.mesh, velocity, found)


def pushed_gradient(flow: FlowState, function: FloatArray, time: float) -> Field:
    """Return the gradient of a function (V,), pushed forward along the flow from 0 to a time."""
    mesh = flow.mesh
    gradient = (abfm.calculus.gradient(mesh) @ function).reshape(-1, 2)
    pushed = abfm.calculus.to_ambient(mesh, gradient)
    ends = np.linspace(0, flow.parameters.tau, len(flow.velocity) + 1)
    ends[-1] = max(ends[-1], time)  # beyond tau the last field continues
    for velocity, start, end in zip(flow.velocity, ends, ends[1:], strict=False):
        if time > start:
            pushed = abfm.calculus.pushforward(mesh, velocity, pushed, min(end, time) - start)
    speed = np.linalg.norm(pushed, axis=1)
    return Field(mesh, pushed, speed, unit="the source's unit per length", dimension=-1)


def derivative(field: Field, kind: Coloring) -> FloatArray:
    calculus, mesh = abfm.calculus, field.mesh
    operator = calculus.divergence if kind == "divergence" else calculus.curl
    return np.asarray(operator(mesh) @ calculus.to_frame(mesh, field.velocity).ravel())


@dataclass(frozen=True, eq=False)
class Streaks:
    """Grey textures of streaks along a field, one for each phase of their movement."""

    field: Field
    atlas: abfm.streaks.TextureAtlas
    images: NDArray[np.uint8]  # (P, size, size), 0 to 255
    options: tuple[bool, bool] = (False, False)  # whether streaks fade, and move

    def at(self, phase: float) -> NDArray[np.uint8]:
        """Return the texture (size, size) at a phase from 0 to 1, blended from two phases."""
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
    """Colours (size, size, 3), in linear light, of streaks coloured by values."""

    streaks: Streaks
    colors: abfm.streaks.FloatImage


def convolved(field: Field, size: int, fade: bool, moving: bool) -> Streaks:
    """Return streaks along a field, as textures of ``size`` texels a side, or more for many faces.

    ``fade`` fades streaks where the field is slow, and ``moving`` makes textures for many phases.
    """
    needed = int(np.sqrt(_TEXELS_PER_FACE_MIN * len(field.mesh.faces)))
    size = min(max(size, needed), _TEXELS_MAX)
    phases = np.arange(_PHASES) / _PHASES if moving else None
    atlas, images = abfm.streaks.line_integral_convolution(
        field.mesh, field.velocity, size=size, fade=fade, phase=phases
    )
    rounded = [
        (255 * image + np.float32(0.5)).astype(np.uint8) for image in images.reshape(-1, size, size)
    ]
    return Streaks(field, atlas, np.stack(rounded), (fade, moving))


def colored(streaks: Streaks, phase: float, values: ColoredValues) -> Texture:
    return Texture(streaks, shown.streak_texture(streaks.atlas, streaks.at(phase), values))


class FieldQuantities(Jobs):
    """Quantities of the flow that a session shows, computed in the background.

    While a value is computed, methods return the previous value on the same mesh or field; None if
    there is none.
    """

    def __init__(self, session: Session, flow: ShownFlow) -> None:
        super().__init__(session.at_once)
        self._session, self.flow = session, flow
        self._field: Latest[Field] = self.latest()
        self._scalar: Latest[FloatArray] = self.latest()
        self._determined: Latest[FloatArray] = self.latest()
        self._determined_row = Memo[FloatArray]()
        self._arrows: Latest[Arrows] = self.latest()
        self._hidden_arrows: Latest[BoolArray] = self.latest()
        self._chords: Latest[abfm.maps.Distortion] = self.latest()
        self._quality: Latest[abfm.maps.FlowMapQuality] = self.latest()
        self._streaks: Latest[Streaks] = self.latest()
        self._texture: Latest[Texture] = self.latest()
        self._lines: Latest[list[abfm.flow.FlowLine]] = self.latest()
        self._paths: Latest[list[abfm.flow.FlowLine]] = self.latest()

    @property
    def is_computing_field(self) -> bool:
        return self._field.busy

    @property
    def is_behind(self) -> bool:
        """Whether the shown field is still that of an earlier flow."""
        view, flow, key = self._session.view, self.flow.state, self._field.key
        shows_field = view.coloring in FIELD_COLORINGS or view.arrows or view.streaks
        if flow is None or not (shows_field and isinstance(key, tuple)):
            return False
        return not any(one is flow for one in key[1])

    @property
    def convolving(self) -> bool:
        return self._streaks.busy

    @property
    def is_placing_arrows(self) -> bool:
        """Whether the first arrows on this surface are being computed."""
        return self._arrows.busy and self._arrows.value is None and self._session.view.arrows

    def field(self) -> Field | None:
        """Return the field, or its selected part, at the shown time; None before it is known."""
        flow, time, part = self.flow.state, self.flow.time, self._session.view.part
        if flow is None:
            return None
        if part == "pushed gradient":
            source = self._session.work.flow_values("source")
            if source is None:
                return None
            return self._field.newest(flow.mesh, pushed_gradient, flow, source, time)
        return self._part(flow, self._segment(flow), part)

    def _part(self, flow: FlowState, segment: int, part: FieldPart) -> Field | None:
        return self._field.newest(flow.mesh, field_part, flow, segment, part)

    def scalar(self) -> FloatArray | None:
        """Return the field's divergence or curl, (V,), as the view selects; None until known."""
        if (field := self.field()) is None:
            return None
        return self._scalar.newest(field.mesh, derivative, field, self._session.view.coloring)

    def arrows(self, field: Field, scale: float, eye: Eye) -> Arrows | None:
        """Return the arrows of a field from a viewpoint, at ``scale`` pixels per sqrt(area)."""
        view = self._session.view
        if (fast := self.fast(field)) is None:
            return self._arrows.value
        style = ArrowStyle(view.arrow_length, arrow_spacing(view.arrow_density, scale), fast)
        of = field.mesh, field.velocity, style, eye, self.determined()
        return self._arrows.newest(field.mesh, arrows_of, *of)

    def determined(self) -> FloatArray | None:
        """Return the share of the shown field that the data determine, (F,), up to 1.

        Small shares above 0 count as `_OPACITY_MIN`, so that faint arrows are visible. The result
        is None if uncertain motion does not fade, or the share is not known.
        """
        view = self._session.view
        if not view.fade_uncertain or view.part not in ("complete", *HODGE_PARTS):
            return None
        flow, shares = self.flow.state, self._shares()
        if flow is None or shares is None or shares.shape[1] != len(flow.mesh.faces):
            return None
        of_field = shares[row := self._row(flow)]
        return self._determined_row.get(
            (shares, row), lambda: np.where(of_field > 0, np.maximum(of_field, _OPACITY_MIN), 0.0)
        )

    def _shares(self) -> FloatArray | None:
        """Return the shares of all fields that the data determine, (N, F); None if not known."""
        result, session = self._session.result, self._session
        if result is None or session.snapshot is not None or session.outdated:
            return None
        return self._determined.newest(result.mesh, attrgetter("determined"), result)

    def _row(self, flow: FlowState) -> int:
        """Return the row of the shown field in `_shares`."""
        return self._segment(flow)

    def _segment(self, flow: FlowState) -> int:
        """Return the number of the field at the shown time, of N fields up to tau."""
        share = self.flow.time / flow.parameters.tau
        return min(int(share * flow.count * (1 - 1e-12)), flow.count - 1)

    def fast(self, field: Field) -> float | None:
        """Return the speed of the longest arrows; None before it is known.

        The value 0 stands for `abfm.calculus.fast_speed` of this field.
        """
        return field.fast

    def hidden_arrows(self, arrows: Arrows, eye: Eye) -> BoolArray | None:
        return self._hidden_arrows.newest(arrows, Arrows.hidden, arrows, eye)

    def map_quality(self) -> abfm.maps.FlowMapQuality | None:
        """Return the quality of the map from time 0 to the shown time; None before it is known.

        While the time moves, the quality at an earlier time is returned.
        """
        flow, time = self.flow.state, self.flow.time
        if flow is None:
            return None
        last = self._quality.value
        if last is not None and not (self.at_once or self.flow.settled):
            return last if len(last.distortion.flipped) == len(flow.mesh.faces) else None
        return self._quality.newest(flow.mesh, lambda *of: flow.flow.map_quality(time), flow, time)

    def distortion(self) -> abfm.maps.Distortion | None:
        """Return the distortion of the map from time 0 to the shown time; None before it is known.

        While the time moves, it is measured quickly: from the corners of the faces alone.
        """
        flow, quality = self.flow.state, self.map_quality()
        is_exact = self.at_once or (self.flow.settled and not self._quality.busy)
        if flow is None or (is_exact and quality is not None):
            return quality.distortion if quality else None
        if (places := self.flow.destinations()) is None:
            return quality.distortion if quality else None
        return self._chords.newest(flow.mesh, abfm.maps.chord_distortion, flow.mesh, places)

    def texture(self, values: ColoredValues) -> Texture | None:
        """Return streaks coloured by values; None until they are known."""
        field, view = self.field(), self._session.view
        if field is None or self._session.matching.running:
            return None
        subject, streaks = self._streaks_of(field, view.fade, view.animate)
        if streaks is None:
            return None
        phase = 0.0 if len(streaks.images) == 1 else self._session.player.phase
        if not self.at_once:
            phase = round(phase * _SHOWN_PHASES) / _SHOWN_PHASES
        return self._texture.newest(subject, colored, streaks, phase, values)

    def _streaks_of(self, field: Field, fade: bool, moving: bool) -> tuple[object, Streaks | None]:
        """Return a key, and the streaks along a field or None.

        Until the texture of these streaks is computed, an earlier one with the same key is shown.
        """
        size = _TEXELS_OF_PICTURES if self.at_once else TEXELS
        return field, self._streaks.newest(field, convolved, field, size, fade, moving)

    def lines(self) -> list[abfm.flow.FlowLine]:
        """Return the flow lines of the field through the clicked points, in both directions."""
        flow, field, points = self.flow.state, self.field(), self._session.document.lines
        if flow is None or field is None or not points:
            return []
        mesh = field.mesh

        def compute() -> list[abfm.flow.FlowLine]:
            tau = flow.line_time
            starts, lines = surface_points(mesh, points), partial(abfm.flow.flow_lines, mesh)
            return [line for t in (-tau, tau) for line in lines(field.velocity, starts, t)]

        subject = mesh, points
        return self._lines.newest(subject, lambda *_: compute(), field, flow.parameters.tau) or []

    def paths(self) -> list[abfm.flow.FlowLine]:
        """Return the paths of the points that follow the flow, up to the end of the time bar."""
        flow, points = self.flow.state, self._session.document.points
        if flow is None or not points:
            return []

        def compute() -> list[abfm.flow.FlowLine]:
            starts, fields = surface_points(flow.mesh, points), flow.flow.fine_velocity
            return abfm.flow.flow_lines(
                flow.mesh, fields, starts, flow.duration, flow.parameters.tau
            )

        return self._paths.request((flow, points), compute) or []

    @property
    def path_time(self) -> float:
        """The shown time, in the unit of time of `paths`."""
        return self.flow.time

    def starts(self, paths: Sequence[abfm.flow.FlowLine]) -> FloatArray:
        """Return the start points of paths, (P, 3), as positions on the surface of the source."""
        prepared = self._session.work.prepared
        if prepared is None:
            return np.array([path.positions[0] for path in paths])
        faces, weights = zip(*((path.faces[0], path.barycentric[0]) for path in paths), strict=True)
        mesh = self._session.surface().mesh
        on_b = abfm.maps.SurfacePoints(mesh, np.array(faces), np.array(weights))
        return prepared.initial.correspondence.points.at(on_b).positions


class MassTransport(Latest[FloatArray]):
    """Interpolation between source and target by optimal transport, at the shown time up to tau."""

    def __init__(self, session: Session) -> None:
        super().__init__(session.at_once)
        self._session = session

    @property
    def note(self) -> str:
        """Note that optimal transport replaces negative values by 0; empty if there are none."""
        found = [self._session.work.flow_values(side) for side in SIDES]
        known = [values for values in found if values is not None]
        least = min((float(values.min()) for values in known), default=0.0)
        if least >= 0 or len(known) < len(found) or self.error:
            return ""
        return f"optimal transport replaces negative values (down to {least:.3g}) by 0"

    def values(self) -> FloatArray | None:
        """Return the interpolated function (V,); None while it is computed, or if this failed."""
        session = self._session
        source, target = session.work.flow_values("source"), session.work.flow_values("target")
        if source is None or target is None:
            return None
        problem = (session.surface().mesh, source, target)
        share = min(session.time / session.document.tau, 1.0)
        transport = partial(abfm.baselines.optimal_transport, sharpen=True)
        return self.newest(problem, transport, *problem, share)
