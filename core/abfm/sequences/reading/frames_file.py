"""Frames from files and objects, before they are checked."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from abfm.functions.sources import interpolate_sources
from abfm.mesh import TriangleMesh
from abfm.numerics.real_numbers import as_float64
from abfm.reading import Columns, counts_of, vertex_axis
from abfm.types import FloatArray
from abfm.wording import counted


class FramesFile(NamedTuple):
    """Frames (T, V) or (T, V, C) from a file or an object.

    Attributes
    ----------
    times : (T,) array or None
        Times of the frames in seconds; None if they are unknown.
    notes : tuple of str
        Notes for the user, one line each.
    """

    values: FloatArray
    times: FloatArray | None = None
    notes: tuple[str, ...] = ()


def frames_of_columns(found: Columns, mesh: TriangleMesh, are_sources: bool) -> FramesFile:
    """Return frames from the columns of a file; ValueError if these are labels, or do not fit.

    Values at sources of a source estimate (``are_sources``) are interpolated to the vertices.
    """
    found = found.by_vertex()
    if any(found.keys):
        raise ValueError("it contains labels; expected real numbers")
    if are_sources:
        values, notes = interpolate_sources(found, mesh)
        return by_frames(FramesFile(values, found.times, notes), mesh)
    if found.vertices is not None:
        return by_frames(FramesFile(found.on(mesh).table().T, found.times, found.notes), mesh)
    return by_frames(FramesFile(found.values, found.times, found.notes), mesh, found.frames_first)


def by_frames(found: FramesFile, mesh: TriangleMesh, frames_first: bool = True) -> FramesFile:
    """Return frames as real numbers (T, V) or (T, V, C), with the axis of the vertices moved.

    The axis of the vertices is the one with as many entries as the mesh has vertices. If several
    axes have this size, it is the second one, or without ``frames_first`` the first one.
    """
    given, times, notes = found.values, found.times, [*found.notes]
    if given.ndim not in (2, 3) or given.size == 0:
        single = ", at most one frame" * (given.ndim == 1)
        shape = f"it is an array of shape {given.shape}{single}"
        raise ValueError(f"{shape}; expected (T, V) or (T, V, C)")
    counts = counts_of(mesh)
    axis = vertex_axis(given.shape, counts, 1 if frames_first else 0)
    if given.shape[axis] not in counts:
        sizes = " or ".join(map(str, sorted({*counts})))
        hint = "; expected one value for each vertex and frame"
        if len(mesh.faces) in given.shape:
            hint = (
                f" and {len(mesh.faces)} faces. Give values at vertices, such as means over faces"
            )
        raise ValueError(f"its shape is {given.shape}, but the mesh has {sizes} vertices{hint}")
    if given.ndim == 2 and axis == 0:
        _refuse_numbers_of_vertices(given)
    if frames_first and axis == 0:
        channels = f" ({given.shape[1]} frames of {given.shape[-1]} channels)"
        notes.append(
            f"its {len(given):,} rows are the vertices, its columns the frames"
            + channels * (given.ndim == 3)
        )
    elif frames_first and given.shape[0] in counts:
        notes.append("it has as many frames as vertices; its rows are read as the frames")
    values = np.ascontiguousarray(as_float64(np.moveaxis(given, axis, 1)))
    if times is not None and times.shape != (len(values),):
        raise ValueError(
            f"it has {counted(times.size, 'time')} for {counted(len(values), 'frame')}; "
            "expected one for each frame"
        )
    return FramesFile(values, times, tuple(notes))


def _refuse_numbers_of_vertices(given: NDArray[Any]) -> None:
    """Raise a ValueError if the first column of a table (V, T) has the numbers of the vertices."""
    count = len(given)
    for begin in (0, 1):
        if given.shape[1] > 1 and np.array_equal(given[:, 0], np.arange(begin, begin + count)):
            raise ValueError(
                f"its first column numbers the vertices from {begin} to {begin + count - 1} and "
                "is not a frame. Remove the column"
            )
