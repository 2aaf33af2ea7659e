"""Functions on vertices: conversion to channels (C, V), and interpolation of missing values."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from abfm.calculus.operators import adjacency
from abfm.errors import AbfmError, FunctionError, one_line
from abfm.mesh import TriangleMesh
from abfm.mesh.objects import has
from abfm.numerics.cholesky import factor
from abfm.numerics.real_numbers import real_numbers
from abfm.reading import Columns, counts_of
from abfm.types import BoolArray, FloatArray

_RANGE_SHARE_MIN = 0.01  # smallest range of values that vary, relative to their middle


def at_vertices(
    mesh: TriangleMesh, values: ArrayLike, name: str, error: type[AbfmError] = FunctionError
) -> FloatArray:
    """Return user values at vertices as real numbers, in the same shape.

    The rows of pandas objects are assigned to vertices by their index, or by a column called
    vertex, node or index. An index 0, 1, 2, ... keeps the order of the rows. Vertices without a row
    become NaN. Columns of Polars and Arrow and coordinates of xarray work in the same way. An
    ``error`` is raised if the values are not real numbers, or if vertices are repeated or not on
    the mesh.
    """
    values = with_index(values)
    if not (has(values, "iloc", "index", "to_numpy") or has(values, "columns", "to_numpy")):
        return real_numbers(values, name, error)
    try:
        return _by_index(mesh, values, name)
    except (ValueError, TypeError) as problem:
        raise error(one_line(problem, 400)) from problem


def with_checked_shape(
    mesh: TriangleMesh, values: FloatArray, name: str, error: type[AbfmError] = FunctionError
) -> FloatArray:
    """Return the values if their shape is (V,) or (V, C) and not empty; else raise an ``error``.

    V is the number of vertices of the mesh, or that of its file.
    """
    if values.ndim in (1, 2) and values.size and len(values) in counts_of(mesh):
        return values
    number = mesh.file_vertex_count
    channels_text = f" or ({number}, channels)" if values.ndim > 1 else ""
    raise error(
        f"{name} has shape {values.shape}, but {vertex_count_text(mesh)}; expected ({number},)"
        f"{channels_text}"
    )


def vertex_count_text(mesh: TriangleMesh) -> str:
    count, in_file = counts_of(mesh)
    if count == in_file:
        return f"the mesh has {count} vertices"
    return f"the mesh has {count} of the {in_file} vertices of its file"


def with_index(values: Any) -> Any:
    """Return xarray arrays of one or two axes, and Arrow tables, as pandas objects."""
    is_array = has(values, "dims", "coords", "ndim", "to_pandas") and values.ndim in (1, 2)
    return values.to_pandas() if is_array or has(values, "column_names", "to_pandas") else values


def _by_index(mesh: TriangleMesh, frame: Any, name: str) -> FloatArray:
    array = frame.to_numpy()
    if array.dtype == object and has(frame, "isna"):  # possibly numbers with pandas.NA
        array = np.array(np.where(frame.isna(), np.nan, array).tolist())
    array = real_numbers(array, name)
    if array.size == 0:
        return array
    index = np.asarray(frame.index if has(frame, "index") else range(len(frame)))
    vertices = None
    if not np.array_equal(index, np.arange(len(index))):
        numbers = index.astype(np.float64) if index.dtype.kind in "iuf" else np.full(1, np.nan)
        if not np.array_equal(numbers, np.rint(numbers)):
            raise ValueError(
                f"{name} has an index that does not hold vertex numbers; use to_numpy() if its "
                "rows are in the order of the vertices"
            )
        vertices = numbers.astype(np.int64)
    names = tuple(map(str, frame.columns)) if array.ndim == 2 else ()
    try:
        found = Columns(array.reshape(len(array), -1), names, vertices=vertices).by_vertex()
        placed = found.values if found.vertices is None else found.on(mesh).values
    except ValueError as problem:
        raise ValueError(f"{name}: {problem}") from problem
    return placed if array.ndim == 2 else placed[:, 0]


def channels(mesh: TriangleMesh, values: ArrayLike, name: str) -> FloatArray:
    """Check a function and return its channels (C, V), with V vertices of the mesh.

    The values have shape (V,) or (V, C), in the order of the mesh or of its file.
    """
    array = mesh.restrict(with_checked_shape(mesh, at_vertices(mesh, values, name), name))
    bad = np.flatnonzero(~np.isfinite(array).reshape(len(array), -1).all(axis=1))
    if len(bad):
        raise FunctionError(
            f"{name} has values that are not finite at {len(bad)} of {len(array)} vertices, the "
            f"first at {bad[0]}"
        )
    return np.array(array.reshape(len(array), -1).T, order="C")  # a copy: the input may change


def constant_part(f: FloatArray) -> float:
    """Return the constant that nearly constant values (V,) have in common; 0 for other values.

    It is the midpoint of their range, if the range is less than 1% of the midpoint.
    """
    low, high = float(f.min()), float(f.max())
    middle = low / 2 + high / 2
    return middle if high - low < _RANGE_SHARE_MIN * abs(middle) else 0.0


def extend(mesh: TriangleMesh, values: FloatArray, known: BoolArray) -> FloatArray:
    """Return values (V,) in which each vertex that is not ``known`` has the mean of its neighbours.

    ``known`` (V,) is True at the vertices whose values are preserved.
    """
    return extension(mesh, known)(values)


def extend_all(mesh: TriangleMesh, functions: FloatArray, known: BoolArray) -> FloatArray:
    """Apply `extend` to functions (C, V) that are known at the same vertices."""
    return np.stack(list(map(extension(mesh, known), functions)))


def extension(mesh: TriangleMesh, known: BoolArray) -> Callable[[FloatArray], FloatArray]:
    """Return ``values -> extend(mesh, values, known)``, which factors its matrix only once."""
    if known.all():
        return lambda values: values
    joined = adjacency(mesh)
    laplacian = sparse.csr_array(sparse.diags_array(joined.sum(axis=1)) - joined)
    rows = laplacian[~known]
    solve, coupling = factor(rows[:, ~known]), rows[:, known]

    def filled(values: FloatArray) -> FloatArray:
        found = values.copy()
        found[~known] = solve(-(coupling @ values[known]))
        return found

    return filled
