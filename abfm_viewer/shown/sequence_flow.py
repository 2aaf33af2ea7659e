"""The shown flow of a sequence, which has one field for each interval between two frames."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import replace
from functools import partial
from operator import attrgetter

import numpy as np

import abfm
from abfm import Parameters
from abfm.pages.sequence_motion import fast_speed_of
from abfm.types import FloatArray
from abfm_viewer.computing.background import Latest, Memo
from abfm_viewer.document.document import HODGE_PARTS, FieldPart
from abfm_viewer.document.kinds import SequenceDocument
from abfm_viewer.document.surface_points import surface_points
from abfm_viewer.session.session import Session
from abfm_viewer.shown import quantities
from abfm_viewer.shown.flow_state import FlowState
from abfm_viewer.shown.in_between import InBetween
from abfm_viewer.shown.quantities import Field, FieldQuantities, Streaks, convolved, field_part
from abfm_viewer.shown.shown_flow import ShownFlow

_STREAKS_BYTES_MAX = 300_000_000  # largest size of all cached streaks


def _sequence_document(session: Session) -> SequenceDocument:
    document = session.document
    assert isinstance(document, SequenceDocument)
    return document


class SequenceFlow(ShownFlow):
    """The flow of the interval at the shown time, from the run in progress or from the result."""

    def __init__(self, session: Session) -> None:
        super().__init__(session)
        self._between = InBetween(self)
        self._next = Memo[FlowState]()

    @property
    def state(self) -> FlowState | None:
        document = _sequence_document(self._session)
        return self._of_interval(document, document.interval, self._state)

    def _of_interval(
        self, document: SequenceDocument, interval: int, memo: Memo[FlowState]
    ) -> FlowState | None:
        run, sequence = self._session.sequence_match, document.sequence
        if (field := run.field(document, interval)) is None:
            return None
        tau = float(sequence.frames.durations[interval])
        motion = run.motion_share(document, interval)
        parameters = Parameters(tau=tau)
        make = partial(FlowState, sequence.frames.mesh, field, parameters, reach=1.0, motion=motion)
        return memo.get((field, tau, motion), make)

    def advected(self) -> FloatArray | None:
        """Return the function at the shown time, (V,); if playing, prepare the next interval."""
        document, session = _sequence_document(self._session), self._session
        columns, channel = document.sequence.columns, document.channel
        interval, share = document.interval, min(session.time / session.document.tau, 1.0)
        ends = columns[interval][channel], columns[interval + 1][channel]
        found = self._between.at(self.state, *ends, share)
        self.is_behind = self._between.is_behind
        after = interval + 1
        if session.player.playing and not self.is_behind and after < document.sequence.intervals:
            next_flow = self._of_interval(document, after, self._next)
            if next_flow is not None:
                ends = columns[after][channel], columns[after + 1][channel]
                self._between.prepare(next_flow, *ends)
        return found

    @property
    def is_ready(self) -> bool:
        return True

    @property
    def problem(self) -> str:
        return super().problem or self._between.error


class SequenceQuantities(FieldQuantities):
    """Quantities of the fields of a sequence; arrows have the same scale in all intervals."""

    def __init__(self, session: Session, flow: ShownFlow) -> None:
        super().__init__(session, flow)
        self._fast_in: Latest[float] = self.latest()
        self._cached_streaks: OrderedDict[tuple[object, ...], Streaks] = OrderedDict()

    def _part(self, flow: FlowState, segment: int, part: FieldPart) -> Field | None:
        unit = _sequence_document(self._session).sequence.unit_of_speed
        return self._field.newest(flow.mesh, _part_of_interval, flow, segment, part, unit)

    def _shares(self) -> FloatArray | None:
        document = _sequence_document(self._session)
        if document.result is None:
            return None
        if self._session.sequence_match.found_count(document):
            return None
        return self._determined.newest(document.sequence, attrgetter("determined"), document.result)

    def _row(self, flow: FlowState) -> int:
        return _sequence_document(self._session).interval

    def fast(self, field: Field) -> float | None:
        """Return the speed of the longest arrows in all intervals; it never decreases in a run."""
        document = _sequence_document(self._session)
        if self._session.view.part not in ("complete", *HODGE_PARTS):  # not of an interval
            return field.fast
        if (found := self._session.sequence_match.fast_speed(document)) or document.result is None:
            return found
        return self._fast_in.newest(document.sequence, fast_speed_of, document.result)

    def _streaks_of(self, field: Field, fade: bool, moving: bool) -> tuple[object, Streaks | None]:
        """Return the mesh, and the streaks of an interval, which are cached to be shown again.

        While streaks are computed, those of an earlier interval are returned; while the sequence is
        played, None.
        """
        cache, key = self._cached_streaks, _key_of(field, (fade, moving))
        if key in cache:
            cache.move_to_end(key)
            return field.mesh, cache[key]
        make = partial(convolved, field, quantities.TEXELS, fade, moving)
        found, last = self._streaks.request((field, fade, moving), make), self._streaks.value
        is_of_sequence = last is not None and last.field.interval_field is not None
        if last is not None and is_of_sequence and last.field.mesh is field.mesh:
            if any(each.field.mesh is not field.mesh for each in cache.values()):
                cache.clear()  # streaks of another sequence
            cache[_key_of(last.field, last.options)] = last
            while len(cache) > max(_STREAKS_BYTES_MAX // last.images.nbytes, 4):
                cache.popitem(last=False)
        if found is None and not self._session.player.playing:
            is_of_mesh = last is not None and last.field.mesh is field.mesh
            return field.mesh, last if is_of_mesh else None
        return field.mesh, found

    def paths(self) -> list[abfm.flow.FlowLine]:
        """Return the paths, through all intervals, of the points that follow the flow."""
        document = _sequence_document(self._session)
        flow, points, result = self.flow.state, document.points, document.result
        if flow is None or not points or result is None:
            return []
        total = document.end - document.start
        relative_durations = document.sequence.frames.durations * len(result) / total

        def through_all() -> list[abfm.flow.FlowLine]:
            starts = surface_points(flow.mesh, points)
            fields = result.velocity * relative_durations[:, None, None]  # of equal duration
            return abfm.flow.flow_lines(flow.mesh, fields, starts, total, total)

        return self._paths.request((result, points), through_all) or []

    @property
    def path_time(self) -> float:
        """The shown time in the unit of `paths`, in which all intervals have the same duration."""
        document = _sequence_document(self._session)
        even = np.linspace(0, document.end - document.start, len(document.sequence))
        return float(np.interp(document.time, document.sequence.times, even))


def _part_of_interval(flow: FlowState, segment: int, part: FieldPart, unit: str) -> Field:
    assert not callable(flow.field)
    part_of_field = field_part(flow, segment, part)
    return replace(part_of_field, interval_field=flow.field, part=part, unit=unit)


def _key_of(field: Field, options: tuple[bool, bool]) -> tuple[object, ...]:
    identity = id(field if field.interval_field is None else field.interval_field)
    return identity, field.part, *options
