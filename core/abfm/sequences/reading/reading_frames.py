"""Frames from files: arrays, tables, and films as brain imaging and VTK have them."""

from __future__ import annotations

import os

import numpy as np

from abfm.errors import brief
from abfm.functions.value_files import (
    HAVE_NAMED_ARRAYS,
    VALUES_ENDINGS,
    Request,
    columns_of,
    reported,
)
from abfm.mesh import TriangleMesh
from abfm.numerics.real_numbers import as_doubles
from abfm.reading import Format, counts_of, open_file, vertex_axis
from abfm.sequences.reading.frames_file import FramesFile
from abfm.sequences.reading.source_frames import source_frames
from abfm.sequences.reading.vtk_frames import VTK_ENDINGS, vtk_frames

_OF_VTK = (Format.COLLECTION, Format.SERIES, Format.VTK_XML, Format.VTK_LEGACY)
ENDINGS = tuple(dict.fromkeys((*VALUES_ENDINGS, *VTK_ENDINGS)))
"""What names of files of frames end in."""


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
            return _checked(vtk_frames(opened.path, mesh, array), mesh, frames_first=True)
        if array is not None and opened.format not in HAVE_NAMED_ARRAYS:
            raise ValueError(f"it is {opened.format}, without arrays called {brief(array)}")
        request = Request(counts_of(mesh), array, hemisphere, mesh=mesh)
        found = columns_of(opened, request).by_vertex()
        if any(found.keys):
            raise ValueError("it holds labels, which are no values that move")
        if opened.format is Format.STC:
            return _checked(source_frames(found, mesh), mesh, frames_first=True)
        if found.vertices is not None:
            values = found.on(mesh).table().T
            return _checked(FramesFile(values, found.times, found.notes), mesh, frames_first=True)
        return _checked(
            FramesFile(found.values, found.times, found.notes), mesh, found.frames_first
        )


def _checked(found: FramesFile, mesh: TriangleMesh, frames_first: bool) -> FramesFile:
    """Return frames (T, V) or (T, V, C) as real numbers; any axis may be the vertices.

    If several fit, the second one is, or the first one unless ``frames_first``.
    """
    given, times, notes = found.values, found.times, [*found.notes]
    if given.ndim not in (2, 3) or given.size == 0:
        raise ValueError(f"it is an array of shape {given.shape}; expected (T, V) or (T, V, C)")
    counts = counts_of(mesh)
    axis = vertex_axis(given.shape, counts, 1 if frames_first else 0)
    if given.shape[axis] not in counts:
        sizes = " or ".join(map(str, sorted({*counts})))
        hint = ""
        if len(mesh.faces) in given.shape:
            hint = f", and {len(mesh.faces)} faces: give values at vertices, such as means of faces"
        raise ValueError(f"it has the shape {given.shape}; the mesh has {sizes} vertices{hint}")
    if frames_first and axis == 0:
        channels = f", {given.shape[1]} of them, of {given.shape[-1]} channels"
        notes.append(
            f"its {len(given):,} rows are the vertices, its columns the frames"
            + channels * (given.ndim == 3)
        )
    elif frames_first and given.shape[0] in counts:
        notes.append("it has as many frames as vertices: its rows are taken as the frames")
    values = np.ascontiguousarray(as_doubles(np.moveaxis(given, axis, 1)))
    bad = ~np.isfinite(values)
    if bad.any():
        count = np.count_nonzero(bad.any(axis=0 if bad.ndim == 2 else (0, 2)))
        notes.append(
            f"{count:,} of {values.shape[1]:,} vertices have values that are not finite, and are "
            "not compared"
        )
    if times is not None and times.shape != (len(values),):
        raise ValueError(f"it has {times.size} times for {len(values)} frames")
    return FramesFile(values, times, tuple(notes))
