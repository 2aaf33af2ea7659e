"""Interpolation between consecutive frames of a sequence, along the field of their interval.

A frame is one image of a sequence: a function on the surface at one time.
"""

from collections import OrderedDict
from functools import partial

import numpy as np

from abfm.sequences.between.interpolation import interpolate
from abfm.types import FloatArray
from abfm_viewer.computing.background import Jobs, Latest, Memo, same
from abfm_viewer.shown.flow_state import FlowState

_TIMES = 9  # number of times computed in each interval; others are blends
_CACHED_NUMBERS_MAX = 30_000_000  # numbers in the cache, in single precision


Frames = np.ndarray[tuple[int, ...], np.dtype[np.float32]]
"""A function (T, V) at evenly spaced times."""


def blended(frames: Frames, place: float) -> FloatArray:
    """Return the frames (T, V) linearly interpolated at an index from 0 to T - 1, (V,)."""
    before = min(int(place), len(frames) - 2)
    first, second = frames[before], frames[before + 1]
    return np.asarray(first + np.float32(place - before) * (second - first))


def interpolated(
    flow: FlowState, before: FloatArray, after: FloatArray, shares: FloatArray
) -> FloatArray:
    """Return the function between frames ``before`` and ``after`` (V,), as `abfm.Sequence.at` does.

    ``shares`` (T,) are the times, as fractions of the interval; the result is (T, V).
    """
    return interpolate(flow.flow, before, after, shares, flow.motion)


def _frames(flow: FlowState, before: FloatArray, after: FloatArray) -> Frames:
    shares = np.linspace(0, 1, _TIMES)
    return interpolated(flow, before, after, shares).astype(np.float32)


class InBetween:
    """Computes functions between the frames of a sequence, and caches them for replay."""

    def __init__(self, jobs: Jobs) -> None:
        self._at_once = jobs.at_once
        self._found: Latest[Frames] = jobs.latest()
        self._exact: Latest[FloatArray] = jobs.latest()
        self._cache: OrderedDict[tuple[float, ...], tuple[object, Frames]] = OrderedDict()
        self._shown = Memo[FloatArray]()
        self.is_behind = False

    def at(
        self, flow: FlowState | None, before: FloatArray, after: FloatArray, share: float
    ) -> FloatArray:
        """Return the function (V,) at a share, from 0 to 1, of the interval between two frames.

        It is interpolated along ``flow``. Without a flow, and while the interpolation is computed
        (`is_behind` is true), it is the linear blend of the frames.
        """
        self.is_behind = False
        if share in (0.0, 1.0):
            return before if share == 0 else after
        if flow is not None and self._at_once:
            key = (flow, before, after, share)
            given = flow, before, after, np.array([share])
            if (exact := self._exact.request(key, lambda: interpolated(*given)[0])) is not None:
                return exact
        found = None if flow is None else self._frames(flow, before, after)
        self.is_behind = flow is not None and found is None
        if found is not None:
            return self._shown.get((found, share), partial(blended, found, share * (_TIMES - 1)))
        inputs = before, after, share
        return self._shown.get(inputs, lambda: (1 - share) * before + share * after)

    def prepare(self, flow: FlowState, before: FloatArray, after: FloatArray) -> None:
        """Compute the functions of an interval that is shown later, unless a job is running."""
        if not (self._found.busy or self._at_once):
            self._frames(flow, before, after)

    @property
    def error(self) -> str:
        return self._found.error or self._exact.error

    def _frames(self, flow: FlowState, before: FloatArray, after: FloatArray) -> Frames | None:
        self._store()
        inputs = (flow.field, before, after, flow.motion)
        key = _cache_key(inputs)
        if key in self._cache and same(self._cache[key][0], inputs):
            self._cache.move_to_end(key)
            return self._cache[key][1]
        self._found.request(inputs, partial(_frames, flow, before, after))
        self._store()
        return self._cache[key][1] if key in self._cache else None

    def _store(self) -> None:
        """Move the latest computed interval to the cache; drop intervals unused for longest."""
        inputs, value = self._found.key, self._found.value
        if not isinstance(inputs, tuple) or value is None:
            return
        self._cache.setdefault(_cache_key(inputs), (inputs, value))
        entries_max = max(_CACHED_NUMBERS_MAX // value.size, 4)
        while len(self._cache) > entries_max:
            self._cache.popitem(last=False)


def _cache_key(inputs: tuple[object, ...]) -> tuple[float, ...]:
    """Return a hashable key of an interval: numbers, and the `id` of each array."""
    return tuple(each if isinstance(each, float) else id(each) for each in inputs)
