"""The fixed sparsity of ``D_v``: assembling it for a new field is one pass over the faces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from abfm import kernels
from abfm.kernels import IndexArray
from abfm.mesh import FloatArray, TriangleMesh, per_mesh
from abfm.operators import face_areas, hat_gradients, vertex_areas


@dataclass(frozen=True)
class DerivativePattern:
    """The fixed sparsity of ``D_v`` on a mesh (vertex adjacency with diagonal) and what fills it from a field."""

    indptr: IndexArray
    indices: IndexArray
    faces: IndexArray
    positions: IndexArray
    transpose: IndexArray
    slopes: FloatArray
    inverse_areas: FloatArray

    def values(self, v: FloatArray) -> FloatArray:
        """Entries of ``D_v`` for frame coefficients ``v`` (F, 2)."""
        out = np.empty(len(self.indices))
        kernels.assemble_derivative(self.faces, self.positions, self.slopes, self.inverse_areas, v, out)
        return out

    def add_chain_rule(self, entries: FloatArray, out: FloatArray) -> None:
        """Add to ``out`` (F, 2) the derivative by ``v`` for the derivative ``entries`` by the values of ``D_v``."""
        kernels.assemble_derivative_transposed(
            self.faces, self.positions, self.slopes, self.inverse_areas, entries, out
        )


@per_mesh
def derivative_pattern(mesh: TriangleMesh) -> DerivativePattern:
    """Sparsity of ``D_v`` and the linear map from field coefficients to its values."""
    count = len(mesh.vertices)
    rows = np.repeat(mesh.faces, 3, axis=1).ravel()
    columns = np.tile(mesh.faces, (1, 3)).ravel()
    keys, positions = np.unique(rows * count + columns, return_inverse=True)
    rows, columns = np.divmod(keys, count)
    indptr = np.searchsorted(rows, np.arange(count + 1))
    transpose = np.searchsorted(keys, columns * count + rows)
    small = np.uint32 if len(keys) < 2**32 else np.uint64
    return DerivativePattern(
        indptr.astype(small),
        columns.astype(small),
        mesh.faces.astype(small),
        positions.reshape(-1, 3, 3).astype(small),
        transpose.astype(small),
        hat_gradients(mesh) * (face_areas(mesh) / 3)[:, None, None],
        1 / vertex_areas(mesh),
    )
