"""A sequence of functions on a surface, and the fields whose flows map each frame to the next."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from abfm.calculus.operators import Matrix, curl, divergence, face_areas
from abfm.calculus.vector_fields import helmholtz_hodge, to_ambient, to_frame
from abfm.display import Display
from abfm.errors import FunctionError, ParameterError, brief
from abfm.flow.continuous_flow import ContinuousFlow
from abfm.flow.flow import Flow
from abfm.functions.circular import circular_frames
from abfm.io import results
from abfm.maps.surface_points import SurfacePoints, vertex_points
from abfm.matching.judging.verdict import Verdict
from abfm.matching.problem import Problem
from abfm.matching.result import Match
from abfm.matching.solving.record import StopReason
from abfm.matching.terms.functions import VALUE_MAX
from abfm.mesh import MeshLike, TriangleMesh, as_mesh
from abfm.numerics.real_numbers import is_finite_number
from abfm.outcome import Facts
from abfm.parameters import Parameters
from abfm.sequences.between.interpolation import interpolate
from abfm.sequences.between.motion_evidence import MotionEvidence, motion_evidence
from abfm.sequences.checkpoint_file import SequenceCheckpoint
from abfm.sequences.frames import Frames, check_frames, interval_parameters
from abfm.sequences.noise import noise_floor, noise_levels
from abfm.sequences.parameters import SequenceParameters, checked_parameters
from abfm.sequences.phase_times import work_of
from abfm.sequences.reading.reading_frames import frames_of
from abfm.sequences.solution import Solution
from abfm.sequences.solving.choosing import SIGMA_MAX, SIGMA_MIN
from abfm.sequences.solving.solve import IntervalMeasures, SequenceSolver
from abfm.sequences.tracking.critical_points import CriticalPoints, critical_points
from abfm.sequences.tracking.episodes import Episode, episodes
from abfm.sequences.tracking.tracks import Track, tracks
from abfm.sequences.uncertainty import Posterior, posterior
from abfm.sequences.verdicts import (
    NUMBERS,
    allows_motion,
    facts_of_intervals,
    motion_shares,
    verdict_of,
    without_determined_motion,
)
from abfm.types import BoolArray, File, FloatArray
from abfm.workers.control import CancelledError, Control, checkpoint, controlled, current_control
from abfm.workers.progress import step, stepped

GAMMA = 1.0  # default weight of the difference between neighbouring fields
GAMMA_MAX = 1e6
_THREADS = 2  # threads that trace flow lines; one thread does the other work


class Sequence(Solution, Display):
    """Frames of a function, and the field of each interval between two of them; immutable.

    Attributes
    ----------
    mesh : TriangleMesh
    frames : (T, V, C) array
        The given frames. Values are filled in where some frame is not finite or the mask is 0.
    times : (T,) array
        Ascending times.
    numbers : (T,) array
        Numbers of the frames in the input, counted from 0. Frames without values are left out.
    velocity : (T - 1, F, 3) array
        Tangent vectors, in the mesh's length unit per unit of time.
    parameters : SequenceParameters
        The given parameters, with the ``alpha`` and ``order`` of the norm. ``automatic`` lists
        those that held-out data chose, and ``sigma`` is None if held-out data chose it.
    gamma : float
        Weight of the difference between neighbouring fields.
    residual, verified_residual, folded : (T - 1,) array
        Residuals of each interval by the discrete flow and by flow lines, and the share of faces
        that flow lines fold, as in `Match`. NaN if unknown.
    noise : float
        Largest residual that independent noise at vertices causes, the median over intervals. The
        verdict of an interval depends on the value of that interval, not on the median.
    verdicts : tuple of Verdict
        The verdict of each interval.
    motion_share : float
        Between two frames, the function is their linear blend, changed by this share of the motion
        along the fields. It is the share that best explains held-out frames, from 0 to 1, or NaN if
        unknown. See `motion_shares`.
    has_motion : bool
        False if held-out frames show that the fields are not a motion, for example in a standing
        wave.
    sigma : float
        Sigma of all intervals. It is relative to the size of the frames, or absolute if the
        parameters have an absolute ``sigma_unit``.
    """

    @property
    def confirmed(self) -> int:
        """Number of intervals with a good outcome, which flow lines confirm."""
        return sum(verdict.kind.is_good for verdict in self.verdicts)

    @cached_property
    def facts(self) -> Facts:
        """Facts of the sequence for reports.

        The outcome of the sequence is good if at least half of its intervals are.
        """
        numbers = (np.asarray(getattr(self, name)) for name in NUMBERS)
        return facts_of_intervals(self.verdicts, *numbers)

    @property
    def settings(self) -> str:
        """Text with norm, sigma and gamma; it names the parameters that held-out data chose."""
        given = self.parameters
        chosen = [*given.automatic, *(["sigma"] if given.sigma is None else [])]
        how = f" (chosen by held-out data: {', '.join(chosen)})" if chosen else ""
        numbers = f"alpha {given.alpha:.3g}, sigma {self.sigma:.3g}, gamma {self.gamma:.3g}"
        return f"norm of order {given.order}, {numbers}{how}"

    def __getitem__(self, interval: int) -> Match:
        """Return an interval as the match of its first frame to its second, with its verdict."""
        i = range(len(self))[interval]
        # a run that was cancelled before sigma was chosen has fields of 0
        sigma = self.sigma if np.isfinite(self.sigma) else SIGMA_MAX
        parameters = interval_parameters(self._frames, self.parameters, sigma, i)
        flow = Flow(self.mesh, self.velocity[i], parameters.tau)
        return Match(
            problem=self._frames.problem(i, parameters),
            fine_velocity=self.velocity[i : i + 1],
            advected=flow.push(self.frames[i]),
            energy_history=self.energies[i],
            stages=np.zeros(2, dtype=np.int64),
            residual=float(self.residual[i]),
            verified_residual=float(self.verified_residual[i]),
            folded=float(self.folded[i]),
            stop_reason=StopReason.NO_PROGRESS,
            verdict=self.verdicts[i],
        )

    def __iter__(self) -> Iterator[Match]:
        return map(self.__getitem__, range(len(self)))

    def interval(self, t: float) -> int:
        """Return the index of the interval that contains a time.

        At a frame between two intervals, this is the later interval.
        """
        times = self.times
        if not (is_finite_number(t) and times[0] <= t <= times[-1]):
            raise ParameterError(
                f"t is {brief(t)}; expected a time from {times[0]:g} to {times[-1]:g}"
            )
        return int(np.clip(np.searchsorted(times, t, side="right") - 1, 0, len(self) - 1))

    @cached_property
    def motion_shares(self) -> FloatArray:
        """Share of motion in interpolated frames, (T - 1,), from 0 (a linear blend) to 1.

        The share is `motion_share` if that is known. Otherwise, for example for two frames, it is 1
        for confirmed intervals and 0 for others. In both cases, it is 0 for intervals whose verdict
        excludes a motion.
        """
        return motion_shares(self.verdicts, self.motion_share)

    def at(self, t: float) -> FloatArray:
        """Return the function at a time, (V,) or (V, C).

        It is the linear blend of the frames before and after the time, changed by motion along the
        field. The change is multiplied by the share of motion of the interval, see `motion_shares`.
        """
        i = self.interval(t)
        begin, end = map(float, self.times[i : i + 2])
        share = (t - begin) / (end - begin)
        found = self.frames[i if share < 1 else i + 1]
        if 0 < share < 1:
            flow = Flow(self.mesh, self.velocity[i], end - begin)
            motion = float(self.motion_shares[i])
            before, after = self.frames[i : i + 2]
            [found] = interpolate(flow, before, after, np.array([share]), motion)
        return np.array(found if self._frames.channels_given else found[:, 0])

    @cached_property
    def _posterior(self) -> Posterior:
        found = posterior(self)
        is_motion = np.array([allows_motion(verdict) for verdict in self.verdicts])
        unknown = ~(is_motion & self.has_motion)
        found.covariances[unknown], found.determined[unknown] = np.inf, 0.0
        return found

    @property
    def covariances(self) -> FloatArray:
        """Covariance of the velocity on each face, (T - 1, F, 2, 2), in the square of its unit.

        The covariance is in the face frames (`abfm.calculus.face_frames`). It is infinite for
        intervals whose verdict excludes a motion, and for all intervals unless the sequence
        `has_motion`. See ``abfm.sequences.uncertainty``.
        """
        return self._posterior.covariances

    @cached_property
    def uncertainty(self) -> FloatArray:
        """Standard error of the velocity on each face, (T - 1, F), in the velocity's unit.

        It is the square root of the trace of `covariances`.
        """
        return np.asarray(np.sqrt(np.trace(self.covariances, axis1=2, axis2=3)))

    @property
    def determined(self) -> FloatArray:
        """Share of the squared velocity on each face that the frames determine, (T - 1, F), 0 to 1.

        Smoothness determines the rest from the adjacent faces. The share is 0 where functions are
        flat, and where `covariances` are infinite.
        """
        return self._posterior.determined

    def parts(self, interval: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Split the field of an interval into a gradient, a rotated gradient and a harmonic field.

        Each of the three fields is (F, 3), see `abfm.calculus.helmholtz_hodge`.
        """
        return helmholtz_hodge(self.mesh, self.velocity[interval])

    @cached_property
    def divergence(self) -> FloatArray:
        """Divergence of the fields at vertices, (T - 1, V), per unit of time."""
        return self._by(divergence(self.mesh))

    @cached_property
    def curl(self) -> FloatArray:
        """Curl of the fields at vertices, (T - 1, V), per unit of time."""
        return self._by(curl(self.mesh))

    def _by(self, operator: Matrix) -> FloatArray:
        return np.stack([operator @ to_frame(self.mesh, v).ravel() for v in self.velocity])

    @cached_property
    def speed(self) -> FloatArray:
        """Root mean square of the speed over the surface, (T - 1,).

        The displacement energy is half the square of this speed, times the area [Lefèvre & Baillet,
        IEEE TPAMI 31 (2009)].
        """
        areas = face_areas(self.mesh)
        squares = np.array([areas @ (v**2).sum(axis=1) for v in self.velocity])
        return np.asarray(np.sqrt(squares / areas.sum()))

    @cached_property
    def speed_uncertainty(self) -> FloatArray:
        """Root mean square of `uncertainty` over the surface, (T - 1,)."""
        areas = face_areas(self.mesh)
        return np.asarray(np.sqrt(self.uncertainty**2 @ (areas / areas.sum())))

    @cached_property
    def speed_determined(self) -> FloatArray:
        """Share of the mean squared speed over the surface that the frames determine, (T - 1,).

        The share is the mean of `determined`, weighted with the squared speed. Without motion it is
        the mean over the area.
        """
        areas = face_areas(self.mesh)
        weights = areas * (self.velocity**2).sum(axis=2)
        weights[~weights.any(axis=1)] = areas
        return np.asarray((weights * self.determined).sum(axis=1) / weights.sum(axis=1))

    @property
    def middles(self) -> FloatArray:
        """Middle of each interval, (T - 1,), the time of its field."""
        return 0.5 * (self.times[1:] + self.times[:-1])

    @cached_property
    def _critical(self) -> list[CriticalPoints]:
        with stepped("finding critical points", self.velocity) as fields:
            return [critical_points(self.mesh, field) for field in fields]

    def critical_points(self, interval: int) -> CriticalPoints:
        """Return sources, sinks, spirals and saddles of the field of an interval."""
        return self._critical[interval]

    def tracks(self, min_intervals: int = 3) -> list[Track]:
        """Link critical points of consecutive intervals to tracks, the longest first.

        Only tracks with at least ``min_intervals`` intervals are returned.
        """
        return tracks(self.mesh, self._critical, self.middles, min_intervals)

    def episodes(self) -> list[Episode]:
        """Return stable episodes, with a slow field, and transient ones, with a fast field.

        Intervals that are not solved are ignored.
        """
        solved, found = self.solved, list[Episode]()
        for run in np.split(np.arange(len(self)), np.flatnonzero(np.diff(solved)) + 1):
            if solved[run[0]]:
                found += episodes(self.times[run[0] : run[-1] + 2], self.speed[run])
        return found

    def paths(
        self, points: SurfacePoints | ArrayLike, start: float | None = None
    ) -> list[SurfacePoints]:
        """Move points along all fields; return their positions at start and at each later frame.

        ``points`` are surface points or vertex indices (P,). ``start`` is a time, by default that
        of the first frame.
        """
        given = points if isinstance(points, SurfacePoints) else vertex_points(self.mesh, points)
        if len(given.mesh.faces) != len(self.mesh.faces):
            raise ParameterError(
                "the points are on another mesh than the sequence; use points of its mesh"
            )
        begin = float(self.times[0]) if start is None else float(start)
        found, first = [given], self.interval(begin)
        for i in range(first, len(self)):
            checkpoint()
            duration = float(self.times[i + 1]) - max(begin, float(self.times[i]))
            if duration > 0:
                flow = ContinuousFlow(self.mesh, self.velocity[i], duration)
                found.append(flow.destinations(found[-1]))
        return found

    @property
    def unknown(self) -> BoolArray | None:
        """Mask (V,) of the vertices with filled-in values; None if no values were missing."""
        return self._frames.unknown

    def between(self, first: int, last: int, parameters: Parameters | None = None) -> Problem:
        """Return the matching problem from frame ``first`` to frame ``last``."""
        return self._frames.between(first, last, parameters or Parameters())


def load_sequence(path: File) -> Sequence:
    """Read a file of ``Sequence.save``; raise ResultError if it is missing or damaged."""
    return results.loaded(path, results.SEQUENCE, Sequence.of_arrays)


def sequence(
    mesh: MeshLike,
    frames: ArrayLike,
    times: ArrayLike | None = None,
    parameters: SequenceParameters | None = None,
    gamma: float = GAMMA,
    *,
    dt: float | None = None,
    mask: ArrayLike | None = None,
    weights: ArrayLike | None = None,
    circular: bool | float = False,
    checkpoint: SequenceCheckpoint | None = None,
    on_interval: Callable[[int], object] | None = None,
    on_field: Callable[[int, FloatArray], object] | None = None,
    control: Control | None = None,
) -> Sequence:
    """Find the fields whose flows map each frame of a function to the next.

    The function minimises, over the fields ``v_i`` of the intervals of length ``d_i``,

        sum_i d_i/2 ||v_i||^2 + 1/(2 sigma^2 d_i) ||f_i o phi_i^-1 - f_(i+1)||^2
        + gamma/2 sum_i min(d_i, d_(i+1)) ||v_i - v_(i+1)||^2

    with the paper's norm of fields (Eq. 2) and the flow ``phi_i`` of ``v_i`` over its interval.
    Sigma is a multiple of the size of the frames (their root mean square without the means). For
    small displacements this is optical flow on a surface [Lefèvre & Baillet, IEEE TPAMI 30 (2008)],
    here without its linearisation.

    Parameters
    ----------
    mesh : TriangleMesh, or any input of `abfm.load_mesh`
    frames : (T, V) or (T, V, C) array, or object
        Frames without any finite value are left out, which ``notes`` reports. Vertices with a value
        that is not finite, in any other frame, are not compared. The axes may have
        another order: the axis whose length is the number of vertices is that of the vertices. If
        several axes fit, ``notes`` reports that the second is used. Images of nibabel and nilearn,
        pandas objects and MNE's source estimates, see `abfm.functions.as_values`, have a column for
        each frame.
    times : (T,) array, optional
        Ascending times in seconds. By default, the times are those of a source estimate or an
        image, or else the frame numbers 0, 1, 2, ...
    parameters : SequenceParameters, optional
        Parameters made by `abfm.sequences.defaults`. If ``alpha`` and ``order`` of the norm are not
        given, those that best predict held-out patches of a few intervals are chosen. If sigma is
        not given, it is the largest that predicts them nearly as well.
    gamma : float
        Weight of the difference between neighbouring fields; 0 solves each interval separately.
    dt : float, optional
        Seconds between two frames, instead of times.
    mask : (V,) array, optional
        Weight of the mismatch at each vertex, not negative; where it is 0, values are unknown.
    weights : (C,) array, optional
        Weight of each channel.
    circular : bool or float
        Whether frames are phases, or their period. Phases are compared by cosine and sine, two
        channels for each given channel, with its weight.
    checkpoint : SequenceCheckpoint, optional
        A file for intermediate results. If this run is killed or cancelled, the next run of the
        same problem resumes from it. Call ``checkpoint.remove()`` after the result is saved.
    on_interval : callable, optional
        Function that is called, in this thread, with the index of each interval when it is first
        solved.
    on_field : callable, optional
        Function that is called after ``on_interval`` with the index and the field (F, 3), in the
        mesh's unit per unit of time. At the beginning, it is also called with the fields of an
        earlier run.
    control : Control, optional
        Object that pauses or cancels the computation from another thread. After a cancellation,
        solved fields are returned and the others are 0.

    Raises
    ------
    AbfmError
        If the frames, times, parameters, mask or weights do not fit.

    Examples
    --------
    >>> import abfm, numpy as np
    >>> from abfm.assets import asset_path
    >>> mesh = abfm.load_mesh(asset_path("eight.off"))
    >>> x = mesh.vertices[:, 0] / mesh.length_scale
    >>> frames = [np.sin(6 * (x - 0.02 * t)) for t in range(4)]
    >>> found = abfm.sequence(mesh, frames)
    >>> found.velocity.shape == (3, len(mesh.faces), 3), found.confirmed
    (True, 3)
    """
    mesh, given = as_mesh(mesh), checked_parameters(parameters)
    gamma = _checked_gamma(gamma)
    control = control or current_control() or Control()
    with controlled(control):
        try:
            checked_frames = _checked_frames(mesh, frames, times, dt, mask, weights, circular)
            _refuse_extremes(checked_frames, given)
            solver = SequenceSolver(checked_frames, given, gamma, noise_levels(checked_frames))
            file = checkpoint or SequenceCheckpoint()
            file.restore(solver)
        except CancelledError:
            raise ParameterError("the sequence was cancelled before it began") from None

        def report_field(i: int) -> None:
            if on_field is not None:
                velocity = to_ambient(checked_frames.mesh, solver.fields[i])
                on_field(i, velocity * checked_frames.mesh.length_scale)

        def report(i: int) -> None:
            if on_interval is not None:
                on_interval(i)
            report_field(i)

        for i in np.flatnonzero(solver.found).tolist():
            report_field(i)
        is_final, evidence = False, MotionEvidence()
        try:
            if file.solve_remaining:
                solver.run(report, lambda: file.save(solver, force=False))
                is_final = True
                evidence = motion_evidence(solver)
        except CancelledError:
            control = Control()  # the fields found so far are still checked
        file.save(solver)
        if not is_final:
            file = SequenceCheckpoint()  # checks of preliminary fields are not stored
    with controlled(control):
        return _checked_sequence(solver, file, evidence)


def _checked_frames(
    mesh: TriangleMesh,
    given: Any,
    times: ArrayLike | None,
    dt: float | None,
    mask: ArrayLike | None,
    weights: ArrayLike | None,
    circular: bool | float,
) -> Frames:
    """Return checked frames; ``dt`` is the time between two frames, instead of times."""
    if dt is not None and times is not None:
        raise ParameterError("times and dt are both given; give only one of them")
    if dt is not None and (not is_finite_number(dt) or dt <= 0):
        raise ParameterError(f"dt is {brief(dt)}; expected a time above 0")
    found = frames_of(given, mesh)
    values, weights = circular_frames(found.values, weights, circular)
    if dt is not None:
        times = float(dt) * np.arange(len(found.values), dtype=np.float64)
    times = found.times if times is None else times
    checked_frames = check_frames(mesh, values, times, mask, weights)
    return replace(checked_frames, notes=(*found.notes, *checked_frames.notes))


def _checked_sequence(
    solver: SequenceSolver, file: SequenceCheckpoint, evidence: MotionEvidence
) -> Sequence:
    """Return the sequence of a solver, with fields checked by discrete flow and by flow lines."""
    checked_frames, unit = solver.frames, solver.frames.mesh.length_scale
    count = len(solver.fields)
    measures: list[IntervalMeasures] = []
    with (
        step("checking by flow lines", work_of(checked_frames), after=0.0) as report,
        ThreadPoolExecutor(_THREADS) as threads,
    ):
        try:
            # the first interval in this thread, to report the compilation of kernels
            measures.append(solver.measures(0))
            report(1 / count)
            for found in threads.map(solver.measures, range(1, count)):
                measures.append(found)
                report(len(measures) / count)
                file.save(solver, force=False)
                checkpoint()
        except CancelledError:
            threads.shutdown(cancel_futures=True)
    measures += [solver.measures(i, by_flow_lines=False) for i in range(len(measures), count)]
    numbers = {
        name: np.array([getattr(each, name) for each in measures])
        for name in ("residual", "verified_residual", "folded", "energies")
    }
    velocity = to_ambient(checked_frames.mesh, solver.fields) * unit
    velocity.flags.writeable = False
    verdicts, floors = list[Verdict](), list[float]()
    for i, each in enumerate(measures):
        problem = checked_frames.problem(i, solver.parameters(i))
        floors.append(noise_floor(problem.functions, solver.levels))
        verdict = verdict_of(problem, each, solver.levels, bool(solver.found[i]))
        verdicts.append(verdict if evidence.is_motion else without_determined_motion(verdict))
    return Sequence(
        _frames=checked_frames,
        velocity=velocity,
        parameters=solver.given,
        gamma=solver.gamma,
        sigma=float(solver.sigma),
        noise=float(np.median(floors)),
        verdicts=tuple(verdicts),
        motion_share=evidence.share,
        has_motion=evidence.is_motion,
        **numbers,
    )


def _refuse_extremes(frames: Frames, given: SequenceParameters) -> None:
    """Raise FunctionError if squares of values or times would overflow or underflow."""
    largest = float(np.abs(frames.values).max())
    with np.errstate(over="ignore"):
        _ = frames.deviation  # this raises an error for extreme masks
    relative = replace(given, sigma_unit="relative")
    sigmas = {SIGMA_MIN, SIGMA_MAX, given.sigma if given == relative and given.sigma else SIGMA_MIN}
    shortest, longest = int(frames.durations.argmin()), int(frames.durations.argmax())
    try:
        if largest > VALUE_MAX:
            raise ParameterError
        for interval, sigma in product((shortest, longest), sorted(sigmas)):
            interval_parameters(frames, relative, sigma, interval)
    except ParameterError:
        raise FunctionError(
            f"frames have values of up to {largest:.3g} and intervals of "
            f"{frames.durations[shortest]:.3g}; their squares over- or underflow. Scale all "
            "values, or all times, by one factor; this does not change the flow"
        ) from None


def _checked_gamma(gamma: float) -> float:
    if not (is_finite_number(gamma) and 0 <= gamma <= GAMMA_MAX):
        raise ParameterError(f"gamma is {brief(gamma)}; expected 0 to {GAMMA_MAX:g}")
    return float(gamma)
