"""Frames of a function that changes in time, checked: what a sequence is made of."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from abfm.calculus.channels import extension
from abfm.errors import FunctionError, ParameterError
from abfm.functions.circular import warn_of_phases
from abfm.matching.problem import Problem
from abfm.matching.terms.functions import (
    CONSTANT,
    FunctionTerm,
    checked_weights,
    mask_from_input,
    mask_of_known,
)
from abfm.mesh import TriangleMesh
from abfm.numerics.real_numbers import real_numbers
from abfm.parameters import Parameters
from abfm.sequences.parameters import SequenceParameters
from abfm.types import BoolArray, FloatArray
from abfm.workers.progress import stepped


@dataclass(frozen=True, eq=False)
class Frames:
    """Functions (T, V, C) at ascending times (T,), on a mesh, finite everywhere; a mask (V,) is 0
    where they were not. Where it is 0, they are filled in from around.
    """

    mesh: TriangleMesh
    values: FloatArray = field(repr=False)
    times: FloatArray = field(repr=False)
    mask: FloatArray | None = field(repr=False)
    weights: FloatArray  # (C,)
    channels_given: bool  # they came as (T, V, C); else as (T, V)
    notes: tuple[str, ...] = ()  # what a user should know of them
    unit_of_time: str = ""  # "s" if times are known; empty if they are numbers of frames

    @property
    def durations(self) -> FloatArray:
        """How long each interval lasts, (T - 1,)."""
        return np.diff(self.times)

    @cached_property
    def deviation(self) -> float:
        """Root of the mean, over frames, of the square of the deviation from the frame's mean in
        L2, on the mesh of unit area, over all channels; 1 where all are constants.
        """
        term = FunctionTerm(
            self.mesh.normalized(), self.values[0], self.values[0], self.mask, self.weights
        )
        rows = [np.ascontiguousarray(frame.T) for frame in self.values]
        deviations = np.array([term.deviation(row) for row in rows])
        norms = np.array([term.norm(row) for row in rows])
        deviations[deviations <= CONSTANT * norms] = 0.0
        return float(np.sqrt(np.mean(deviations**2))) or 1.0

    @cached_property
    def unknown(self) -> BoolArray | None:
        """Where values are filled in, (V,); None where nowhere."""
        return None if self.mask is None or self.mask.all() else np.asarray(self.mask == 0)

    def problem(self, interval: int, parameters: Parameters) -> Problem:
        """Return the problem between a frame and the next."""
        return self.between(interval, interval + 1, parameters)

    def between(self, first: int, last: int, parameters: Parameters) -> Problem:
        """Return the problem between any two frames."""
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
    """Check frames (T, V) or (T, V, C), of the mesh or of its file, and fill in what is unknown:
    what is not finite in some frame, or where the mask is 0.
    """
    given = real_numbers(values, "frames", FunctionError)
    if given.ndim not in (2, 3) or given.size == 0:
        raise FunctionError(
            f"frames have shape {given.shape}; expected (T, V) or (T, V, C), a row for each frame"
        )
    if len(given) < 2:
        raise FunctionError("there is one frame; expected at least two, to go from one to the next")
    restricted = np.moveaxis(mesh.restrict(np.moveaxis(given, 1, 0)), 0, 1)
    frames = restricted.reshape(*restricted.shape[:2], -1)
    if np.may_share_memory(frames, given):  # which is filled in below
        frames = frames.copy()
    of_channels = checked_weights(weights, frames.shape[2], "weights", "channel")
    warn_of_phases(mesh, frames[0].T)
    counted = of_channels > 0
    finite = np.isfinite(frames)[:, :, counted if counted.any() else slice(None)]
    if not finite.any():
        raise FunctionError("no frame has a finite value; expected real numbers")
    if len(nowhere := np.flatnonzero(~finite.any(axis=(1, 2)))):
        named = ", ".join(map(str, nowhere[:5])) + ", ..." * (len(nowhere) > 5)
        raise FunctionError(
            f"without a finite value, counted from 0: frame {named}; leave out such frames, and "
            "give the times of the others"
        )
    known: BoolArray = np.asarray(finite.all(axis=(0, 2)))
    if not known.any():
        raise FunctionError("no vertex has values that are finite in all frames")
    of_vertices = mask_of_known(mask_from_input(mesh, mask), known)
    seen = known if of_vertices is None else of_vertices > 0
    if not seen.any():
        raise FunctionError(
            "no vertex that the mask counts has values that are finite in all frames; give weights "
            "above 0 where there are values"
        )
    _fill_in(mesh, frames, seen, counted)
    frames.flags.writeable = False
    return Frames(
        mesh,
        frames,
        _times(times, len(frames)),
        of_vertices,
        of_channels,
        given.ndim == 3,
        unit_of_time="" if times is None else "s",
    )


def sigma_of(frames: Frames, given: SequenceParameters, sigma: float, duration: float) -> float:
    """Return the absolute sigma of an interval of that duration, by which the balance of both terms
    is the same for all durations.
    """
    unit = frames.deviation if given.sigma_unit == "relative" else 1.0
    return float(sigma * unit * np.sqrt(duration))


def interval_parameters(
    frames: Frames, given: SequenceParameters, sigma: float, interval: int
) -> Parameters:
    """Return the parameters of the problem of an interval: its duration as tau."""
    duration = float(frames.durations[interval])
    absolute = sigma_of(frames, given, sigma, duration)
    return given.for_interval(duration, absolute)


def _fill_in(mesh: TriangleMesh, frames: FloatArray, seen: BoolArray, counted: BoolArray) -> None:
    """Extend frames (T, V, C) to vertices that are not seen: what stands there would be carried to
    those that are. A channel that does not count may lack more, or all.
    """
    of_seen = extension(mesh, seen)
    for channel, counts in enumerate(counted):
        film = frames[:, :, channel]
        known = seen if counts else seen & np.isfinite(film).all(axis=0)
        if not known.any():
            film[:] = 0.0
        elif not known.all():
            fill = of_seen if counts else extension(mesh, known)
            with stepped("filling in what is not compared", film) as counted_frames:
                for frame in counted_frames:
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
            f"times must be finite, and each later than the one before: of frame {wrong[0]} it is "
            f"{one:g}, of the next {other:g}"
        )
    return times.copy()
