"""Sequences of frames: a function on a surface at several times.

Two consecutive frames are an interval.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

import abfm
from abfm import ParameterError
from abfm.display import ViewSpec
from abfm.pages.front import Front, changes_in_time, front_of
from abfm.types import FloatArray

GAMMA_MAX = 1e6
FRAMES_A_SECOND = 5.0  # frames per second at playing speed 1


@dataclass(frozen=True)
class SequenceSettings:
    """Parameters for matching all intervals; where a value is None, held-out data determine it."""

    alpha: float | None = None
    sigma: float | None = None
    gamma: float = 1.0  # weight of the difference between neighbouring fields
    order: int | None = None

    @property
    def parameters(self) -> abfm.sequences.SequenceParameters:
        """The settings as parameters of the solver; an invalid value raises a `ParameterError`."""
        return abfm.sequences.defaults(alpha=self.alpha, order=self.order, sigma=self.sigma)

    def check(self) -> None:
        _ = self.parameters
        if not 0 <= self.gamma <= GAMMA_MAX:
            raise ParameterError(f"gamma is {self.gamma:g}; expected 0 to {GAMMA_MAX:g}")


def settings_of(sequence: abfm.Sequence) -> SequenceSettings:
    given = sequence.parameters
    alpha = None if "alpha" in given.automatic else given.alpha
    order = None if "order" in given.automatic else given.order
    return SequenceSettings(alpha, given.sigma, sequence.gamma, order)


@dataclass(frozen=True, eq=False)
class FrameSequence:
    """Frames of a sequence, and the name of their file."""

    name: str
    frames: abfm.sequences.Frames
    phases: abfm.sequences.Frames | None = None  # phases of which the frames are cosine and sine

    def __len__(self) -> int:
        return len(self.frames.values)

    @property
    def unit(self) -> str:
        """Unit of the frames' times; empty if a time is the number of a frame."""
        return self.frames.unit_of_time

    @property
    def unit_of_speed(self) -> str:
        """Unit of all speeds that are shown for this sequence."""
        return f"the mesh's unit per {'second' if self.unit else 'frame'}"

    @property
    def times(self) -> FloatArray:
        return self.frames.times

    @cached_property
    def numbers(self) -> list[int]:
        """Numbers of the frames in their file, counted from 0; frames without values are absent."""
        return [*map(int, self.frames.numbers)]

    @property
    def channels(self) -> int:
        return int(self.frames.values.shape[2])

    @cached_property
    def columns(self) -> tuple[tuple[FloatArray, ...], ...]:
        """Functions (V,) by frame and channel; every access returns the same arrays."""
        return tuple(
            tuple(np.ascontiguousarray(frame[:, channel]) for channel in range(self.channels))
            for frame in self.frames.values
        )

    @cached_property
    def period(self) -> float | None:
        """Period of the values if the first frame seems to consist of phases; None otherwise."""
        mesh = self.frames.mesh
        found = (abfm.functions.wrapped_period(mesh, values) for values in self.columns[0])
        return next((period for period in found if period is not None), None)

    @property
    def intervals(self) -> int:
        return len(self) - 1

    @cached_property
    def middles(self) -> FloatArray:
        """Time in the middle of each interval, (T - 1,)."""
        return 0.5 * (self.times[1:] + self.times[:-1])

    def interval(self, time: float) -> int:
        """Return the number of the interval at a time; at a frame, the next or else the last."""
        after = int(np.searchsorted(self.times, time, side="right"))
        return min(max(after - 1, 0), self.intervals - 1)

    def next_frame(self, time: float, step: int) -> float:
        """Return the time of the next frame, or of the previous one if ``step`` is negative."""
        tolerance = 1e-9 * float(self.times[-1] - self.times[0])
        if step > 0:
            number = int(np.searchsorted(self.times, time + tolerance, side="right"))
        else:
            number = int(np.searchsorted(self.times, time - tolerance, side="left")) - 1
        return float(self.times[min(max(number, 0), len(self) - 1)])

    def time_text(self, time: float) -> str:
        return f"{time:.4g} {self.unit}".strip()

    def precise_time(self, time: float) -> str:
        """Return a time as text, to a hundredth of a frame, with a fixed number of decimals."""
        step = float(np.median(np.diff(self.times)))
        digits = max(0, 2 - math.floor(math.log10(step) + 1e-9))
        text = f"{time:.{min(digits, 9)}f}"
        return f"{text} {self.unit}" if self.unit else f"frame {text}"

    def front(self, view: ViewSpec) -> Front:
        """Return the side from which the frames are shown; the best view shows the changes."""
        changes = changes_in_time(self.frames.values)
        if (unknown := self.frames.unknown) is not None:
            changes[unknown] = 0.0
        return front_of(self.frames.mesh, view=view, changes=changes)

    def frame_label(self, index: int) -> str:
        """Return the number of a frame as text, with its time if that differs from the number."""
        time, number = float(self.times[index]), self.numbers[index]
        is_number = not self.unit and time == number
        return f"frame {number}" if is_number else f"frame {number}, {self.time_text(time)}"
