"""Smoothing of functions by heat."""

import numpy as np
from scipy import sparse

from abfm.calculus.operators import Matrix, cotangent_laplacian, vertex_areas
from abfm.mesh import TriangleMesh
from abfm.numerics.cholesky import factor
from abfm.types import FloatArray


def smoothed(mesh: TriangleMesh, values: FloatArray, length: float) -> FloatArray:
    """Smooth functions (V, C) over a length, in the unit of the mesh.

    The smoothing is one implicit step of the heat equation for the time ``length^2``. It preserves
    constants and integrals.
    """
    areas = vertex_areas(mesh)
    heat = Matrix(sparse.diags_array(areas) + length**2 * cotangent_laplacian(mesh))
    solve = factor(heat)
    return np.stack([solve(areas * column) for column in values.T], axis=1)
