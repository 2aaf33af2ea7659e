"""Frames from files and objects: arrays, tables, brain imaging, VTK, and other libraries."""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from abfm.calculus.channels import at_vertices, with_index
from abfm.errors import AbfmError, FunctionError, brief, one_line
from abfm.functions.objects import as_values, values_of_object
from abfm.functions.value_files import HAVE_NAMED_ARRAYS, columns_of, file_errors, request_for
from abfm.mesh import TriangleMesh
from abfm.mesh.objects import has
from abfm.reading import Format, counts_of, open_file
from abfm.sequences.reading.frames_file import FramesFile, by_frames, frames_of_columns
from abfm.sequences.reading.vtk_frames import vtk_frames
from abfm.types import FloatArray
from abfm.workers.control import CancelledError

_OF_VTK = (Format.COLLECTION, Format.SERIES, Format.VTK_XML, Format.VTK_LEGACY)


def read_frames(
    path: str | os.PathLike[str], mesh: TriangleMesh, array: str | None = None, hemisphere: str = ""
) -> FramesFile:
    """Read the frames of a sequence on a mesh.

    Any file that `abfm.functions.read_values` reads has a column for each frame. Arrays of .npy,
    .npz and .mat files are (T, V) or (T, V, C), with the axes in any order. A .npz may have
    ``frames`` and ``times``, as files of sequences have. A .stc is one hemisphere of MNE's source
    estimates; values are interpolated between its sources. A .pvd or .series is a ParaView list of
    .vtu or .vtp files. One such file with a number at the end of its name stands for all files that
    differ only in the number.

    Parameters
    ----------
    path : path
    mesh : TriangleMesh
        The mesh of the frames. Files that also contain meshes are read for their values only.
    array : str, optional
        Name of the array in a .npz or .mat file, or in VTK point data; needed if there are several.
    hemisphere : str
        Hemisphere, "L" or "R", in a file with both.

    Returns
    -------
    FramesFile
        Values (T, V) or (T, V, C) at the vertices of the mesh or of its file. Times (T,) are in
        seconds, or None if the file has none. Notes are for the user.

    Raises
    ------
    FunctionError
        If the file is missing or damaged, or has no frames on this mesh. A `SeveralArraysError` is
        raised if several arrays fit and none is chosen.
    """
    with file_errors(path, "frames"):
        opened = open_file(path)
        if opened.format in _OF_VTK:
            return _noted(by_frames(vtk_frames(opened, mesh, array), mesh))
        if array is not None and opened.format not in HAVE_NAMED_ARRAYS:
            raise ValueError(f"it is {opened.format}, which has no array called {brief(array)}")
        found = columns_of(opened, request_for(mesh, array, hemisphere))
        return _noted(frames_of_columns(found, mesh, opened.format is Format.STC))


def _noted(found: FramesFile) -> FramesFile:
    """Return frames with a note on the vertices that are not compared in frames with values."""
    bad = ~np.isfinite(found.values)
    bad = bad[~bad.reshape(len(bad), -1).all(axis=1)]  # frames without values are left out
    if not bad.any():
        return found
    count = np.count_nonzero(bad.any(axis=0 if bad.ndim == 2 else (0, 2)))
    note = (
        f"{count:,} of {found.values.shape[1]:,} vertices have values that are not finite; they "
        "are not compared"
    )
    return found._replace(notes=(*found.notes, note))


def frames_of(given: Any, mesh: TriangleMesh) -> FramesFile:
    """Return frames (T, V) or (T, V, C), and their times if an object has them.

    The argument is an input of `abfm.functions.as_values` with a column for each frame, a list of
    frames, or the name of a file. In pandas objects, either rows or columns are vertices. The axis
    of the vertices has as many entries as the mesh or its file has vertices. If several axes have
    this size, the second one is used, with a note. Raises FunctionError if the values are not real
    numbers, or do not fit the mesh.
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
    except Exception as problem:  # objects of other libraries may raise anything
        raise FunctionError(f"frames: {one_line(problem, 400)}") from problem


def _array(mesh: TriangleMesh, given: Any) -> FloatArray:
    given, counts = with_index(given), counts_of(mesh)
    is_list = isinstance(given, list | tuple) and not all(isinstance(each, list) for each in given)
    has_vertex_rows = (
        is_list
        and len(given) in counts
        and isinstance(given[0], np.ndarray)
        and given[0].ndim == 1
        and len(given[0]) not in counts
    )
    if is_list and not has_vertex_rows:
        return np.stack([as_values(mesh, each, f"frame {i}") for i, each in enumerate(given)])
    is_table = has(given, "iloc", "columns")
    if is_table and given.shape[1] in counts_of(mesh):
        return at_vertices(mesh, given.T, "frames").T
    values = at_vertices(mesh, given, "frames")
    return values.T if is_table else values
