"""Functions on vertices: as the solver keeps them, one row per channel, and filled in."""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from abfm.calculus.operators import adjacency
from abfm.errors import FunctionError
from abfm.mesh import TriangleMesh
from abfm.numerics.cholesky import factor
from abfm.numerics.real_numbers import real_numbers
from abfm.types import BoolArray, FloatArray

_LITTLE = 0.01  # of the values, as their range


def channels(mesh: TriangleMesh, values: ArrayLike, name: str) -> FloatArray:
    """Check a function (V,) or (V, C), of the file or the mesh, and return its channels (C, V)."""
    array = real_numbers(values, name, FunctionError)
    if array.ndim not in (1, 2) or array.size == 0:
        raise FunctionError(
            f"{name} has shape {array.shape}; expected (vertices,) or (vertices, channels)"
        )
    array = mesh.restrict(array)
    bad = np.flatnonzero(~np.isfinite(array).reshape(len(array), -1).all(axis=1))
    if len(bad):
        raise FunctionError(
            f"{name} has values that are not finite at {len(bad)} of {len(array)} vertices, the "
            f"first at {bad[0]}"
        )
    return np.array(array.reshape(len(array), -1).T, order="C")  # a copy: what is given may change


def constant_part(f: FloatArray) -> float:
    """Return the middle of values (V,) that vary little around it, of others 0."""
    low, high = float(f.min()), float(f.max())
    middle = low / 2 + high / 2
    return middle if high - low < _LITTLE * abs(middle) else 0.0


def extend(mesh: TriangleMesh, values: FloatArray, known: BoolArray) -> FloatArray:
    """Keep the known values; every other vertex becomes the mean of its neighbours, (V,)."""
    return extension(mesh, known)(values)


def extend_all(mesh: TriangleMesh, functions: FloatArray, known: BoolArray) -> FloatArray:
    """Return `extend` of functions (C, V) of which the same values are known."""
    return np.stack(list(map(extension(mesh, known), functions)))


def extension(mesh: TriangleMesh, known: BoolArray) -> Callable[[FloatArray], FloatArray]:
    """Return `extend` for many functions of which the same values are known."""
    if known.all():
        return lambda values: values
    joined = adjacency(mesh)
    laplacian = sparse.csr_array(sparse.diags_array(joined.sum(axis=1)) - joined)
    rows = laplacian[~known]
    solve, beside = factor(rows[:, ~known]), rows[:, known]

    def filled(values: FloatArray) -> FloatArray:
        found = values.copy()
        found[~known] = solve(-(beside @ values[known]))
        return found

    return filled
