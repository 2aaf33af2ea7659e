"""How well frames determine the fields of a sequence, face by face.

Around its minimum the energy is that of a linear problem, whose Hessian is ``P + D``: the norm of
fields, and the data. On a face, ``D`` is close to a constant 2 x 2 tensor, of the products of the
frames' slopes, averaged over the length that the norm bridges. Its axes are across the contours of
a function, where its eigenvalue ``d`` is large, and along them, where only contours nearby that run
in another direction are data. With the stiffness ``q = <v, P v> / <v, v>`` of the field itself,

    s = d / (q + d)

is the share of the field along an axis that the frames determine; smoothness makes the rest. An
estimate misses ``1 - s`` of what is there [the bias of ridge regression], and noise scatters it.
Where ``V`` is the mean square of the velocity along an axis, weighted by ``s``, its variance is

    V (1 - s)^2  +  T * integral of  d / (p(k) + d)^2  k dk / (2 pi),   p(k) = (1 + alpha k^2)^order

over the wave numbers ``k`` of the mesh, with the mean over modes in time, whose stiffness is
``p (1 + gamma (2 - 2 cos))``. The variance ``T`` of the frames' noise is that of the evidence
framework [MacKay, Neural Computation 4 (1992)]: ``2 mismatch / (n - m)`` of ``n`` values, of which
the fit uses ``m = integral of d / (p + d)`` over all faces. No unit, scale or rotation of the
surface, of times or of values changes the shares, or the variances relative to the field's square.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from abfm.calculus.operators import (
    averaging,
    edge_lengths,
    face_areas,
    face_frames,
    gradient,
    vertex_areas,
)
from abfm.calculus.smoothing import smoothed
from abfm.calculus.vector_fields import to_ambient, to_frame
from abfm.flow.flow import Flow
from abfm.sequences.frames import sigma_of
from abfm.sequences.solution import Solution
from abfm.types import FloatArray, IntArray
from abfm.workers.progress import stepped

_WAVE_NUMBERS = 200
_PRECISIONS = np.concatenate([[0.0], np.geomspace(1e-8, 1e14, 221)])
"""Of the data, relative to the norm at k = 0, at which integrals are tabulated."""
_LENGTH_MAX = 0.25
"""Largest length over which slopes are averaged, of sqrt(area)."""
_FREE_VALUES_MIN = 0.1
"""Smallest share of all values that counts as not used up by the fit."""
_PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


class Posterior(NamedTuple):
    """How well fields are known.

    Attributes
    ----------
    covariances : (T - 1, F, 2, 2) array
        Of the velocity on each face, in the faces' frames (`abfm.calculus.face_frames`), in the
        square of the velocity's unit; infinite if nothing determines it.
    determined : (T - 1, F) array
        The share of the square of the velocity that the frames determine.
    """

    covariances: FloatArray
    determined: FloatArray


def posterior(sequence: Solution) -> Posterior:
    """Return how well the fields of a sequence are known.

    Covariances are infinite if no interval determines any field: if all frames are constant, or
    none of the intervals was solved.
    """
    shape = sequence.velocity.shape[:2]
    found = Posterior(np.full((*shape, 2, 2), np.inf), np.zeros(shape))
    solved = np.flatnonzero(sequence.solved)
    if not len(solved):
        return found
    eigenvalues, axes = _of_data(sequence, solved)
    if not eigenvalues.any():
        return found
    integrals = _Integrals.of(sequence)
    mesh, areas = sequence.mesh, face_areas(sequence.mesh.normalized())
    modes = float(np.einsum("f,ifk->", areas, integrals.modes(eigenvalues)))
    values, energies = _values(sequence) * len(solved), sequence.energies[solved, 1]
    noise = 2 * energies[:, 2].sum() / max(values - modes, _FREE_VALUES_MIN * values)
    scatter = noise * integrals.scatter(eigenvalues)
    durations = np.diff(sequence.times)[solved]
    for row, i in enumerate(solved.tolist()):
        field = to_frame(mesh, sequence.velocity[i]) / mesh.length_scale
        squares = np.einsum("fxk,fx->fk", axes[row], field) ** 2
        total = float(areas @ squares.sum(axis=1))
        stiffness = 2 * energies[row, 1] / (durations[row] * total) if total > 0 else 1.0
        shares = eigenvalues[row] / (stiffness + eigenvalues[row])
        usual = np.einsum("f,fk,fk->", areas, shares, squares) / max(
            np.einsum("f,fk->", areas, shares), 1e-300
        )
        variances = usual * (1 - shares) ** 2 + scatter[row] / durations[row]
        variances *= mesh.length_scale**2
        found.covariances[i] = np.einsum("fxk,fk,fyk->fxy", axes[row], variances, axes[row])
        squares[~squares.any(axis=1)] = 1.0
        found.determined[i] = (shares * squares).sum(axis=1) / squares.sum(axis=1)
    return found


def _values(sequence: Solution) -> int:
    """Return how many values of a frame are compared."""
    mask = sequence._frames.mask
    vertices = len(sequence.mesh.vertices) if mask is None else int(np.count_nonzero(mask))
    return vertices * int(np.count_nonzero(sequence._frames.weights))


def _of_data(sequence: Solution, solved: IntArray) -> tuple[FloatArray, FloatArray]:
    """Return eigenvalues (I, F, 2) and axes (I, F, 2, 2), in columns, of the data's tensors, in the
    unit of the norm at k = 0, averaged over the length that the norm bridges.
    """
    mesh = sequence.mesh.normalized()
    areas = vertex_areas(mesh)
    tensors = np.empty((len(solved), len(areas), len(_PAIRS)))
    with stepped("uncertainty", solved.tolist()) as intervals:
        for row, i in enumerate(intervals):
            tensors[row] = _slopes(sequence, i)
    scale = sigma_of(sequence._frames, sequence.parameters, sequence.sigma, 1.0)
    tensors /= scale**2
    mean = float(np.einsum("v,ivt->", areas, tensors[..., :3])) / 2 / len(solved)
    length = _length(sequence, mean)
    columns = smoothed(mesh, tensors.transpose(1, 0, 2).reshape(len(areas), -1), length)
    tensors = columns.reshape(len(areas), len(solved), -1).transpose(1, 0, 2)
    frames = face_frames(mesh)
    eigenvalues = np.empty((len(solved), len(mesh.faces), 2))
    axes = np.empty((*eigenvalues.shape, 2))
    for row, smooth in enumerate(tensors):
        of_faces = smooth[mesh.faces].mean(axis=1)
        whole = np.empty((len(mesh.faces), 3, 3))
        for column, (x, y) in enumerate(_PAIRS):
            whole[:, x, y] = whole[:, y, x] = of_faces[:, column]
        planar = np.einsum("fax,fxy,fby->fab", frames, whole, frames)
        eigenvalues[row], axes[row] = np.linalg.eigh(planar)
    return np.maximum(eigenvalues, 0.0), axes


def _slopes(sequence: Solution, interval: int) -> FloatArray:
    """Return products of the slopes of the frame before, pushed along, and of the frame after, at
    vertices, (V, 6), on the mesh of unit area: as their noise is independent, it has the mean 0.
    """
    mesh, frames = sequence.mesh.normalized(), sequence._frames
    mean, derive = averaging(mesh), gradient(mesh)
    duration = float(sequence.times[interval + 1] - sequence.times[interval])
    flow = Flow(sequence.mesh, sequence.velocity[interval], duration)
    found = np.zeros((len(mesh.vertices), len(_PAIRS)))
    for channel in np.flatnonzero(frames.weights):
        before, after = np.ascontiguousarray(frames.values[interval : interval + 2, :, channel])
        a, b = (
            mean @ to_ambient(mesh, (derive @ f).reshape(-1, 2)) for f in (flow.push(before), after)
        )
        for column, (x, y) in enumerate(_PAIRS):
            products = a[:, x] * b[:, y] + a[:, y] * b[:, x]
            found[:, column] += 0.5 * frames.weights[channel] * products
    return found if frames.mask is None else found * frames.mask[:, None]


def _length(sequence: Solution, precision: float) -> float:
    """Return the length over which the norm joins data of a precision, in sqrt(area): that of the
    mode which is as stiff; an edge at least.
    """
    mesh, parameters = sequence.mesh.normalized(), sequence.parameters
    stiff = max(precision, 0.0) ** (1 / parameters.order) - 1
    longest = _LENGTH_MAX
    if stiff > 0:
        longest = min(longest, float(np.sqrt(parameters.alpha / stiff)))
    return max(longest, float(edge_lengths(mesh).mean()))


@dataclass(frozen=True, eq=False)
class _Integrals:
    """Integrals over wave numbers, and means over modes in time, by the data's precision."""

    weights: FloatArray  # (K,)
    stiffness: FloatArray  # (K, M)

    @staticmethod
    def of(sequence: Solution) -> _Integrals:
        parameters, count = sequence.parameters, len(sequence)
        alpha = max(parameters.alpha, 1e-12)
        vertices = len(sequence.mesh.vertices)
        # the disc of all modes has as many in it as there are vertices, on unit area
        farthest = np.log1p(alpha * 4 * np.pi * vertices)
        stiff = np.linspace(0.0, farthest, _WAVE_NUMBERS)
        ends = np.ones(_WAVE_NUMBERS)
        ends[[0, -1]] = 0.5
        # k dk / (2 pi) is d(k^2) / (4 pi)
        weights = ends * (stiff[1] - stiff[0]) * np.exp(stiff) / alpha / (4 * np.pi)
        in_time = 2 - 2 * np.cos(np.pi * np.arange(count) / count)
        of_space = np.exp(parameters.order * stiff)
        return _Integrals(weights, of_space[:, None] * (1 + sequence.gamma * in_time))

    def modes(self, precision: FloatArray) -> FloatArray:
        """Return how many modes data determine, per unit area and axis."""
        return self._integrated(lambda p, d: d / (p + d), precision)

    def scatter(self, precision: FloatArray) -> FloatArray:
        """Return the variance by noise of variance 1."""
        return self._integrated(lambda p, d: d / (p + d) ** 2, precision)

    def _integrated(
        self, integrand: Callable[[FloatArray, float], FloatArray], precision: FloatArray
    ) -> FloatArray:
        table = np.array(
            [self.weights @ integrand(self.stiffness, d).mean(axis=1) for d in _PRECISIONS.tolist()]
        )
        first = _PRECISIONS[1]
        places, at = np.log(_PRECISIONS[1:]), np.log(np.maximum(precision, first))
        found = np.interp(at, places, table[1:])
        # below the first one, where integrals are linear
        below = precision < first
        found[below] = table[0] + (table[1] - table[0]) * precision[below] / first
        return np.asarray(found)
