"""The flow that is shown, and functions carried along it to the time that is shown."""

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
_SPAN_NUMBERS_MAX = 60_000_000  # numbers in a span, as float32
_SETTLE_SECONDS = 0.15  # seconds without a new time after which it is worth computing exactly


Carrying: TypeAlias = Callable[[FlowState, FloatArray, FloatArray], FloatArray]


@dataclass(frozen=True, eq=False)
class Span:
    """A function at evenly spaced times (T,), in single precision: scrubbing is a blend."""

    times: FloatArray
    frames: Frames
    note: str = ""  # why it ends before the time bar does; empty if it does not

    def at(self, time: float) -> FloatArray:
        """The function at a time; the last one known for times after the end."""
        return blended(self.frames, float(np.interp(time, self.times, np.arange(len(self.times)))))


def pushed(state: FlowState, function: FloatArray, times: FloatArray) -> FloatArray:
    return state.carry(function, times)


def span(state: FlowState, function: FloatArray, carry: Carrying = pushed) -> Span:
    """A function over the whole time bar, or up to tau where the flow overflows beyond."""
    wanted = _TIMES if state.final else _TIMES_WHILE_SOLVING
    count = int(np.clip(_SPAN_NUMBERS_MAX // function.size, 9, wanted)) // 2 * 2 + 1
    tau = state.parameters.tau

    def until(end: float, note: str = "") -> Span:
        times = np.linspace(0, end, count)
        return Span(times, carry(state, function, times).astype(np.float32), note)

    try:
        return until(state.duration)
    except AbfmError as error:
        return until(tau, f"not beyond τ: {error}")


class Carried:
    """A function at the shown time, the same array for the same; `behind` if of another."""

    def __init__(self, jobs: Jobs, carry: Carrying = pushed) -> None:
        self._carry = carry
        self._span: Latest[Span] = jobs.latest()
        self._exact: Latest[FloatArray] = jobs.latest()
        self._blended = Memo[FloatArray]()
        self._at_once = jobs.at_once
        self.behind = False

    @property
    def problem(self) -> str:
        return self._exact.error

    @property
    def error(self) -> str:
        """Say why there are no values, or only up to tau; nothing if all is well."""
        return self._span.error or (self._span.value.note if self._span.value else "")

    def _known(self, state: FlowState, function: FloatArray) -> Span | None:
        return self._span.newest(function.shape, span, state, function, self._carry)

    def is_ready(self, state: FlowState, function: FloatArray) -> bool:
        if not self._at_once:
            self._known(state, function)
        return not self._span.busy

    def at(
        self, state: FlowState, function: FloatArray, time: float, settled: bool
    ) -> FloatArray | None:
        """Values at a time, exact if it is settled; an earlier flow's while new ones come."""
        self.behind = False
        if time == 0:
            return function

        def exact() -> FloatArray | None:
            key = (state, function, time)
            return self._exact.ask(key, lambda: self._carry(state, function, np.array([time]))[0])

        if self._at_once:
            return exact()
        known = self._known(state, function)
        self.behind = state.final and self._span.busy
        if known is None:
            return None
        is_known = state.final and not self._span.busy and time <= known.times[-1]
        if settled and is_known and (values := exact()) is not None:
            return values
        return self._blended.get((known, time), partial(known.at, time))


def labels_at(mesh: TriangleMesh, values: IntArray, places: FloatArray) -> IntArray:
    """Return the labels (P,) of the vertices nearest to places (P, 3), of labels of all (V,)."""
    return np.asarray(values[vertex_tree(mesh).query(places)[1]])


@per_mesh
def vertex_tree(mesh: TriangleMesh) -> KDTree:
    from scipy.spatial import KDTree  # late, as the first frame needs none

    return KDTree(mesh.vertices)


class ShownFlow(Jobs):
    """Of a session: the newest iterate's flow during a run, else the result's."""

    def __init__(self, session: Session) -> None:
        super().__init__(session.at_once)
        self._session = session
        self._source = Carried(self)
        self._coordinates = Carried(self, FlowState.origins)
        self._destinations = Carried(self, FlowState.destinations)
        self._labels: Latest[IntArray] = self.latest()
        self._state = Memo[FlowState]()
        self._column = Memo[FloatArray]()
        self._places = Memo[FloatArray]()
        self._fine: Latest[abfm.Match] = self.latest()
        self._on_fine = Carried(self)  # along the flow as it is there
        self._fine_state = Memo[FlowState]()
        self._fine_columns: dict[str, Memo[FloatArray]] = defaultdict(Memo)
        self.is_behind = False  # `advected` gave another flow's or time's values lately

    @property
    def state(self) -> FlowState | None:
        """The flow, the same object for the same field; None before there is any."""
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
        """The shown time in the time of the flow (they differ after tau was changed)."""
        flow, time = self.state, self._session.time
        return time if flow is None else time * flow.parameters.tau / self._session.document.tau

    def advected(self) -> FloatArray | None:
        """The active channel's source at the shown time, (V,), on B where there are two surfaces;
        None before it was evaluated.
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
        carried = self._source.at(flow, source, time, self.settled)
        self.is_behind = self._source.behind
        return source if carried is None else carried

    def on_finer_mesh(self, name: str) -> tuple[TriangleMesh, FloatArray] | None:
        """Return the source, the target or the advected function, (V,), on the finer mesh on which
        the result was found; None where it was on none, that is not wanted, or not yet known.
        """
        session, result = self._session, self._session.result
        if result is None or session.snapshot is not None or session.outdated:
            return None
        if session.surface(name) is not session.surface():  # it is on A
            return None
        if not (session.view.finer and result.refined):
            return None
        fine = self._fine.ask(result, lambda: result.fine)
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
        carried = self._on_fine.at(state, source, time, self.settled)
        self.is_behind = self._on_fine.behind
        return None if carried is None else (fine.mesh, carried)

    def coordinates(self) -> FloatArray | None:
        """Return where each vertex's value came from at the shown time, (V, 3), by flow lines, of
        two surfaces on A; None before that is known.
        """
        flow, places = self.state, self._origins
        if flow is None or places is None:
            return places
        return self._coordinates.at(flow, places, self.time, self.settled)

    def labels(self) -> IntArray | None:
        """Return the labels of the source's surface where each vertex's value came from at the
        shown time, (V,), lately of an earlier one; None before that is known.
        """
        labels, places = self._session.document.labels, self.coordinates()
        if labels is None or places is None:
            return None
        mesh = self._session.surface("source").mesh
        return self._labels.newest((labels, places.shape), labels_at, mesh, labels.values, places)

    @property
    def _origins(self) -> FloatArray | None:
        """Where each vertex's value is at time 0, (V, 3)."""
        surface = self._session.surface()
        if self._session.surface("source") is surface:
            return surface.mesh.vertices
        if (prepared := self._session.work.prepared) is None:
            return None
        first = prepared.initial.correspondence.points
        return self._places.get((first,), lambda: first.positions)

    def destinations(self) -> FloatArray | None:
        """Return where each vertex goes until the shown time, (V, 3), by flow lines."""
        flow, vertices = self.state, self._session.surface().mesh.vertices
        if flow is None:
            return None
        return self._destinations.at(flow, vertices, self.time, settled=False)

    @property
    def is_ready(self) -> bool:
        """Return whether what the view carries along is known at all times of the flow."""
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
        """Return whether the time stands, so that exact values are worth computing."""
        stands_for = clock.perf_counter() - self._session.editor.time_changed
        return not self._session.player.playing and stands_for > _SETTLE_SECONDS

    @property
    def note(self) -> str:
        """Say why the time bar cannot be followed to its end; nothing if it can."""
        return self._source.error

    @property
    def problem(self) -> str:
        """Say why the shown time could not be computed exactly; nothing if it could."""
        return self._source.problem or self._coordinates.problem
