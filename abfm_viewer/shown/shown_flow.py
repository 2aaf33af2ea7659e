"""The flow that is shown, and functions carried along it to the time that is shown."""

from __future__ import annotations

import time as clock

import abfm
from abfm import Parameters
from abfm.types import FloatArray
from abfm_viewer.computing.background import Jobs, Memo
from abfm_viewer.session.session import Session
from abfm_viewer.shown.carried import Carried, FlowState

_SETTLED = 0.15  # seconds without a new time after which it is worth computing exactly


class ShownFlow(Jobs):
    """Of a session: the newest iterate's flow during a run, else the result's."""

    def __init__(self, session: Session) -> None:
        super().__init__(session.at_once)
        self._session = session
        self._source = Carried(self)
        self._coordinates = Carried(self)
        self._state = Memo[FlowState]()
        self._column = Memo[FloatArray]()
        self._is_behind = False

    @property
    def state(self) -> FlowState | None:
        """The flow, the same object for the same field; None before there is any."""
        session = self._session
        snapshot, result = session.snapshot, session.result
        if snapshot is not None:
            return self._of(snapshot.shown, snapshot.problem.parameters, final=False)
        return None if result is None else self._of(result, result.parameters, final=True)

    def _of(
        self, found: abfm.Match | abfm.Iteration, parameters: Parameters, final: bool
    ) -> FlowState:
        mesh = self._session.surface().mesh
        return self._state.get(
            (found,), lambda: FlowState(mesh, lambda: found.velocity, parameters, final)
        )

    @property
    def time(self) -> float:
        """The shown time in the time of the flow (they differ after tau was changed)."""
        flow, time = self.state, self._session.time
        return time if flow is None else time * flow.parameters.tau / self._session.parameters.tau

    def advected(self) -> FloatArray | None:
        """The active channel's source at the shown time, (V,); None before it was evaluated."""
        session, flow = self._session, self.state
        self._is_behind = False
        source = session.values("source")
        if source is None or flow is None:
            return source
        time, tau, channel = self.time, flow.parameters.tau, session.document.channel
        if abs(time - tau) <= 1e-9 * tau:
            snapshot = session.solver.snapshot
            found: abfm.Match | abfm.Iteration | None = None
            if flow.final:
                found = None if session.outdated else session.result
            elif snapshot is not None and len(snapshot.problem.channels) == len(session.channels):
                found = snapshot.shown
            if found is not None:
                columns = found.advected
                return self._column.get((columns, channel), lambda: columns[:, channel])
        carried = self._source.at(flow, source, time, self.settled)
        self._is_behind = self._source.behind
        return source if carried is None else carried

    @property
    def is_behind(self) -> bool:
        """Return whether `advected` gave another flow's or time's values lately."""
        return self._is_behind

    def coordinates(self) -> FloatArray | None:
        """Return the coordinates (V, 3) carried to the shown time: where each value came from."""
        flow, vertices = self.state, self._session.surface().mesh.vertices
        if flow is None:
            return vertices
        return self._coordinates.at(flow, vertices, self.time, self.settled)

    @property
    def is_ready(self) -> bool:
        """Return whether what the view carries along is known at all times of the flow."""
        session, state = self._session, self.state
        source = session.values("source")
        if state is None or source is None or not state.final:
            return True
        is_ready = self._source.is_ready(state, source)
        if session.view.coloring not in ("coordinates", "checker"):
            return is_ready
        return is_ready and self._coordinates.is_ready(state, session.surface().mesh.vertices)

    @property
    def settled(self) -> bool:
        """Return whether the time stands, so that exact values are worth computing."""
        stands_for = clock.perf_counter() - self._session.editor.time_changed
        return not self._session.player.playing and stands_for > _SETTLED

    @property
    def note(self) -> str:
        """Say why the time bar cannot be followed to its end; nothing if it can."""
        return self._source.error

    @property
    def problem(self) -> str:
        """Say why the shown time could not be computed exactly; nothing if it could."""
        return self._source.problem or self._coordinates.problem
