"""Checked frames of a function that changes in time, the input of a sequence."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from abfm.calculus.channels import extension, vertex_count_text
from abfm.errors import FunctionError, ParameterError
from abfm.functions.circular import warn_of_phases
from abfm.matching.problem import Problem
from abfm.matching.terms.functions import (
    CONSTANT_SHARE,
    FunctionTerm,
    checked_weights,
    mask_from_input,
    mask_of_known,
)
from abfm.mesh import TriangleMesh
from abfm.numerics.real_numbers import real_numbers
from abfm.parameters import Parameters
from abfm.reading import counts_of
from abfm.sequences.parameters import SequenceParameters
from abfm.types import BoolArray, FloatArray, IntArray
from abfm.wording import counted
from abfm.workers.progress import stepped


@dataclass(frozen=True, eq=False)
class Frames:
    """Functions (T, V, C) at ascending times (T,), on a mesh, finite everywhere.

    The mask (V,) is 0 at vertices whose value is missing in some frame. Values there are extended
    from neighbouring vertices.
    """

    mesh: TriangleMesh
    values: FloatArray = field(repr=False)
    times: FloatArray = field(repr=False)
    mask: FloatArray | None = field(repr=False)
    weights: FloatArray  # (C,)
    channels_given: bool  # True if the input had the shape (T, V, C), False for (T, V)
    numbers: IntArray = field(repr=False)  # (T,), numbers of the frames in the input, from 0
    notes: tuple[str, ...] = ()  # notes for the user about the frames
    unit_of_time: str = ""  # "s" if times are known; empty if they are frame numbers

    @property
    def durations(self) -> FloatArray:
        """Duration of each interval, (T - 1,)."""
        return np.diff(self.times)

    @cached_property
    def deviation(self) -> float:
        """Size of the frames, the unit of a relative sigma.

        The size is the root mean square, over frames, of the L2 norm of each frame minus its mean.
        The mesh has unit area, and all channels count. The size is 1 if all frames are constant.
        """
        term = FunctionTerm(
            self.mesh.normalized(), self.values[0], self.values[0], self.mask, self.weights
        )
        rows = [np.ascontiguousarray(frame.T) for frame in self.values]
        deviations = np.array([term.deviation(row) for row in rows])
        norms = np.array([term.norm(row) for row in rows])
        deviations[deviations <= CONSTANT_SHARE * norms] = 0.0
        return float(np.sqrt(np.mean(deviations**2))) or 1.0

    @cached_property
    def unknown(self) -> BoolArray | None:
        """Mask (V,) of the vertices with filled-in values; None if there are none."""
        return None if self.mask is None or self.mask.all() else np.asarray(self.mask == 0)

    def problem(self, interval: int, parameters: Parameters) -> Problem:
        """Return the matching problem of an interval, from its first frame to its second."""
        return self.between(interval, interval + 1, parameters)

    def between(self, first: int, last: int, parameters: Parameters) -> Problem:
        """Return the matching problem from frame ``first`` to frame ``last``."""
        f, g = (self.values[frame] for frame in (first, last))
        if not self.channels_given:
            f, g = f[:, 0], g[:, 0]
        mask, weights = self.mask, self.weights
        return Problem(self.mesh, f, g, parameters, mask=mask, weights=weights, circular=None)


def check_frames(
    mesh: TriangleMesh,
    values: ArrayLike,
    times: ArrayLike | None,
    mask: ArrayLike | None,
    weights: ArrayLike | None,
) -> Frames:
    """Check frames (T, V) or (T, V, C), and fill in unknown values.

    The vertices are those of the mesh or of its file. Frames without any finite value are left out,
    which a note reports. Values are unknown at vertices where some other frame is not finite, or
    where the mask is 0.
    """
    given = real_numbers(values, "frames", FunctionError)
    if given.ndim not in (2, 3) or given.size == 0:
        raise FunctionError(
            f"frames have shape {given.shape}; expected (T, V) or (T, V, C), a row for each frame"
        )
    if given.shape[1] not in counts_of(mesh):
        number = mesh.file_vertex_count
        raise FunctionError(
            f"frames have shape {given.shape}, but {vertex_count_text(mesh)}; expected "
            f"(T, {number}) or (T, {number}, C), a row for each frame"
        )
    if len(given) < 2:
        raise FunctionError("there is only one frame; expected at least two")
    restricted = np.moveaxis(mesh.restrict(np.moveaxis(given, 1, 0)), 0, 1)
    frames = restricted.reshape(*restricted.shape[:2], -1)
    if np.may_share_memory(frames, given):  # a copy, as frames are modified below
        frames = frames.copy()
    channel_weights = checked_weights(weights, frames.shape[2], "weights", "channel")
    warn_of_phases(mesh, frames[0].T)
    is_weighted = channel_weights > 0
    all_times, has_values = _times(times, len(frames)), have_values(frames, channel_weights)
    if has_values.sum() < 2:
        found = "only one" if has_values.any() else "no"
        raise FunctionError(f"{found} frame has a finite value; expected at least two such frames")
    if not has_values.all():
        frames = frames[has_values]
    compared_frames = frames[:, :, _compared(channel_weights)]
    known: BoolArray = np.asarray(np.isfinite(compared_frames).all(axis=(0, 2)))
    if not known.any():
        raise FunctionError(
            "no vertex has finite values in all frames. Remove the frames with missing values"
        )
    vertex_mask = mask_of_known(mask_from_input(mesh, mask), known)
    compared = known if vertex_mask is None else vertex_mask > 0
    if not compared.any():
        raise FunctionError(
            "no vertex with a mask above 0 has finite values in all frames. Give a mask above 0 "
            "at vertices with values"
        )
    _fill_in(mesh, frames, compared, is_weighted)
    frames.flags.writeable = False
    return Frames(
        mesh,
        frames,
        all_times[has_values],
        vertex_mask,
        channel_weights,
        given.ndim == 3,
        np.flatnonzero(has_values),
        notes_on_omitted(has_values),
        unit_of_time="" if times is None else "s",
    )


def have_values(frames: FloatArray, weights: ArrayLike | None = None) -> BoolArray:
    """Return a mask (T,) of the frames (T, V) or (T, V, C) with a finite value.

    Only channels of a weight (C,) above 0 count, or all if there is none.
    """
    by_channel = frames.reshape(*frames.shape[:2], -1)
    channel_weights = np.ones(by_channel.shape[2]) if weights is None else np.asarray(weights)
    return np.asarray(np.isfinite(by_channel[:, :, _compared(channel_weights)]).any(axis=(1, 2)))


def notes_on_omitted(has_values: BoolArray) -> tuple[str, ...]:
    """Return a note on the frames that are left out, if ``has_values`` (T,) is False for some."""
    omitted = np.flatnonzero(~has_values)
    named = ", ".join(map(str, omitted[:5])) + ", ..." * (len(omitted) > 5)
    frames = counted(len(omitted), "frame")
    text = f"{frames} without values left out, counted from 0: {named}"
    return (text,) if len(omitted) else ()


def _compared(weights: FloatArray) -> BoolArray:
    """Return a mask (C,) of the channels that are compared: of a weight above 0, or all."""
    return np.asarray((weights > 0) | ~(weights > 0).any())


def sigma_of(frames: Frames, given: SequenceParameters, sigma: float, duration: float) -> float:
    """Return the absolute sigma of an interval, from the sigma of the sequence and the duration.

    It is proportional to sqrt(duration), to balance the energy terms, and to the size of the frames
    if the sigma is relative.
    """
    unit = frames.deviation if given.sigma_unit == "relative" else 1.0
    return float(sigma * unit * np.sqrt(duration))


def interval_parameters(
    frames: Frames, given: SequenceParameters, sigma: float, interval: int
) -> Parameters:
    """Return the parameters of the problem of an interval, with its duration as tau."""
    duration = float(frames.durations[interval])
    return given.for_interval(duration, sigma_of(frames, given, sigma, duration))


def _fill_in(
    mesh: TriangleMesh, frames: FloatArray, compared: BoolArray, is_weighted: BoolArray
) -> None:
    """Extend frames (T, V, C), in place, from the compared vertices to all others.

    Advection would otherwise spread values of other vertices to compared ones. Channels of weight 0
    may have additional missing values.
    """
    extend_compared = extension(mesh, compared)
    for channel, has_weight in enumerate(is_weighted):
        channel_frames = frames[:, :, channel]
        known = compared if has_weight else compared & np.isfinite(channel_frames).all(axis=0)
        if not known.any():
            channel_frames[:] = 0.0
        elif not known.all():
            fill = extend_compared if has_weight else extension(mesh, known)
            with stepped("filling in missing values", channel_frames) as frames_in_step:
                for frame in frames_in_step:
                    frame[:] = fill(frame)


def _times(given: ArrayLike | None, count: int) -> FloatArray:
    if given is None:
        return np.arange(float(count))
    times = real_numbers(given, "times", ParameterError)
    if times.shape != (count,):
        raise ParameterError(
            f"times have shape {times.shape}; expected ({count},), one for each frame"
        )
    with np.errstate(all="ignore"):
        durations = np.diff(times)
    wrong = np.flatnonzero(~(np.isfinite(durations) & (durations > 0)))
    if len(wrong):
        one, other = times[wrong[0] : wrong[0] + 2]
        raise ParameterError(
            f"times must be finite and strictly increasing; frame {wrong[0]} has {one:g}, the next "
            f"frame {other:g}"
        )
    return times.copy()
