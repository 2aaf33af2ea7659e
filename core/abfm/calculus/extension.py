"""Filling in values that are known at some vertices only."""

import numpy as np
from scipy import sparse

from abfm.mesh import TriangleMesh
from abfm.numerics.cholesky import factor
from abfm.types import BoolArray, FloatArray


def extend(mesh: TriangleMesh, values: FloatArray, known: BoolArray) -> FloatArray:
    """Keep the known values; every other vertex becomes the mean of its neighbours, (V,). Some
    vertex must be known.

    The harmonic extension on the mesh's graph: it never leaves the range of the known values.
    """
    if known.all():
        return values
    i, j = mesh.edges.T
    adjacency = sparse.csr_array(
        (np.ones(2 * len(i)), (np.r_[i, j], np.r_[j, i])), shape=(len(values), len(values))
    )
    laplacian = sparse.csr_array(sparse.diags_array(adjacency.sum(axis=1)) - adjacency)
    unknown_rows = laplacian[~known]
    filled = values.copy()
    filled[~known] = factor(unknown_rows[:, ~known])(-(unknown_rows[:, known] @ values[known]))
    return filled
