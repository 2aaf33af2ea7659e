"""Evidence for motion: whether the motion between two frames explains a frame between them."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from abfm.calculus.operators import face_areas, gradient, vertex_areas
from abfm.calculus.vector_fields import to_ambient
from abfm.errors import AdvectionError
from abfm.flow.flow import Flow
from abfm.sequences.between.interpolation import interpolate
from abfm.sequences.frames import Frames
from abfm.sequences.phase_times import seconds_after
from abfm.sequences.solving.solve import SequenceSolver
from abfm.types import FloatArray
from abfm.workers.progress import stepped

_HELD_OUT_FRAMES_MAX = 3
_MOTION_SHARE_MIN = 0.5
"""Smallest share of motion that counts as motion, within two standard errors of the noise."""
_STANDARD_ERRORS = 2.0
_COSINE_MIN = 0.5
"""Smallest cosine between the rates of change of a frame by two fields of the same motion."""
_CHANGE_MAX = 0.5
"""Largest relative difference between fields of two intervals of the same motion.

It compares the rates of change of the frame between the intervals, relative to their mean.
"""


class MotionEvidence(NamedTuple):
    """The share of motion that best predicts held-out frames from the frames next to them."""

    # factor, 0 to 1, of the change that motion makes to the linear blend of two frames. This factor
    # best explains a held-out frame between them. NaN if unknown.
    share: float = np.nan
    is_motion: bool = True  # False if motion certainly does not explain the held-out frames


def motion_evidence(solver: SequenceSolver) -> MotionEvidence:
    """Return the share of motion with which the neighbours of held-out frames predict them best.

    A few frames are held out, and the motion between the two neighbours of each is found. Let ``f``
    be this frame, ``b`` the blend of its neighbours at its time, and ``a`` the function that
    the motion between them gives there. The share is ``sum <f - b, a - b> / sum ||a - b||^2``. It
    is the least-squares solution: ``b + share (a - b)`` is closest to ``f``. Noise alone makes it
    about 1/2, since motion averages noise over two positions. Standing waves have smaller shares.

    The field between the neighbours may differ from the fields of the two intervals. If the latter
    are the same motion, the neighbours are too far apart to find it, and the share is unknown. If
    they also differ from each other, no field is a motion for longer than one interval, and the
    share is 0.
    """
    product = square = variance = 0.0
    # products of the rates of change of the frame by the found field and by those of both intervals
    fields = np.zeros((3, 3))
    after = seconds_after("holding out frames", solver.frames)
    with stepped("holding out frames", _middles(solver), after) as middles:
        for middle in middles:
            try:
                found = _evidence(solver, middle)
            except AdvectionError:
                continue
            product, square = product + found.product, square + found.square
            variance, fields = variance + found.variance, fields + found.fields
    if not square > 0:
        return MotionEvidence()
    of_mean = float(fields[1:, 1:].sum()) / 4
    cosine = float(fields[0, 1:].sum()) / 2 / max(np.sqrt(fields[0, 0] * of_mean), 1e-300)
    if cosine < _COSINE_MIN:
        change = fields[1, 1] + fields[2, 2] - 2 * fields[1, 2]
        is_same = bool(change <= _CHANGE_MAX**2 * of_mean)
        return MotionEvidence() if is_same else MotionEvidence(0.0, False)
    if product + _STANDARD_ERRORS * np.sqrt(variance) < _MOTION_SHARE_MIN * square:
        return MotionEvidence(0.0, False)
    return MotionEvidence(float(np.clip(product / square, 0, 1)))


class _Evidence(NamedTuple):
    """Sums over the vertices of a held-out frame, from which the share of motion follows.

    The share is ``product / square``, and noise causes the variance ``variance`` of ``product``.
    ``fields`` are the `_products` of three fields: between the neighbours, and of the two
    intervals.
    """

    product: float
    square: float
    variance: float
    fields: FloatArray  # (3, 3)


def _middles(solver: SequenceSolver) -> list[int]:
    """Return the indices of the frames to hold out.

    The neighbours of these frames differ from each other by about the median difference. If most
    intervals are motions, only frames between two such intervals are candidates.
    """
    is_uncoupled, frames = solver.is_uncoupled, solver.frames
    if 2 * np.count_nonzero(is_uncoupled) >= len(is_uncoupled):
        is_uncoupled = np.zeros_like(is_uncoupled)
    candidates = 1 + np.flatnonzero(~is_uncoupled[:-1] & ~is_uncoupled[1:])
    counts = _counts(frames)
    changes = np.array(
        [np.linalg.norm(counts * (frames.values[i + 1] - frames.values[i - 1])) for i in candidates]
    )
    if not len(candidates):
        return []
    nearest = np.argsort(np.abs(changes - np.median(changes)), kind="stable")
    return sorted(candidates[nearest[:_HELD_OUT_FRAMES_MAX]].tolist())


def _counts(frames: Frames) -> FloatArray:
    """Return the square root of the weight of each value (area, mask and channel), (V, C)."""
    areas = vertex_areas(frames.mesh.normalized())
    if frames.mask is not None:
        areas = areas * frames.mask
    return np.asarray(np.sqrt(areas[:, None] * frames.weights))


def _evidence(solver: SequenceSolver, middle: int) -> _Evidence:
    frames = solver.frames
    ends = [middle - 1, middle + 1]
    pair = replace(frames, values=frames.values[ends], times=frames.times[ends])
    sigma = solver.sigma
    if solver.given.sigma_unit == "relative":
        sigma *= frames.deviation / pair.deviation
    pair_solver = SequenceSolver(pair, replace(solver.given, sigma=sigma), 0.0, solver.levels)
    field, mesh = pair_solver.initial_point(0).field, frames.mesh
    duration = float(pair.durations[0])
    flow = Flow(mesh, to_ambient(mesh, field) * mesh.length_scale, duration)
    shares = np.array([float(frames.times[middle] - pair.times[0]) / duration])
    counts = _counts(frames)
    before, after = pair.values
    blend, moved = (counts * interpolate(flow, before, after, shares, x)[0] for x in (0.0, 1.0))
    difference, missing = moved - blend, counts * frames.values[middle] - blend
    # variances of the frame itself and of the blend
    variances = (1 + shares**2 + (1 - shares) ** 2) * (counts * solver.levels.T) ** 2
    fields = np.stack([field, *solver.fields[middle - 1 : middle + 1]])
    return _Evidence(
        float((missing * difference).sum()),
        float((difference**2).sum()),
        float((variances * difference**2).sum()),
        _products(frames, middle, fields),
    )


def _products(frames: Frames, middle: int, fields: FloatArray) -> FloatArray:
    """Return the inner products (N, N) of the rates at which N fields (N, F, 2) change a frame.

    ``middle`` is the index of the frame. Fields along its contours do not change it.
    """
    mesh = frames.mesh.normalized()
    areas, derive = face_areas(mesh), gradient(mesh)
    if frames.mask is not None:
        areas = areas * frames.mask[mesh.faces].mean(axis=1)
    found = np.zeros((len(fields), len(fields)))
    for channel in np.flatnonzero(frames.weights):
        slopes = (derive @ np.ascontiguousarray(frames.values[middle, :, channel])).reshape(-1, 2)
        changes = np.einsum("fk,nfk->nf", slopes, fields)
        found += frames.weights[channel] * np.einsum("f,nf,mf->nm", areas, changes, changes)
    return found
