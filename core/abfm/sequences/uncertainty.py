"""How uncertain the fields of a sequence are, face by face: the local posterior of Gauss-Newton.

Around its minimum the energy is that of a linear problem with a Gaussian prior, whose Hessian is
``P + D``: the norm of fields, with what ties neighbouring intervals, and the data. On a face, ``D``
is close to a constant 2 x 2 tensor, the products of slopes of the frames. Its axes are across the
contours of a function, where it is large, and along them, where only the contours nearby that run
in another direction are data. Along each axis, with its eigenvalue ``d``, the problem is then that
of a plane: Fourier modes of wave number ``k`` have the prior's precision
``p(k) = (1 + alpha k^2)^order``, and the variance of an estimate is

    integral of (T_p p + T_d d) / (p + d)^2  k dk / (2 pi)

up to the finest mode of the mesh [Rasmussen & Williams, Gaussian Processes for Machine Learning,
2006, chapter 7]. The first term is what the prior's pull hides, the second what noise adds. Modes
over the intervals are summed likewise, with ``p (1 + gamma (2 - 2 cos))``.

The variances ``T_p`` of fields and ``T_d`` of frames are those of the evidence framework [MacKay,
Neural Computation 4 (1992)]: with the number of modes that the data determine,
``m = sum of d / (p + d)``, it is ``T_p = 2 regularity / m`` and ``T_d = 2 mismatch / (n - m)`` of
``n`` values. No unit, scale or rotation of surface, times or values changes what comes of it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy import sparse

from abfm.calculus.operators import (
    Matrix,
    averaging,
    cotangent_laplacian,
    edge_lengths,
    face_areas,
    gradient,
    vertex_areas,
)
from abfm.calculus.vector_fields import face_frames, to_ambient
from abfm.flow.flow import Flow
from abfm.numerics.cholesky import factor
from abfm.types import FloatArray, IntArray
from abfm.workers.control import checkpoint
from abfm.workers.progress import step

if TYPE_CHECKING:
    from abfm.sequences.sequence import Sequence

_WAVE_NUMBERS = 200
_PRECISIONS = np.concatenate([[0.0], np.geomspace(1e-8, 1e14, 221)])
"""Of the data, relative to the prior at k = 0, at which integrals are tabulated."""
_LENGTH_MAX = 0.25
"""Largest length over which slopes are averaged, of sqrt(area)."""
_FREE_VALUES_MIN = 0.1
"""Smallest share of all values that counts as not used up by the fit."""
_PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


def covariances(sequence: Sequence) -> FloatArray:
    """Return the covariance of the velocity on each face, (T - 1, F, 2, 2), in the faces' frames
    (`abfm.calculus.face_frames`), in the square of the velocity's unit.

    It is infinite where no interval determines any field: if all frames are constant, or none of
    the intervals was solved.
    """
    count = len(sequence)
    found = np.full((count, len(sequence.mesh.faces), 2, 2), np.inf)
    solved = np.flatnonzero(sequence.solved)
    if not len(solved):
        return found
    eigenvalues, axes = _of_data(sequence, solved)
    integrals = _Integrals.of(sequence)
    areas = face_areas(sequence.mesh.normalized())
    modes = float(np.einsum("f,ifk->", areas, integrals.modes(eigenvalues)))
    values = _values(sequence) * len(solved)
    energies = sequence.energies[solved, 1]
    of_fields, of_frames = 2 * energies[:, 1].sum(), 2 * energies[:, 2].sum()
    if not modes > 0:
        return found
    prior = of_fields / modes
    noise = of_frames / max(values - modes, _FREE_VALUES_MIN * values)
    variances = prior * integrals.pull(eigenvalues) + noise * integrals.scatter(eigenvalues)
    durations = np.diff(sequence.times)[solved]
    variances *= sequence.mesh.length_scale**2 / durations[:, None, None]
    found[solved] = np.einsum("ifxk,ifk,ifyk->ifxy", axes, variances, axes)
    return found


def determined(squares: FloatArray, variances: FloatArray) -> FloatArray:
    """Return ``squares / (squares + variances)``; 0 where both are 0 or a variance is infinite."""
    share = np.zeros(np.shape(squares))
    known = np.isfinite(variances) & (squares > 0)
    share[known] = squares[known] / (squares[known] + variances[known])
    return share


def _values(sequence: Sequence) -> int:
    """Return how many values of a frame are compared."""
    mask = sequence._frames.mask
    vertices = len(sequence.mesh.vertices) if mask is None else int(np.count_nonzero(mask))
    return vertices * int(np.count_nonzero(sequence._frames.weights))


def _of_data(sequence: Sequence, solved: IntArray) -> tuple[FloatArray, FloatArray]:
    """Return eigenvalues (I, F, 2) and axes (I, F, 2, 2), in columns, of the data's tensors, in the
    unit of the prior's precision at k = 0, averaged over the length that the prior bridges there.
    """
    mesh = sequence.mesh.normalized()
    areas = vertex_areas(mesh)
    tensors = np.empty((len(solved), len(areas), len(_PAIRS)))
    with step("uncertainty") as report:
        for row, i in enumerate(solved.tolist()):
            checkpoint()
            tensors[row] = _slopes(sequence, i)
            report((row + 1) / len(solved))
    scale = _sigma(sequence)
    tensors /= scale**2
    mean = float(np.einsum("v,ivt->", areas, tensors[..., :3])) / 2 / len(solved)
    length = _length(sequence, mean)
    solve = factor(Matrix(sparse.diags_array(areas) + length**2 * cotangent_laplacian(mesh)))
    frames = face_frames(mesh)
    eigenvalues = np.empty((len(solved), len(mesh.faces), 2))
    axes = np.empty((*eigenvalues.shape, 2))
    for row, of_vertices in enumerate(tensors):
        smooth = np.stack([solve(areas * column) for column in of_vertices.T], axis=1)
        of_faces = smooth[mesh.faces].mean(axis=1)
        whole = np.empty((len(mesh.faces), 3, 3))
        for column, (x, y) in enumerate(_PAIRS):
            whole[:, x, y] = whole[:, y, x] = of_faces[:, column]
        planar = np.einsum("fax,fxy,fby->fab", frames, whole, frames)
        eigenvalues[row], axes[row] = np.linalg.eigh(planar)
    return np.maximum(eigenvalues, 0.0), axes


def _slopes(sequence: Sequence, interval: int) -> FloatArray:
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


def _sigma(sequence: Sequence) -> float:
    """Return sigma in the functions' own unit, over an interval of the time 1."""
    is_relative = sequence.parameters.sigma_unit == "relative"
    return sequence.sigma * (sequence._frames.deviation if is_relative else 1.0)


def _length(sequence: Sequence, precision: float) -> float:
    """Return the length over which the prior joins data of a precision, in sqrt(area): that of the
    mode with as much precision by the prior; an edge at least.
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
    prior: FloatArray  # (K, M), precisions

    @staticmethod
    def of(sequence: Sequence) -> _Integrals:
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

    def pull(self, precision: FloatArray) -> FloatArray:
        """Return the variance that the prior's pull hides, for fields of variance 1."""
        return self._integrated(lambda p, d: p / (p + d) ** 2, precision)

    def scatter(self, precision: FloatArray) -> FloatArray:
        """Return the variance by noise of variance 1."""
        return self._integrated(lambda p, d: d / (p + d) ** 2, precision)

    def _integrated(
        self, integrand: Callable[[FloatArray, float], FloatArray], precision: FloatArray
    ) -> FloatArray:
        table = np.array(
            [self.weights @ integrand(self.prior, d).mean(axis=1) for d in _PRECISIONS.tolist()]
        )
        first = _PRECISIONS[1]
        places, at = np.log(_PRECISIONS[1:]), np.log(np.maximum(precision, first))
        found = np.interp(at, places, table[1:])
        # below the first one, where integrals are linear
        below = precision < first
        found[below] = table[0] + (table[1] - table[0]) * precision[below] / first
        return found
