"""Functions carried along the flow: spans of times in memory, so that scrubbing costs a blend."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

import abfm
from abfm import AbfmError, Parameters, TriangleMesh
from abfm.types import FloatArray
from abfm_viewer.computing.background import Jobs, Latest, Memo
from abfm_viewer.document.document import EXTRAPOLATION

_TIMES, _TIMES_WHILE_SOLVING = 61, 17
_LONGEST = 60_000_000  # numbers in a span, as float32
_LARGEST = 1e37  # value that can be shown in single precision


@dataclass(frozen=True, eq=False)
class FlowState:
    """A field and the parameters it was found with; two are the same only if they are one object.

    The field (N, F, 3) may be given by what computes it: that of a coarse mesh takes a while to be
    read on a fine one.
    """

    mesh: TriangleMesh
    found: FloatArray | Callable[[], FloatArray]
    parameters: Parameters
    final: bool = True  # a result, and not an iterate

    @cached_property
    def velocity(self) -> FloatArray:
        """The fields (N, F, 3); not to be asked for in the frame loop."""
        return self.found() if callable(self.found) else self.found

    def carry(self, function: FloatArray, times: FloatArray) -> FloatArray:
        """A function (V,) or (V, C) at times (T,): (T, V) or (T, V, C).

        Raises
        ------
        AdvectionError
            If the flow is too long, or overflows the single precision of what can be shown.
        """
        carried = abfm.Flow(
            self.mesh, self.velocity, self.parameters.tau, self.parameters.method
        ).push(function, times)
        if np.abs(carried).max() > _LARGEST:
            raise abfm.AdvectionError(
                "the function overflows on its way: the discrete flow is unstable over this time"
            )
        return carried


@dataclass(frozen=True, eq=False)
class Span:
    """A function at evenly spaced times (T,), as (T, V) or (T, V, C) in single precision."""

    times: FloatArray
    frames: np.ndarray[tuple[int, ...], np.dtype[np.float32]]
    note: str = ""  # why it ends before the time bar does; empty if it does not

    def at(self, time: float) -> FloatArray:
        """The function at a time; the last one known for times after the end."""
        position = float(np.interp(time, self.times, np.arange(len(self.times))))
        before = min(int(position), len(self.times) - 2)
        blend = np.float32(position - before)
        return np.asarray(
            self.frames[before] + blend * (self.frames[before + 1] - self.frames[before])
        )


def span(state: FlowState, function: FloatArray) -> Span:
    """A function over the whole time bar, or up to tau where the flow overflows beyond."""
    wanted = _TIMES if state.final else _TIMES_WHILE_SOLVING
    count = int(np.clip(_LONGEST // function.size, 9, wanted)) // 2 * 2 + 1
    tau = state.parameters.tau
    times = np.linspace(0, EXTRAPOLATION * tau, count)
    try:
        return Span(times, state.carry(function, times).astype(np.float32))
    except AbfmError as error:
        times = np.linspace(0, tau, count)
        return Span(
            times, state.carry(function, times).astype(np.float32), f"not beyond τ: {error}"
        )


class Carried:
    """One function, carried to the time that is shown: at once from a span, and exactly as soon as
    possible.

    Asked for the same again, it gives the same array, by which others know that nothing changed. It
    is `behind` while what it gave last is of another flow or time than it was asked for.
    """

    def __init__(self, jobs: Jobs) -> None:
        self._span: Latest[Span] = jobs.latest()
        self._exact: Latest[FloatArray] = jobs.latest()
        self._blended = Memo[FloatArray]()
        self._at_once = jobs.at_once
        self.behind = False

    @property
    def problem(self) -> str:
        """Say why the exact values asked for last could not be computed."""
        return self._exact.error

    @property
    def error(self) -> str:
        """Say why there are no values, or only up to tau; nothing if all is well."""
        return self._span.error or (self._span.value.note if self._span.value else "")

    def is_ready(self, state: FlowState, function: FloatArray) -> bool:
        """Return whether a function is known at all times of a flow, or cannot be."""
        if not self._at_once:
            self._span.newest(function.shape, (state, function), partial(span, state, function))
        return not self._span.busy

    def at(
        self, state: FlowState, function: FloatArray, time: float, settled: bool
    ) -> FloatArray | None:
        """Values at a time, those of an earlier flow or function while new ones come, None before
        any.

        A time that is settled, as it does not move at present, is computed exactly.
        """
        self.behind = False
        if time == 0:
            return function
        exact = partial(
            self._exact.ask,
            (state, function, time),
            lambda: state.carry(function, np.array([time]))[0],
        )
        if self._at_once:
            return exact()
        known = self._span.newest(function.shape, (state, function), partial(span, state, function))
        self.behind = state.final and self._span.busy
        if known is None:
            return None
        values = None
        if settled and state.final and not self._span.busy and time <= known.times[-1]:
            values = exact()
        if values is not None:
            return values
        return self._blended.get((known, time), partial(known.at, time))
