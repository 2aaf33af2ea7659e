"""The function between two frames of a sequence at any time: their blend, with the motion of the
field between them.
"""

from __future__ import annotations

from collections import OrderedDict
from functools import partial

import numpy as np

from abfm.sequences.between.interpolation import interpolate
from abfm.types import FloatArray
from abfm_viewer.computing.background import Jobs, Latest, Memo, same
from abfm_viewer.shown.flow_state import FlowState

_TIMES = 9  # of an interval at which it is computed; those between are blended
_NUMBERS_KEPT_MAX = 30_000_000  # numbers that are kept, in single precision


Frames = np.ndarray[tuple[int, ...], np.dtype[np.float32]]
"""A function (T, V) at evenly spaced times."""


def blended(frames: Frames, place: float) -> FloatArray:
    """Return the function at a place from 0 to T - 1, between the frames around it."""
    before = min(int(place), len(frames) - 2)
    first, second = frames[before], frames[before + 1]
    return np.asarray(first + np.float32(place - before) * (second - first))


def carried(
    flow: FlowState, before: FloatArray, after: FloatArray, shares: FloatArray
) -> FloatArray:
    """Return the function at shares (T,) of the interval, (T, V): as `abfm.Sequence.at` has it."""
    return interpolate(flow.flow, before, after, shares, flow.motion)


def _frames(flow: FlowState, before: FloatArray, after: FloatArray) -> Frames:
    shares = np.linspace(0, 1, _TIMES)
    return carried(flow, before, after, shares).astype(np.float32)


class InBetween:
    """Values at the shown time; computed intervals are kept, as films are played again."""

    def __init__(self, jobs: Jobs) -> None:
        self._at_once = jobs.at_once
        self._found: Latest[Frames] = jobs.latest()
        self._exact: Latest[FloatArray] = jobs.latest()
        self._kept: OrderedDict[tuple[float, ...], tuple[object, Frames]] = OrderedDict()
        self._shown = Memo[FloatArray]()
        self.is_behind = False

    def at(
        self, flow: FlowState | None, before: FloatArray, after: FloatArray, share: float
    ) -> FloatArray:
        """Return the function at a share of the interval, (V,): blended without a flow, or while
        what the flow carries is computed, where it `is_behind`.
        """
        self.is_behind = False
        if share in (0.0, 1.0):
            return before if share == 0 else after
        if flow is not None and self._at_once:
            key = (flow, before, after, share)
            given = flow, before, after, np.array([share])
            if (exact := self._exact.ask(key, lambda: carried(*given)[0])) is not None:
                return exact
        found = None if flow is None else self._frames(flow, before, after)
        self.is_behind = flow is not None and found is None
        if found is not None:
            return self._shown.get((found, share), partial(blended, found, share * (_TIMES - 1)))
        made_of = before, after, share
        return self._shown.get(made_of, lambda: (1 - share) * before + share * after)

    def prepare(self, flow: FlowState, before: FloatArray, after: FloatArray) -> None:
        """Compute another interval, if nothing else is computed."""
        if not (self._found.busy or self._at_once):
            self._frames(flow, before, after)

    @property
    def error(self) -> str:
        return self._found.error or self._exact.error

    def _frames(self, flow: FlowState, before: FloatArray, after: FloatArray) -> Frames | None:
        self._keep()
        made_of = (flow.found, before, after, flow.motion)
        number = _number(made_of)
        if number in self._kept and same(self._kept[number][0], made_of):
            self._kept.move_to_end(number)
            return self._kept[number][1]
        self._found.ask(made_of, partial(_frames, flow, before, after))
        self._keep()
        return self._kept[number][1] if number in self._kept else None

    def _keep(self) -> None:
        """Keep what was computed last; what was not used for long is left out."""
        key, value = self._found.key, self._found.value
        if not isinstance(key, tuple) or value is None:
            return
        self._kept.setdefault(_number(key), (key, value))
        most = max(_NUMBERS_KEPT_MAX // value.size, 4)
        while len(self._kept) > most:
            self._kept.popitem(last=False)


def _number(made_of: tuple[object, ...]) -> tuple[float, ...]:
    """Return what names an interval's frames: its arrays, the same objects, and numbers."""
    return tuple(each if isinstance(each, float) else id(each) for each in made_of)
