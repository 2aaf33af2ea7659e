"""Uncertainty of the fields of a sequence on each face, and their shares that frames determine.

Around its minimum the energy is that of a linear problem with the Hessian ``P + D``, the norm of
fields plus the data. On a face, ``D`` is close to a constant 2 x 2 tensor. It is the product of the
slopes of two consecutive frames, averaged over the length that the norm bridges. One axis of the
tensor is across the contours of a function, where the eigenvalue ``d`` is large. Along contours,
data come only from nearby contours in other directions. With the stiffness ``q = <v, P v> / <v,
v>`` of the field itself,

    s = d / (q + d)

is the share of the field along an axis that the frames determine; smoothness determines the rest.
An estimate misses ``1 - s`` of the true field [the bias of ridge regression], and noise scatters
it. Let ``V`` be the mean square of the velocity along an axis, weighted by ``s``. The estimate's
variance is

    V (1 - s)^2  +  T * integral of  d / (p(k) + d)^2  k dk / (2 pi),   p(k) = (1 + alpha k^2)^order

over the wave numbers ``k`` of the mesh, averaged over modes in time, whose stiffness is ``p (1 +
gamma (2 - 2 cos))``. The variance ``T`` of the frames' noise is that of the evidence framework
[MacKay, Neural Computation 4 (1992)]: ``2 mismatch / (n - m)``. Here ``n`` is the number of values,
of which the fit uses ``m = integral of d / (p + d)`` over all faces. Shares do not depend on units,
scale or rotation of the surface, of times or of values, nor do variances relative to the squared
field.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from abfm.calculus import operators
from abfm.calculus.smoothing import smoothed
from abfm.calculus.vector_fields import to_ambient, to_frame
from abfm.flow.flow import Flow
from abfm.sequences.frames import sigma_of
from abfm.sequences.solution import Solution
from abfm.types import FloatArray, IntArray
from abfm.workers.progress import stepped

_WAVE_NUMBERS = 200
_PRECISIONS = np.concatenate([[0.0], np.geomspace(1e-8, 1e14, 221)])
"""Precisions of the data, relative to the norm at k = 0, at which integrals are tabulated."""
_LENGTH_MAX = 0.25  # largest length over which slopes are averaged, in sqrt(area)
_FREE_VALUES_MIN = 0.1  # smallest share of all values that counts as not used by the fit
_PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


class Posterior(NamedTuple):
    """Covariances of fields, and the share of each field that the frames determine."""

    # (T - 1, F, 2, 2), of the velocity in the face frames (`abfm.calculus.face_frames`) and the
    # square of its unit; infinite if nothing determines the velocity
    covariances: FloatArray
    determined: FloatArray  # (T - 1, F), share of the squared velocity that the frames determine


def posterior(sequence: Solution) -> Posterior:
    """Return the covariances of the fields of a sequence, and their shares that frames determine.

    Covariances are infinite if all frames are constant or no interval was solved.
    """
    shape = sequence.velocity.shape[:2]
    found = Posterior(np.full((*shape, 2, 2), np.inf), np.zeros(shape))
    solved = np.flatnonzero(sequence.solved)
    if not len(solved):
        return found
    eigenvalues, axes = _data_tensors(sequence, solved)
    if not eigenvalues.any():
        return found
    integrals = _Integrals.of(sequence)
    mesh, areas = sequence.mesh, operators.face_areas(sequence.mesh.normalized())
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
        mean_square = np.einsum("f,fk,fk->", areas, shares, squares) / max(
            np.einsum("f,fk->", areas, shares), 1e-300
        )
        variances = mean_square * (1 - shares) ** 2 + scatter[row] / durations[row]
        variances *= mesh.length_scale**2
        found.covariances[i] = np.einsum("fxk,fk,fyk->fxy", axes[row], variances, axes[row])
        squares[~squares.any(axis=1)] = 1.0
        found.determined[i] = (shares * squares).sum(axis=1) / squares.sum(axis=1)
    return found


def _values(sequence: Solution) -> int:
    mask = sequence._frames.mask
    vertices = len(sequence.mesh.vertices) if mask is None else int(np.count_nonzero(mask))
    return vertices * int(np.count_nonzero(sequence._frames.weights))


def _data_tensors(sequence: Solution, solved: IntArray) -> tuple[FloatArray, FloatArray]:
    """Return eigenvalues (I, F, 2) and eigenvectors (I, F, 2, 2), in columns, of the data tensors.

    A data tensor (``D`` in the docstring of this module) is how precisely frames determine the
    velocity on a face. ``solved`` are the indices of I intervals. The tensors are relative to the
    norm of fields at wave number 0, and averaged over `_length`.
    """
    mesh = sequence.mesh.normalized()
    areas = operators.vertex_areas(mesh)
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
    frames = operators.face_frames(mesh)
    eigenvalues = np.empty((len(solved), len(mesh.faces), 2))
    axes = np.empty((*eigenvalues.shape, 2))
    for row, smooth in enumerate(tensors):
        of_faces = smooth[mesh.faces].mean(axis=1)
        spatial = np.empty((len(mesh.faces), 3, 3))
        for column, (x, y) in enumerate(_PAIRS):
            spatial[:, x, y] = spatial[:, y, x] = of_faces[:, column]
        planar = np.einsum("fax,fxy,fby->fab", frames, spatial, frames)
        eigenvalues[row], axes[row] = np.linalg.eigh(planar)
    return np.maximum(eigenvalues, 0.0), axes


def _slopes(sequence: Solution, interval: int) -> FloatArray:
    """Return products of the slopes of the two frames of an interval at vertices, (V, 6).

    The columns are xx, yy, zz, xy, xz and yz. The earlier frame is advected to the later one. The
    independent noise of both frames does not bias the products.
    """
    mesh, frames = sequence.mesh.normalized(), sequence._frames
    mean, derive = operators.averaging(mesh), operators.gradient(mesh)
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
    """Return the length, in sqrt(area), over which the norm averages data of a given precision.

    It is one over the wave number at which norm and data are equally stiff. It is at least an edge
    and, on fine meshes, at most `_LENGTH_MAX`.
    """
    mesh, parameters = sequence.mesh.normalized(), sequence.parameters
    excess = max(precision, 0.0) ** (1 / parameters.order) - 1
    length = _LENGTH_MAX
    if excess > 0:
        length = min(length, float(np.sqrt(parameters.alpha / excess)))
    return max(length, float(operators.edge_lengths(mesh).mean()))


@dataclass(frozen=True, eq=False)
class _Integrals:
    """Integrals over wave numbers, averaged over modes in time, as functions of data precision."""

    weights: FloatArray  # (K,)
    stiffness: FloatArray  # (K, M)

    @staticmethod
    def of(sequence: Solution) -> _Integrals:
        parameters, count = sequence.parameters, len(sequence)
        alpha = max(parameters.alpha, 1e-12)
        vertices = len(sequence.mesh.vertices)
        # on unit area, the disc of all wave numbers has as many modes as the mesh has vertices
        log_max = np.log1p(alpha * 4 * np.pi * vertices)
        log_stiffness = np.linspace(0.0, log_max, _WAVE_NUMBERS)
        ends = np.ones(_WAVE_NUMBERS)
        ends[[0, -1]] = 0.5
        # k dk / (2 pi) is d(k^2) / (4 pi)
        spacing = log_stiffness[1] - log_stiffness[0]
        weights = ends * spacing * np.exp(log_stiffness) / alpha / (4 * np.pi)
        in_time = 2 - 2 * np.cos(np.pi * np.arange(count) / count)
        of_space = np.exp(parameters.order * log_stiffness)
        return _Integrals(weights, of_space[:, None] * (1 + sequence.gamma * in_time))

    def modes(self, precision: FloatArray) -> FloatArray:
        """Return the number of modes, per unit area and axis, that the data determine."""
        return self._integrated(lambda p, d: d / (p + d), precision)

    def scatter(self, precision: FloatArray) -> FloatArray:
        """Return the variance of the field that noise of variance 1 causes."""
        return self._integrated(lambda p, d: d / (p + d) ** 2, precision)

    def _integrated(
        self, integrand: Callable[[FloatArray, float], FloatArray], precision: FloatArray
    ) -> FloatArray:
        table = np.array(
            [self.weights @ integrand(self.stiffness, d).mean(axis=1) for d in _PRECISIONS.tolist()]
        )
        first = _PRECISIONS[1]
        nodes, at = np.log(_PRECISIONS[1:]), np.log(np.maximum(precision, first))
        found = np.interp(at, nodes, table[1:])
        # below the first precision, integrals are linear
        below = precision < first
        found[below] = table[0] + (table[1] - table[0]) * precision[below] / first
        return np.asarray(found)
