"""Positions of landmarks in pictures: as the user placed them, and moved by the flow."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np

import abfm
from abfm import TriangleMesh
from abfm.types import BoolArray, FloatArray
from abfm_viewer.computing.background import Jobs, Latest, Memo
from abfm_viewer.document.document import SIDES, Landmark, Side
from abfm_viewer.document.surface_points import surface_points
from abfm_viewer.session.session import Session
from abfm_viewer.shown.eye import Eye
from abfm_viewer.shown.flow_state import FlowState
from abfm_viewer.shown.ribbons import outward
from abfm_viewer.shown.shown_flow import ShownFlow

_TIMES = 41  # number of times of paths; tau is one of them
_DEPTH_TOLERANCE = 0.01  # of sqrt(area): a point less far behind a face is not hidden by it


@dataclass(frozen=True, eq=False)
class LandmarkPoints:
    """Positions of P landmarks on a surface."""

    mesh: TriangleMesh
    numbers: tuple[int, ...]  # numbers of the landmarks, from 0
    places: FloatArray  # (P, 3)
    normals: FloatArray  # (P, 3)

    @classmethod
    def at(cls, points: abfm.maps.SurfacePoints, numbers: tuple[int, ...]) -> LandmarkPoints:
        normals = abfm.calculus.face_normals(points.mesh)[points.faces]
        return cls(points.mesh, numbers, points.positions, outward(points.mesh) * normals)

    def hidden(self, axes: FloatArray) -> BoolArray:
        """Return a mask (P,) of the points that the surface hides in parallel projection.

        The rows of ``axes`` (3, 3) point right, up, and towards the viewer.
        """
        mesh, cosines = self.mesh, self.normals @ axes[2]
        cosines = cosines if mesh.is_closed else np.abs(cosines)
        hidden = np.asarray(cosines <= 0)
        surface, places = mesh.vertices / mesh.length_scale, self.places / mesh.length_scale
        given = (surface, mesh.faces), places[~hidden], cosines[~hidden]
        hidden[~hidden] = Eye(axes).hides(*given, _DEPTH_TOLERANCE)
        return hidden


@dataclass(frozen=True, eq=False)
class LandmarkPaths:
    """Positions of points that move along a flow, at times (T,)."""

    times: FloatArray
    points: list[abfm.maps.SurfacePoints]

    @classmethod
    def along(cls, flow: FlowState, starts: abfm.maps.SurfacePoints) -> LandmarkPaths:
        """Follow points to the end of the time bar, on the flow lines that verify a match."""
        lines = abfm.flow.ContinuousFlow(flow.mesh, flow.flow.fine_velocity, flow.parameters.tau)
        times, points = np.linspace(0, flow.duration, _TIMES), [starts]
        for begin, end in pairwise(times.tolist()):
            points.append(lines.between(points[-1], begin, end))
        return cls(times, points)

    def at(self, time: float, numbers: tuple[int, ...]) -> LandmarkPoints:
        """Return the points at a time, linearly interpolated, for landmarks ``numbers``."""
        after = int(np.clip(np.searchsorted(self.times, time), 1, len(self.times) - 1))
        begin, end = self.times[after - 1 : after + 1]
        before, then = (LandmarkPoints.at(self.points[k], numbers) for k in (after - 1, after))
        share = float(np.clip((time - begin) / (end - begin), 0, 1))
        places = (1 - share) * before.places + share * then.places
        return replace(then if share > 0.5 else before, places=places)


class ShownLandmarks(Jobs):
    def __init__(self, session: Session, flow: ShownFlow) -> None:
        super().__init__(session.at_once)
        self._session, self._flow = session, flow
        self._placed = {side: Memo[LandmarkPoints | None]() for side in SIDES}
        self._starts: Memo[abfm.maps.SurfacePoints] = Memo()
        self._paths: Latest[LandmarkPaths] = self.latest()
        self._moved = Memo[LandmarkPoints]()
        self._axes = defaultdict[tuple[str, Side | None], Memo[FloatArray]](Memo)
        self._hidden = defaultdict[tuple[str, Side | None], Latest[BoolArray]](self.latest)

    def hidden(
        self, slot: str, side: Side | None, points: LandmarkPoints, axes: FloatArray
    ) -> BoolArray:
        """Return a mask (P,) of the landmarks in a slot (a picture) that the surface hides.

        While it is computed for new ``axes`` of the view, that of earlier ones is returned.
        """
        same_axes = self._axes[slot, side].get((axes.tobytes(),), lambda: axes)
        subject = points.mesh, points.numbers
        found = self._hidden[slot, side].newest(subject, LandmarkPoints.hidden, points, same_axes)
        return np.zeros(len(points.numbers), dtype=bool) if found is None else found

    def placed(self, side: Side) -> LandmarkPoints | None:
        """Return the landmarks that were placed on the source's or target's surface, or None."""
        landmarks, mesh = self._session.document.landmarks, self._session.surface(side).mesh

        def place() -> LandmarkPoints | None:
            given = [(n, point) for n, one in enumerate(landmarks) if (point := one.point(side))]
            if not given:
                return None
            numbers, points = zip(*given, strict=True)
            return LandmarkPoints.at(surface_points(mesh, points), numbers)

        return self._placed[side].get((mesh, landmarks), place)

    def moved(self) -> LandmarkPoints | None:
        """Return the landmarks of the source, moved to the shown time.

        The result is None without landmarks, and before the map between two surfaces is known.
        """
        landmarks = self._session.document.landmarks
        numbers = tuple(n for n, one in enumerate(landmarks) if one.source is not None)
        if not numbers or (starts := self._on_target(landmarks)) is None:
            return None
        flow, time = self._flow.state, self._flow.time
        at_start = partial(LandmarkPoints.at, starts, numbers)
        if flow is None or time == 0:
            return self._moved.get((starts, 0.0), at_start)
        found = self._paths.newest((flow.mesh, starts), LandmarkPaths.along, flow, starts)
        if found is None:
            return self._moved.get((starts, 0.0), at_start)
        return self._moved.get((found, time), partial(found.at, time, numbers))

    def _on_target(self, landmarks: tuple[Landmark, ...]) -> abfm.maps.SurfacePoints | None:
        """Return the source's landmarks on the target's surface, at time 0; None if unknown."""
        document, prepared = self._session.document, self._session.work.prepared
        initial = prepared.initial.correspondence if prepared else None
        if initial is None and document.surface("source") is not document.surface():
            return None
        mesh = document.surface("source").mesh
        sources = tuple(one.source for one in landmarks if one.source)

        def start() -> abfm.maps.SurfacePoints:
            points = surface_points(mesh, sources)
            return points if initial is None else initial.transfer_points(points)

        return self._starts.get((mesh, initial, sources), start)
