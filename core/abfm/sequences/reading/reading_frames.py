"""Frames from files: arrays, tables, and films as brain imaging and VTK have them."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from abfm.errors import FunctionError, SeveralArraysError, brief, did_you_mean, one_line
from abfm.functions import read_table
from abfm.io import results
from abfm.mesh import TriangleMesh
from abfm.numerics.real_numbers import as_doubles
from abfm.reading import LABEL, array_from, freesurfer_frames, open_plain, read_bytes, read_gifti
from abfm.sequences.reading.frames_file import FramesFile
from abfm.sequences.reading.source_frames import source_frames
from abfm.sequences.reading.vtk_frames import VTK_ENDINGS, vtk_frames
from abfm.types import FloatArray

_OF_SURFACES = {"NIFTI_INTENT_POINTSET", "NIFTI_INTENT_TRIANGLE"}
_LONGEST = 20.0  # seconds between functional images; what is more is milliseconds


def read_frames(
    path: str | os.PathLike[str], mesh: TriangleMesh, array: str | None = None
) -> FramesFile:
    """Read the frames of a film on a mesh.

    .npy holds an array (T, V) or (T, V, C); .npz holds one called ``frames``, and perhaps
    ``times``, as files of sequences do. .csv, .txt, FreeSurfer's .mgh and GIFTI have a column for
    each frame, as .npy may. .stc is one hemisphere of MNE's source estimates: between its sources,
    values are interpolated. .pvd and .series are ParaView's lists of .vtu or .vtp files, and one
    such file with a number at the end of its name stands for all that differ by the number.

    Parameters
    ----------
    path : path
    mesh : TriangleMesh
        What the frames are on; of files that hold meshes, too, only the values are taken.
    array : str, optional
        The array of a .npz, or of VTK's point data; needed where there are several.

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
    name = os.fspath(path)
    ending = next((each for each in ENDINGS if name.lower().endswith(each)), None)
    try:
        if ending is None:
            raise ValueError(f"its name must end in {', '.join(ENDINGS)}")
        if array is not None and ending not in _WITH_NAMES:
            raise ValueError(f"a file {ending} has no arrays with names, such as {brief(array)}")
        found = _READERS[ending](Path(os.path.expanduser(name)), mesh, array)
        return _checked(found, mesh)
    except SeveralArraysError as error:
        raise error.of(f"frames {brief(name)}") from error
    except OSError as error:
        raise FunctionError(f"frames {brief(name)} cannot be read: {one_line(error)}") from error
    except ValueError as error:  # of the readers, or one of ours
        raise FunctionError(f"frames {brief(name)}: {one_line(error, 400)}") from error


def _checked(found: FramesFile, mesh: TriangleMesh) -> FramesFile:
    """Return frames with a row for each, as real numbers."""
    given, times, notes = found.values, found.times, [*found.notes]
    if given.dtype.kind not in "biuf" or given.ndim not in (2, 3) or given.size == 0:
        raise ValueError(
            f"it is an array of {given.dtype} of shape {given.shape}; expected real numbers (T, V) "
            "or (T, V, C)"
        )
    sizes = {len(mesh.vertices), mesh.file_vertex_count}
    if given.shape[1] not in sizes and given.shape[0] in sizes:
        told = f"its {given.shape[0]:,} rows are the vertices, its columns the frames"
        given = given.swapaxes(0, 1)
        of_channels = f", {len(given)} of them, of {given.shape[-1]} channels"
        notes.append(told + of_channels * (given.ndim == 3))
    elif given.shape[0] in sizes and given.shape[1] in sizes:
        notes.append("it has as many frames as vertices: its rows are taken as the frames")
    if given.shape[1] not in sizes:
        counts = " or ".join(map(str, sorted(sizes)))
        hint = ""
        if len(mesh.faces) in given.shape:
            hint = f", and {len(mesh.faces)} faces: give values at vertices, such as means of faces"
        elif sizes & {*given.shape}:
            hint = ": give the axes in the order (T, V, C)"
        raise ValueError(f"it has the shape {given.shape}; the mesh has {counts} vertices{hint}")
    values = as_doubles(given)
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


def _npy(file: Path, mesh: TriangleMesh, array: str | None) -> FramesFile:
    return FramesFile(array_from(read_bytes(file)))


def _npz(file: Path, mesh: TriangleMesh, array: str | None) -> FramesFile:
    with open_plain(file) as opened:
        try:
            archive = results.Archive(opened)
            alone = next(iter(archive)) if len(archive) == 1 else "frames"
            if (name := array or alone) not in archive:
                _refuse(archive, name, mesh if array is None else None)
            values, times = archive[name], archive.get("times")
        except (OSError, ValueError, SeveralArraysError):
            raise
        except Exception as error:  # damage makes anything of the readers of zips
            told = one_line(error, 300)
            raise ValueError(f"it is no .npz, or damaged or cut short ({told})") from error
    if times is not None and (times.dtype.kind not in "iuf" or times.ndim != 1):
        raise ValueError(
            f"its times are {times.dtype} of shape {times.shape}; expected real numbers (T,)"
        )
    return FramesFile(values, None if times is None else times.astype(np.float64))


def _refuse(archive: results.Archive, name: str, mesh: TriangleMesh | None) -> NoReturn:
    """Say that there is no such array; on a mesh which ones may be its frames."""
    listed = ", ".join(one_line(each, 30) for each in sorted(archive)[:8]) or "none"
    text = f"it has no array {brief(name)}{did_you_mean(name, archive)}; there is {listed}"
    if results.is_own(archive):
        raise ValueError(f"it is a file of abfm's own, and holds no frames: {text}")
    films = [each for each in sorted(archive) if mesh and _may_be_frames(archive, each, mesh)]
    raise SeveralArraysError(f"{text}; choose one of them", films) if films else ValueError(text)


def _may_be_frames(archive: results.Archive, name: str, mesh: TriangleMesh) -> bool:
    try:
        values = archive[name]
    except Exception:  # damage, or an array of objects
        return False
    sizes = {len(mesh.vertices), mesh.file_vertex_count}
    return values.ndim in (2, 3) and values.dtype.kind in "biuf" and bool(sizes & {*values.shape})


def _table(file: Path, mesh: TriangleMesh, array: str | None) -> FramesFile:
    return FramesFile(_rows(read_table(str(file))[1], mesh))


def _rows(table: NDArray[Any], mesh: TriangleMesh) -> NDArray[Any]:
    """Return the columns of a table whose rows are vertices, as rows; else the table."""
    return table.T if len(table) in (len(mesh.vertices), mesh.file_vertex_count) else table


def _mgh(file: Path, mesh: TriangleMesh, array: str | None) -> FramesFile:
    table, milliseconds = freesurfer_frames(file)
    return FramesFile(_rows(table, mesh), _stepped(table.shape[1], milliseconds / 1000))


def _gifti(file: Path, mesh: TriangleMesh, array: str | None) -> FramesFile:
    gifti = read_gifti(file)
    if any(each.intent == LABEL for each in gifti.arrays):
        raise ValueError("it holds labels, which are no values that move")
    if any(each.intent in _OF_SURFACES for each in gifti.arrays):
        raise ValueError("it holds a surface; give the file of its values, and this as the mesh")
    arrays = [each.values for each in gifti.arrays]
    if len({each.shape for each in arrays}) != 1:
        raise ValueError(f"it holds {len(arrays)} arrays of several shapes; expected one a frame")
    values = np.stack(arrays) if len(arrays) > 1 or arrays[0].ndim == 1 else _rows(arrays[0], mesh)
    given = gifti.time_step
    in_seconds = given <= _LONGEST
    times = _stepped(len(values), given if in_seconds else given / 1000)
    unit = "seconds" if in_seconds else "milliseconds"
    note = f"its TimeStep of {given:g} is taken as {unit}"
    return FramesFile(values, times, () if times is None else (note,))


def _stepped(count: int, seconds: float) -> FloatArray | None:
    """Return times from 0 on, or none where files say no step, or 0."""
    known = math.isfinite(seconds) and seconds > 0
    return seconds * np.arange(count, dtype=np.float64) if known else None


def _stc(file: Path, mesh: TriangleMesh, array: str | None) -> FramesFile:
    return source_frames(file, mesh)


_READERS: dict[str, Callable[[Path, TriangleMesh, str | None], FramesFile]] = {
    ".npy": _npy,
    ".npz": _npz,
    ".csv": _table,
    ".txt": _table,
    ".gii": _gifti,
    ".gii.gz": _gifti,
    ".mgh": _mgh,
    ".mgz": _mgh,
    ".stc": _stc,
    **dict.fromkeys(VTK_ENDINGS, vtk_frames),
}
_WITH_NAMES = (".npz", *VTK_ENDINGS)
ENDINGS = tuple(_READERS)
"""What names of files of frames end in."""
