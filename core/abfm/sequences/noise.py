"""How much of a function is noise, by what no neighbour knows of it."""

import numpy as np
from scipy import sparse

from abfm.mesh import TriangleMesh, per_mesh
from abfm.types import BoolArray, FloatArray


def noise(
    mesh: TriangleMesh, functions: FloatArray, seen: BoolArray | slice = slice(None)
) -> FloatArray:
    """Estimate the standard deviation of independent noise on vertices, for functions (..., V),
    (...,): an upper bound, to which what is bent over single edges adds; by the vertices seen.

    What a value differs from the mean of its ``n`` neighbours has the variance ``1 + 1/n`` of the
    noise [after Immerkær, Computer Vision and Image Understanding 64 (1996)]; the median over
    vertices is taken, so that jumps do not count.
    """
    apart = functions - (_means(mesh) @ functions.reshape(-1, functions.shape[-1]).T).T.reshape(
        functions.shape
    )
    alone = np.abs(apart) / np.sqrt(1 + 1 / _neighbours(mesh))
    usual = np.median(alone[..., seen], axis=-1)
    return np.asarray(usual / 0.6744897501960817)  # of a normal distribution's deviation


@per_mesh
def _neighbours(mesh: TriangleMesh) -> FloatArray:
    return np.bincount(mesh.edges.ravel(), minlength=len(mesh.vertices)).astype(np.float64)


@per_mesh
def _means(mesh: TriangleMesh) -> sparse.csr_array:
    i, j = mesh.edges.T
    ends, size = (np.r_[i, j], np.r_[j, i]), len(mesh.vertices)
    adjacency = sparse.csr_array((np.ones(2 * len(i)), ends), shape=(size, size))
    return sparse.csr_array(sparse.diags_array(1 / _neighbours(mesh)) @ adjacency)
