"""Frames from files and objects: arrays, tables, films of brain imaging and VTK, and what other
libraries have.
"""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from abfm.calculus.channels import at_vertices, with_index
from abfm.errors import AbfmError, FunctionError, brief, one_line
from abfm.functions.objects import as_values, values_of_object
from abfm.functions.value_files import (
    HAVE_NAMED_ARRAYS,
    columns_of,
    reported,
    request_for,
)
from abfm.mesh import TriangleMesh
from abfm.mesh.objects import has
from abfm.reading import Format, counts_of, open_file
from abfm.sequences.reading.frames_file import FramesFile, by_frames, frames_of_columns
from abfm.sequences.reading.vtk_frames import vtk_frames
from abfm.types import FloatArray
from abfm.workers.control import CancelledError

_OF_VTK = (Format.COLLECTION, Format.SERIES, Format.VTK_XML, Format.VTK_LEGACY)


def read_frames(
    path: str | os.PathLike[str],
    mesh: TriangleMesh,
    array: str | None = None,
    hemisphere: str = "",
) -> FramesFile:
    """Read the frames of a film on a mesh.

    Any file that `abfm.functions.read_values` reads has a column for each frame. Arrays of .npy,
    .npz (one called ``frames``, and perhaps ``times``, as files of sequences have) and .mat are (T,
    V) or (T, V, C), with the axes in any order. .stc is one hemisphere of MNE's source estimates:
    between its sources, values are interpolated. .pvd and .series are ParaView's lists of .vtu or
    .vtp files, and one such file with a number at the end of its name stands for all that differ by
    the number.

    Parameters
    ----------
    path : path
    mesh : TriangleMesh
        What the frames are on; of files that hold meshes, too, only the values are taken.
    array : str, optional
        The array of a .npz or .mat, or of VTK's point data; needed where there are several.
    hemisphere : str
        "L" or "R", of files that hold both.

    Returns
    -------
    FramesFile
        Values (T, V) or (T, V, C), as many as vertices of the mesh or of its file; times (T,) in
        seconds, or None where the file does not say them; and notes, what a user should know.

    Raises
    ------
    FunctionError
        If the file is missing or damaged, or holds no frames of that mesh; a `SeveralArraysError`
        if it may hold them in several arrays, and none is chosen.
    """
    with reported(path, "frames"):
        opened = open_file(path)
        if opened.format in _OF_VTK:
            return _noted(by_frames(vtk_frames(opened, mesh, array), mesh))
        if array is not None and opened.format not in HAVE_NAMED_ARRAYS:
            raise ValueError(f"it is {opened.format}, without arrays called {brief(array)}")
        found = columns_of(opened, request_for(mesh, array, hemisphere))
        return _noted(frames_of_columns(found, mesh, opened.format is Format.STC))


def _noted(found: FramesFile) -> FramesFile:
    """Return frames with a note of how many vertices are not compared."""
    bad = ~np.isfinite(found.values)
    if not bad.any():
        return found
    count = np.count_nonzero(bad.any(axis=0 if bad.ndim == 2 else (0, 2)))
    note = (
        f"{count:,} of {found.values.shape[1]:,} vertices have values that are not finite, and are "
        "not compared"
    )
    return found._replace(notes=(*found.notes, note))


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
