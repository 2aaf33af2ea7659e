"""The flow that is shown, and functions carried along it to the time that is shown."""

from __future__ import annotations

import time as clock
from typing import TYPE_CHECKING

from abfm import Parameters
from abfm.types import FloatArray
from abfm_viewer.shown.carried import Carried, FlowState

if TYPE_CHECKING:
    from abfm import Iteration, Match
    from abfm_viewer.session.session import Session

_SETTLED = 0.15  # seconds without a new time after which it is worth computing exactly


class ShownFlow:
    """Of a session: the newest iterate's flow during a run, else the result's."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._source = Carried("source")
        self._coordinates = Carried("coordinates")
        self._latest: tuple[Match | Iteration, FlowState] | None = None
        self._latest_column: tuple[FloatArray, int, FloatArray] | None = None

    @property
    def flow(self) -> FlowState | None:
        """The flow; None before there is any."""
        session = self._session
        snapshot, result = session.solver.snapshot, session.result
        if snapshot is not None and snapshot.problem.mesh is session.mesh:
            return self._state(snapshot.shown, snapshot.problem.parameters, final=False)
        return None if result is None else self._state(result, result.parameters, final=True)

    def _state(self, found: Match | Iteration, parameters: Parameters, final: bool) -> FlowState:
        """The same object for the same field, which what is computed from it is kept for."""
        if self._latest is None or self._latest[0] is not found:
            self._latest = found, FlowState(self._session.mesh, lambda: found.velocity, parameters, final)
        return self._latest[1]

    @property
    def time(self) -> float:
        """The shown time in the time of the flow (they differ after tau was changed)."""
        flow, time = self.flow, self._session.time
        return time if flow is None else time * flow.parameters.tau / self._session.parameters.tau

    def advected(self) -> FloatArray | None:
        """The active channel's source at the shown time, (V,); None before it was evaluated."""
        session, flow = self._session, self.flow
        source = session.values("source")
        if source is None or flow is None:
            return source
        time, tau, channel = self.time, flow.parameters.tau, session.document.channel
        if abs(time - tau) <= 1e-9 * tau:
            snapshot, result = session.solver.snapshot, session.result
            if flow.final and result is not None and not session.outdated:
                return self._column(result.advected, channel)
            if not flow.final and snapshot is not None and len(snapshot.problem.channels) == len(session.channels):
                return self._column(snapshot.shown.advected, channel)
        carried = self._source.at(flow, source, time, self.settled)
        return source if carried is None else carried

    def _column(self, values: FloatArray, channel: int) -> FloatArray:
        """One channel of values (V, C): the same object every time, by which others know that nothing changed."""
        before = self._latest_column
        if before is None or before[0] is not values or before[1] != channel:
            before = self._latest_column = (values, channel, values[:, channel])
        return before[2]

    def coordinates(self) -> FloatArray | None:
        """The coordinates (V, 3) carried along to the shown time: where each vertex's value came from."""
        flow, vertices = self.flow, self._session.mesh.vertices
        return vertices if flow is None else self._coordinates.at(flow, vertices, self.time, self.settled)

    @property
    def settled(self) -> bool:
        """Whether the time does not move at present, so that exact values are worth computing."""
        session = self._session
        return not session.player.playing and clock.perf_counter() - session.time_changed > _SETTLED

    @property
    def busy(self) -> bool:
        """Whether better values will come."""
        return self._source.busy or self._coordinates.busy

    @property
    def note(self) -> str:
        """Why the time bar cannot be followed to its end; empty if it can."""
        return self._source.error

    @property
    def problem(self) -> str:
        """Why the shown time could not be computed exactly; empty if it could."""
        return self._source.problem or self._coordinates.problem

    def close(self) -> None:
        """Stop the threads."""
        self._source.close()
        self._coordinates.close()
