"""Frames from arrays, and from objects of other libraries."""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from abfm.calculus.channels import at_vertices, with_index
from abfm.errors import AbfmError, FunctionError, one_line
from abfm.functions.objects import as_values, values_of_object
from abfm.mesh import TriangleMesh
from abfm.mesh.objects import has
from abfm.reading import counts_of
from abfm.sequences.reading.frames_file import FramesFile, by_frames, frames_of_columns
from abfm.sequences.reading.reading_frames import read_frames
from abfm.types import FloatArray
from abfm.workers.control import CancelledError


def frames_of(given: Any, mesh: TriangleMesh) -> FramesFile:
    """Return frames (T, V) or (T, V, C), and their times if an object has them.

    The axis of the vertices is the one that has as many entries as the mesh or its file has
    vertices; if several have, it is the second one, with a note.

    Parameters
    ----------
    given : array or object
        What `abfm.functions.as_values` takes, with a column for each frame. Of pandas, either rows
        or columns are vertices. Or a list of frames, or the name of a file.

    Raises
    ------
    FunctionError
        If they are no real numbers, or do not fit the mesh.
    """
    if isinstance(given, str | os.PathLike):
        return read_frames(given, mesh)
    try:
        found = values_of_object(mesh, given)
        if found is not None:
            return frames_of_columns(found.columns, mesh, found.are_sources)
        return by_frames(FramesFile(_array(mesh, given)), mesh)
    except (CancelledError, MemoryError, AbfmError):
        raise
    except Exception as problem:  # the objects are not ours, and may raise anything
        raise FunctionError(f"frames: {one_line(problem, 400)}") from problem


def _array(mesh: TriangleMesh, given: Any) -> FloatArray:
    given = with_index(given)
    if isinstance(given, list | tuple) and not all(isinstance(each, list) for each in given):
        return np.stack([as_values(mesh, frame, "frames") for frame in given])
    is_table = has(given, "iloc", "columns")
    if is_table and given.shape[1] in counts_of(mesh):
        return at_vertices(mesh, given.T, "frames").T
    values = at_vertices(mesh, given, "frames")
    return values.T if is_table else values
