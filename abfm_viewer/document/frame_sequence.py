"""A film: a function on a surface that changes in time, as frames."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

import abfm
from abfm import ParameterError
from abfm.pages.front import Front, best_front, changes_in_time
from abfm.types import FloatArray

GAMMA_MAX = 1e6
FRAMES_A_SECOND = 5.0
"""How many are played at speed 1."""


@dataclass(frozen=True)
class SequenceSettings:
    """What all intervals are matched with; None is chosen by held-out data."""

    alpha: float | None = None
    sigma: float | None = None
    gamma: float = 1.0  # how much neighbouring fields are held together
    order: int | None = None

    @property
    def parameters(self) -> abfm.sequences.SequenceParameters:
        """The parameters of the sequence; ParameterError if a value is refused."""
        return abfm.sequences.defaults(alpha=self.alpha, order=self.order, sigma=self.sigma)

    def check(self) -> None:
        """Raise a ParameterError if a value is refused."""
        _ = self.parameters
        if not 0 <= self.gamma <= GAMMA_MAX:
            raise ParameterError(f"gamma is {self.gamma:g}; expected 0 to {GAMMA_MAX:g}")


def settings_of(sequence: abfm.Sequence) -> SequenceSettings:
    """Return the settings that a sequence was found with."""
    given = sequence.parameters
    alpha = None if "alpha" in given.automatic else given.alpha
    order = None if "order" in given.automatic else given.order
    return SequenceSettings(alpha, given.sigma, sequence.gamma, order)


@dataclass(frozen=True, eq=False)
class FrameSequence:
    """Frames, numbered from 0, and the name of their file. Of frames that are cosine and sine of
    ``phases`` also these.
    """

    name: str
    frames: abfm.sequences.Frames
    phases: abfm.sequences.Frames | None = None

    def __len__(self) -> int:
        """Return how many frames there are."""
        return len(self.frames.values)

    @property
    def unit(self) -> str:
        """Unit of the times; empty if they are numbers of frames."""
        return self.frames.unit_of_time

    @property
    def unit_of_speed(self) -> str:
        """That of all speeds that are told of a film."""
        return f"the mesh's unit per {'second' if self.unit else 'frame'}"

    @property
    def times(self) -> FloatArray:
        return self.frames.times

    @property
    def channels(self) -> int:
        return int(self.frames.values.shape[2])

    @cached_property
    def columns(self) -> tuple[tuple[FloatArray, ...], ...]:
        """Functions (V,) by frame and channel, always the same arrays."""
        return tuple(
            tuple(np.ascontiguousarray(frame[:, channel]) for channel in range(self.channels))
            for frame in self.frames.values
        )

    @cached_property
    def period(self) -> float | None:
        """The period by which values of the first frame jump, as phases do, or None."""
        mesh = self.frames.mesh
        found = (abfm.functions.wrapped_period(mesh, values) for values in self.columns[0])
        return next((period for period in found if period is not None), None)

    @property
    def intervals(self) -> int:
        return len(self) - 1

    @cached_property
    def middles(self) -> FloatArray:
        """The middle of each interval, (T - 1,)."""
        return 0.5 * (self.times[1:] + self.times[:-1])

    def interval(self, time: float) -> int:
        """Return the interval of a time: at a frame the one after it, if there is one."""
        after = int(np.searchsorted(self.times, time, side="right"))
        return min(max(after - 1, 0), self.intervals - 1)

    def next_frame(self, time: float, step: int) -> float:
        """Return the time of the next frame after a time, or before it."""
        near = 1e-9 * float(self.times[-1] - self.times[0])
        if step > 0:
            number = int(np.searchsorted(self.times, time + near, side="right"))
        else:
            number = int(np.searchsorted(self.times, time - near, side="left")) - 1
        return float(self.times[min(max(number, 0), len(self) - 1)])

    def time_text(self, time: float) -> str:
        """Return a time in words."""
        return f"{time:.4g} {self.unit}".strip()

    def precise_time(self, time: float) -> str:
        """Return a time to a hundredth of a frame, always as long."""
        step = float(np.median(np.diff(self.times)))
        digits = max(0, 2 - math.floor(math.log10(step) + 1e-9))
        text = f"{time:.{min(digits, 9)}f}"
        return f"{text} {self.unit}" if self.unit else f"frame {text}"

    def front(self, up: str | None = None) -> Front:
        """The side from which most of what changes in time is seen, where it was measured."""
        changes = changes_in_time(self.frames.values)
        if (unknown := self.frames.unknown) is not None:
            changes[unknown] = 0.0
        return best_front(self.frames.mesh, up=up, changes=changes)

    def frame_label(self, number: int) -> str:
        """Return a frame's number, and its time where that is another one."""
        time = float(self.times[number])
        is_number = not self.unit and time == number
        return f"frame {number}" if is_number else f"frame {number}, {self.time_text(time)}"
