"""The shown flow of a match, and functions and points moved by it to the shown time."""

from __future__ import annotations

import time as clock
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

import abfm
from abfm import AbfmError, TriangleMesh
from abfm.mesh import per_mesh
from abfm.types import FloatArray, IntArray
from abfm_viewer.computing.background import Jobs, Latest, Memo
from abfm_viewer.document.document import TRANSFERRED_COLORINGS
from abfm_viewer.session.session import Session
from abfm_viewer.shown.flow_state import FlowState
from abfm_viewer.shown.in_between import Frames, blended

if TYPE_CHECKING:
    from scipy.spatial import KDTree

_TIMES = 61
_TIMES_WHILE_SOLVING = 17
_SPAN_NUMBERS_MAX = 60_000_000  # largest count of numbers in a span, as float32
_SETTLE_SECONDS = 0.15  # seconds without a change of time before exact values are computed


ValuesAtTimes: TypeAlias = Callable[[FlowState, FloatArray, FloatArray], FloatArray]
"""Function of a flow, values at time 0 and times (T,), which returns values (T, ...)."""


@dataclass(frozen=True, eq=False)
class Span:
    """A function at evenly spaced times (T,), in single precision, interpolated between them."""

    times: FloatArray
    frames: Frames
    note: str = ""  # why it ends before the time bar; empty if it does not

    def at(self, time: float) -> FloatArray:
        """Return the function at a time; after the last time, the function at the last time."""
        return blended(self.frames, float(np.interp(time, self.times, np.arange(len(self.times)))))


def advected(state: FlowState, function: FloatArray, times: FloatArray) -> FloatArray:
    return state.advect(function, times)


def span(state: FlowState, function: FloatArray, values_at: ValuesAtTimes = advected) -> Span:
    """Return a function at times of the entire time bar, or up to tau if values overflow later.

    ``values_at`` computes the function at given times, by default by advection along the flow.
    """
    times_max = _TIMES if state.final else _TIMES_WHILE_SOLVING
    count = int(np.clip(_SPAN_NUMBERS_MAX // function.size, 9, times_max)) // 2 * 2 + 1
    tau = state.parameters.tau

    def until(end: float, note: str = "") -> Span:
        times = np.linspace(0, end, count)
        return Span(times, values_at(state, function, times).astype(np.float32), note)

    try:
        return until(state.duration)
    except AbfmError as error:
        return until(tau, f"not beyond τ: {error}")


class AtShownTime:
    """Computes a function at the shown time; the array stays the same until its inputs change.

    ``values_at`` computes the function at given times, by default by advection along the flow.
    """

    def __init__(self, jobs: Jobs, values_at: ValuesAtTimes = advected) -> None:
        self._values_at = values_at
        self._span: Latest[Span] = jobs.latest()
        self._exact: Latest[FloatArray] = jobs.latest()
        self._blended = Memo[FloatArray]()
        self._at_once = jobs.at_once
        self.behind = False  # whether the function is that of an earlier flow

    @property
    def problem(self) -> str:
        return self._exact.error

    @property
    def error(self) -> str:
        """Reason why values are missing at all times or after tau; empty if none are missing."""
        return self._span.error or (self._span.value.note if self._span.value else "")

    def _newest_span(self, state: FlowState, function: FloatArray) -> Span | None:
        return self._span.newest(function.shape, span, state, function, self._values_at)

    def is_ready(self, state: FlowState, function: FloatArray) -> bool:
        if not self._at_once:
            self._newest_span(state, function)
        return not self._span.busy

    def at(
        self, state: FlowState, function: FloatArray, time: float, settled: bool
    ) -> FloatArray | None:
        """Return the values at ``time``, exactly if ``settled``, otherwise blended from two times.

        ``function`` is the function at time 0. While values are computed, those of an earlier flow
        are returned; None if there are none.
        """
        self.behind = False
        if time == 0:
            return function

        def exact() -> FloatArray | None:
            key = (state, function, time)
            at = self._values_at
            return self._exact.request(key, lambda: at(state, function, np.array([time]))[0])

        if self._at_once:
            return exact()
        newest = self._newest_span(state, function)
        self.behind = state.final and self._span.busy
        if newest is None:
            return None
        is_current = state.final and not self._span.busy and time <= newest.times[-1]
        if settled and is_current and (values := exact()) is not None:
            return values
        return self._blended.get((newest, time), partial(newest.at, time))


def labels_at(mesh: TriangleMesh, values: IntArray, places: FloatArray) -> IntArray:
    """Return the labels (P,) of the vertices nearest to ``places`` (P, 3), from ``values`` (V,)."""
    return np.asarray(values[vertex_tree(mesh).query(places)[1]])


@per_mesh
def vertex_tree(mesh: TriangleMesh) -> KDTree:
    from scipy.spatial import KDTree  # imported late: the first frame does not need it

    return KDTree(mesh.vertices)


class ShownFlow(Jobs):
    """The flow that a session shows: of the best iterate during a run, otherwise of the result."""

    def __init__(self, session: Session) -> None:
        super().__init__(session.at_once)
        self._session = session
        self._source = AtShownTime(self)
        self._coordinates = AtShownTime(self, FlowState.origins)
        self._destinations = AtShownTime(self, FlowState.destinations)
        self._labels: Latest[IntArray] = self.latest()
        self._state = Memo[FlowState]()
        self._column = Memo[FloatArray]()
        self._places = Memo[FloatArray]()
        self._fine: Latest[abfm.Match] = self.latest()
        self._on_fine = AtShownTime(self)  # along the flow of the finer mesh
        self._fine_state = Memo[FlowState]()
        self._fine_columns: dict[str, Memo[FloatArray]] = defaultdict(Memo)
        self.is_behind = False  # whether `advected` last returned values of another flow or time

    @property
    def state(self) -> FlowState | None:
        """The flow, which is the same object while its field is the same; None without a field."""
        snapshot, result = self._session.snapshot, self._session.result
        mesh, prepared = self._session.surface().mesh, self._session.work.prepared
        first = prepared.initial.correspondence.points if prepared else None
        if snapshot is not None:
            now, parameters = snapshot.shown, snapshot.problem.parameters
            read = partial(getattr, now, "velocity")
            given = mesh, read, parameters, False, None, now.fields, first
            return self._state.get((now, first), partial(FlowState, *given))
        if result is None:
            return None
        of, problem = (mesh, result.fine_velocity, result.parameters), result.problem
        make = partial(FlowState, *of, problem=problem, initial=first)
        return self._state.get((result, first), make)

    @property
    def time(self) -> float:
        """The shown time in the flow's unit of time, which differs after a change of tau."""
        flow, time = self.state, self._session.time
        return time if flow is None else time * flow.parameters.tau / self._session.document.tau

    def advected(self) -> FloatArray | None:
        """Return the active channel's source, advected to the shown time, (V,); None if unknown.

        Of two surfaces, it is advected on B. Without a flow, the source is returned.
        """
        session, flow = self._session, self.state
        self.is_behind = False
        source = session.work.flow_values("source")
        if source is None or flow is None:
            return source
        time, tau, channel = self.time, flow.parameters.tau, session.document.channel
        if abs(time - tau) <= 1e-9 * tau:
            snapshot = session.matching.snapshot
            found: abfm.Match | abfm.matching.Iteration | None = None
            if flow.final:
                found = None if session.outdated else session.result
            elif snapshot and len(snapshot.problem.channels) == len(session.channels):
                found = snapshot.shown
            if found is not None:
                columns = found.advected
                return self._column.get((columns, channel), lambda: columns[:, channel])
        values = self._source.at(flow, source, time, self.settled)
        self.is_behind = self._source.behind
        return source if values is None else values

    def on_finer_mesh(self, name: str) -> tuple[TriangleMesh, FloatArray] | None:
        """Return the finer mesh of a match, and a function (V,) on it; None if it is not shown.

        ``name`` is "source", "target" or "advected".
        """
        session, result = self._session, self._session.result
        if result is None or session.snapshot is not None or session.outdated:
            return None
        if session.surface(name) is not session.surface():  # the surface is A
            return None
        if not (session.view.finer and result.refined):
            return None
        fine = self._fine.request(result, lambda: result.fine)
        if fine is None:
            return None
        channel, time, tau = session.document.channel, self.time, result.parameters.tau

        def column(of: str) -> FloatArray:
            get = self._fine_columns[of].get
            return get((fine, channel), lambda: np.asarray(getattr(fine, of)[:, channel]))

        if name == "target":
            return fine.mesh, column(name)
        source = column("source")
        if name == "source":
            return fine.mesh, source
        self.is_behind = False
        if abs(time - tau) <= 1e-9 * tau:
            return fine.mesh, column(name)
        make = partial(FlowState, fine.mesh, fine.fine_velocity, fine.parameters)
        state = self._fine_state.get((fine,), make)
        values = self._on_fine.at(state, source, time, self.settled)
        self.is_behind = self._on_fine.behind
        return None if values is None else (fine.mesh, values)

    def coordinates(self) -> FloatArray | None:
        """Return the start, at time 0, of the points at the vertices at the shown time, (V, 3).

        Points are followed along flow lines, and to surface A if there are two surfaces. The result
        is None if unknown.
        """
        flow, places = self.state, self._origins
        if flow is None or places is None:
            return places
        return self._coordinates.at(flow, places, self.time, self.settled)

    def labels(self) -> IntArray | None:
        """Return labels moved to the shown time or, until known, to an earlier one, (V,)."""
        labels, places = self._session.document.labels, self.coordinates()
        if labels is None or places is None:
            return None
        mesh = self._session.surface("source").mesh
        return self._labels.newest((labels, places.shape), labels_at, mesh, labels.values, places)

    @property
    def _origins(self) -> FloatArray | None:
        """Images of the vertices on the source's surface, (V, 3); None without an initial map."""
        surface = self._session.surface()
        if self._session.surface("source") is surface:
            return surface.mesh.vertices
        if (prepared := self._session.work.prepared) is None:
            return None
        first = prepared.initial.correspondence.points
        return self._places.get((first,), lambda: first.positions)

    def destinations(self) -> FloatArray | None:
        """Return where points from the vertices are at the shown time, (V, 3); None if unknown."""
        flow, vertices = self.state, self._session.surface().mesh.vertices
        if flow is None:
            return None
        return self._destinations.at(flow, vertices, self.time, settled=False)

    @property
    def is_ready(self) -> bool:
        """Whether the function or pattern to be shown is computed at all times of the flow."""
        session, state = self._session, self.state
        source, places = session.work.flow_values("source"), self._origins
        if state is None or source is None or places is None or not state.final:
            return True
        of_places = session.view.coloring in TRANSFERRED_COLORINGS
        return self._source.is_ready(state, source) and (
            not of_places or self._coordinates.is_ready(state, places)
        )

    @property
    def settled(self) -> bool:
        """Whether the shown time has not changed for a while, and exact values are computed."""
        unchanged = clock.perf_counter() - self._session.editor.time_changed
        return not self._session.player.playing and unchanged > _SETTLE_SECONDS

    @property
    def note(self) -> str:
        """Reason why the flow cannot be shown up to the end of the time bar; empty if it can."""
        return self._source.error

    @property
    def problem(self) -> str:
        """Reason why exact values at the shown time cannot be computed; empty if they can."""
        return self._source.problem or self._coordinates.problem
