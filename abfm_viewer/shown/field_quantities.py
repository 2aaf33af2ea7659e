"""What can be told of the field and its flow, computed off the frame loop."""

from __future__ import annotations

from functools import partial

import numpy as np

import abfm
from abfm.mesh import TriangleMesh
from abfm.types import FloatArray
from abfm_viewer.appearance.colormaps import ColorRange
from abfm_viewer.computing.background import Jobs, Latest
from abfm_viewer.document.document import EXTRAPOLATION, Point
from abfm_viewer.session.session import Session
from abfm_viewer.shown.carried import FlowState
from abfm_viewer.shown.field_parts import (
    Field,
    acting_segment,
    carried_part,
    derivative,
    field_part,
)
from abfm_viewer.shown.shown_flow import ShownFlow
from abfm_viewer.shown.streaks import Streaks, Texture, coloured, convolved

# along a side; fewer in the window, where textures change while one looks
_TEXELS, _TEXELS_OF_PICTURES = 1024, 2048
_SHOWN_PHASES = 32  # of moving streaks in the window


class FieldQuantities(Jobs):
    """Answers with what was computed last for the same mesh or field; None before."""

    def __init__(self, session: Session, flow: ShownFlow) -> None:
        super().__init__(session.at_once)
        self._session, self._flow = session, flow
        self._field: Latest[Field] = self.latest()
        self._scalar: Latest[FloatArray] = self.latest()
        self._distortion: Latest[abfm.maps.Distortion] = self.latest()
        self._quality: Latest[abfm.maps.MapQuality] = self.latest()
        self._streaks: Latest[Streaks] = self.latest()
        self._texture: Latest[Texture] = self.latest()
        self._lines: Latest[list[abfm.flow.FlowLine]] = self.latest()
        self._paths: Latest[list[abfm.flow.FlowLine]] = self.latest()

    @property
    def finding(self) -> bool:
        """Return whether the field that the view asks for is still to come."""
        return self._field.busy

    @property
    def convolving(self) -> bool:
        """Return whether streaks that the view asks for are still to come."""
        return self._streaks.busy

    def field(self) -> Field | None:
        """The part of the field that the view asks for, at the shown time."""
        flow, time, part = self._flow.state, self._flow.time, self._session.view.part
        if flow is None:
            return None
        if part != "carried gradient":
            segment = acting_segment(flow, time)
            key, compute = (flow, segment, part), partial(field_part, flow, segment, part)
            return self._field.newest(flow.mesh, key, compute)
        source = self._session.values("source")
        if source is None:
            return None
        return self._field.newest(
            flow.mesh, (flow, time, part, source), partial(carried_part, flow, source, time)
        )

    def scalar(self) -> FloatArray | None:
        """Divergence or curl of the field at the vertices, (V,)."""
        field, kind = self.field(), self._session.view.coloring
        if field is None:
            return None
        return self._scalar.newest(field.mesh, (field, kind), partial(derivative, field, kind))

    def distortion(self) -> abfm.maps.Distortion | None:
        """Distortion of the flow's map at the shown time."""
        flow, time = self._flow.state, self._flow.time
        if flow is None:
            return None
        return self._distortion.newest(flow.mesh, (flow, time), partial(_distortion, flow, time))

    def map_quality(self) -> abfm.maps.MapQuality | None:
        """Judge the map that is shown: to where values came from, or to where faces go."""
        flow, time = self._flow.state, self._flow.time
        if flow is None:
            return None
        if self._session.view.coloring in ("area distortion", "conformal distortion"):
            time = -time
        return self._quality.newest(flow.mesh, (flow, time), partial(_quality, flow, time))

    def texture(self, values: FloatArray, colors: ColorRange) -> Texture | None:
        """Return streaks coloured by a function (V,), lately an earlier one; None before any."""
        field, view = self.field(), self._session.view
        if field is None or self._session.solver.running:
            return None
        size = _TEXELS_OF_PICTURES if self.at_once else _TEXELS
        compute = partial(convolved, field, size, view.fade, view.animate)
        streaks = self._streaks.newest(field, (view.fade, view.animate), compute)
        if streaks is None:
            return None
        phase = 0.0 if len(streaks.images) == 1 else self._session.player.phase
        if not self.at_once:
            phase = round(phase * _SHOWN_PHASES) / _SHOWN_PHASES
        key = (streaks, values, colors, phase)
        return self._texture.newest(field, key, partial(coloured, streaks, phase, values, colors))

    def lines(self) -> list[abfm.flow.FlowLine]:
        """Follow the points that were clicked on, against the flow for tau, and with it."""
        flow, field, points = self._flow.state, self.field(), self._session.document.lines
        if flow is None or field is None or not points:
            return []
        tau = flow.parameters.tau
        return self._lines.ask((field, points, tau), partial(_lines, field, points, tau)) or []

    def paths(self) -> list[abfm.flow.FlowLine]:
        """The ways of the points that are followed, to the end of the time bar."""
        flow, points = self._flow.state, self._session.document.points
        if flow is None or not points:
            return []
        return self._paths.ask((flow, points), partial(_paths, flow, points)) or []


def _distortion(flow: FlowState, time: float) -> abfm.maps.Distortion:
    """Measure the map that takes each vertex to where it is at a time."""
    return _mapped(flow, -time).distortion()


def _quality(flow: FlowState, time: float) -> abfm.maps.MapQuality:
    """Judge the map to where values came from at a time; below 0 its inverse."""
    return abfm.maps.map_quality(_mapped(flow, time))


def _mapped(flow: FlowState, time: float) -> abfm.PointMap:
    places = flow.carry(flow.mesh.vertices, np.array([time]))[0]
    return abfm.PointMap.project(flow.mesh, flow.mesh, places)


def _starts(mesh: TriangleMesh, points: tuple[Point, ...]) -> abfm.maps.SurfacePoints:
    faces, weights = zip(*((p.face, p.barycentric) for p in points), strict=True)
    return abfm.maps.SurfacePoints(mesh, np.array(faces), np.array(weights))


def _lines(field: Field, points: tuple[Point, ...], tau: float) -> list[abfm.flow.FlowLine]:
    starts = _starts(field.mesh, points)
    return [
        line
        for time in (-tau, tau)
        for line in abfm.flow.flow_lines(field.mesh, field.velocity, starts, time)
    ]


def _paths(flow: FlowState, points: tuple[Point, ...]) -> list[abfm.flow.FlowLine]:
    tau, starts = flow.parameters.tau, _starts(flow.mesh, points)
    return abfm.flow.flow_lines(flow.mesh, flow.velocity, starts, EXTRAPOLATION * tau, tau)
