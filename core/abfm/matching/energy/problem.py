"""What is to be matched: a source and a target, and how much of their mismatch counts where."""

import numpy as np
from numpy.typing import ArrayLike

from abfm.calculus.channels import channels
from abfm.calculus.operators import l2_norm, vertex_areas
from abfm.errors import FunctionError, ParameterError
from abfm.mesh import TriangleMesh
from abfm.real_numbers import real_numbers
from abfm.types import FloatArray


class Problem:
    """A source f and a target g, (V,) or (V, C), on a mesh.

    The mask (V,) weighs the mismatch at each vertex of the mesh or of its file, weights (C,) that of each channel; they
    are 1 unless given. Values of the source may come from where the mask is 0.

    ``source`` and ``target`` are (C, V), ``areas`` (V,) those of the vertices times the mask, ``function_size`` is the
    larger of the functions' deviations, 1 where both are constant.

    Raises
    ------
    FunctionError
        If a function does not fit the mesh, or they have not as many channels.
    ParameterError
        If mask or weights do not fit, a value is negative or not finite, or all are zero.
    """

    def __init__(
        self,
        mesh: TriangleMesh,
        f: ArrayLike,
        g: ArrayLike,
        mask: ArrayLike | None = None,
        weights: ArrayLike | None = None,
    ) -> None:
        self.mesh = mesh
        self.source, self.target = channels(mesh, f, "source"), channels(mesh, g, "target")
        count = len(self.source)
        if count != len(self.target):
            raise FunctionError(f"source has {count} and target {len(self.target)} channels; give as many of each")
        self.mask: FloatArray | None = None
        if mask is not None:
            of_vertices = real_numbers(mask, "mask")
            if of_vertices.shape == (mesh.file_vertex_count,):
                of_vertices = mesh.restrict(of_vertices)
            self.mask = _weights(of_vertices, len(mesh.vertices), "mask")
        self.weights = np.ones(count) if weights is None else _weights(weights, count, "weights")
        self.areas = vertex_areas(mesh) if self.mask is None else vertex_areas(mesh) * self.mask
        self.function_size = max(self.deviation(self.source), self.deviation(self.target)) or 1.0

    def relative_mismatch(self, advected: FloatArray) -> float:
        """``||f_tau - g|| / ||g||`` in L2 over all channels (C, V), with mask and weights; ``||f||``, or 1, for 0."""
        return relative_mismatch(self.mesh, advected, self.target, self.source, self.mask, self.weights)

    def norm(self, functions: FloatArray) -> float:
        """L2 norm over channels (C, V), with mask and weights."""
        return _norm(self.mesh, functions, self.mask, self.weights)

    def deviation(self, functions: FloatArray) -> float:
        """Norm of channels (C, V) less the mean of each, by the mask."""
        return float(np.sqrt(self.covariance(functions, functions)))

    def covariance(self, one: FloatArray, other: FloatArray) -> float:
        """L2 product over channels (C, V) less the mean of each, with mask and weights."""
        apart = one - (one @ self.areas / self.areas.sum())[:, None]
        return float(self.weights @ ((apart * (other - (other @ self.areas / self.areas.sum())[:, None])) @ self.areas))


def relative_mismatch(
    mesh: TriangleMesh,
    found: FloatArray,
    target: FloatArray,
    source: FloatArray,
    mask: FloatArray | None,
    weights: FloatArray,
) -> float:
    """``||found - target|| / ||target||`` in L2 over all channels (C, V), with mask (V,) and weights (C,).

    Relative to the source where the target is 0.
    """
    scale = _norm(mesh, target, mask, weights) or _norm(mesh, source, mask, weights) or 1.0
    return _norm(mesh, found - target, mask, weights) / scale


def _norm(mesh: TriangleMesh, functions: FloatArray, mask: FloatArray | None, weights: FloatArray) -> float:
    return l2_norm(mesh, (np.sqrt(weights)[:, None] * functions).T, mask)


def _weights(values: ArrayLike, count: int, name: str) -> FloatArray:
    array = real_numbers(values, name).copy()
    if array.shape != (count,):
        raise ParameterError(f"{name} has shape {array.shape}; expected ({count},)")
    if not np.isfinite(array).all() or (array < 0).any() or not array.any():
        raise ParameterError(f"{name} must be finite, not negative, and not zero everywhere")
    return array
