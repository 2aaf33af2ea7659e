"""Surfaces, values and labels as brain imaging has them: GIFTI, and the files of FreeSurfer.

nibabel makes the bytes; it is imported when a file is written, as that takes time.
GIFTI is as Connectome Workbench expects it: values of single precision, keys of 32 bits, the
hemisphere as ``AnatomicalStructurePrimary``. The same data makes the same file every time.
"""

import gzip
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from abfm.errors import ResultError, brief, one_line
from abfm.io.atomic import write_atomically, write_whole
from abfm.io.cifti_files import (
    CIFTI_LABELS,
    CIFTI_VALUES,
    write_cifti_labels,
    write_cifti_values,
)
from abfm.io.exports import export_ply
from abfm.io.tables import write_csv
from abfm.mesh import TriangleMesh
from abfm.numerics.real_numbers import real_numbers
from abfm.reading import (
    FREESURFER_SURFACES,
    FREESURFER_VALUES,
    LABEL,
    STRUCTURES,
    Labels,
    hemisphere,
)
from abfm.types import FloatArray, IntArray

_PRIMARY_STRUCTURE_KEY = "AnatomicalStructurePrimary"
_INTENTS = {".shape.gii": "NIFTI_INTENT_SHAPE", ".func.gii": "NIFTI_INTENT_NONE"}
_TEXTS = {".csv": ",", ".txt": " "}
# longer ones first, so that what is neither .surf.gii nor the like is plain GIFTI
_GIFTI = (".surf.gii", ".shape.gii", ".func.gii", ".label.gii", ".gii")
_SURFACES = (".surf.gii", ".gii", ".ply", *FREESURFER_SURFACES)
_OVERLAYS = (".mgh", ".mgz")
_VALUES = (
    *(*_GIFTI[1:3], ".gii", ".npy", *_TEXTS),
    *(*_OVERLAYS, *CIFTI_VALUES, *FREESURFER_VALUES),
)
_LABELS = (".label.gii", ".gii", ".annot", CIFTI_LABELS, ".npy", *_TEXTS)
_LARGEST_KEY = 2**31 - 1
_STAMP = "created by abfm"
_BYTE_MAX = 255
_COLOURS = 1 << 24


def write_surface(
    path: str | os.PathLike[str], mesh: TriangleMesh, structure: str | None = None
) -> None:
    """Write a mesh: .surf.gii, .gii, .ply, or FreeSurfer's by what surfaces are called.

    GIFTI, which may also end in .gz, and FreeSurfer's (``lh.white``, ``lh.sphere.reg``) have single
    precision, and coordinates as they are, without a transform. Vertices are those of the mesh:
    what no face used in its file is not there.

    Parameters
    ----------
    path : path
        The ending of its name says the format.
    mesh : TriangleMesh
    structure : str, optional
        What it is a surface of, as Connectome Workbench calls it; by default that of the mesh, or
        else ``CortexLeft`` or ``CortexRight`` by the file's name (see `abfm.reading.hemisphere`).

    Raises
    ------
    ResultError
        If the ending is none of these, a number is too large for single precision, or the file
        cannot be written.
    """
    ending = _ending(path, _SURFACES)
    if ending == ".ply":
        export_ply(path, mesh, {}, {})
        return
    vertices = _single(mesh.vertices, "coordinates")
    if ending in FREESURFER_SURFACES:
        write = import_module("nibabel.freesurfer").write_geometry
        with write_atomically(path) as temporary:
            write(temporary, vertices, mesh.faces, create_stamp=_STAMP)
        return
    meta = _structure(path, structure or mesh.structure)
    _write_gifti(
        path,
        [
            _gifti_array(vertices, "NIFTI_INTENT_POINTSET", meta),
            _gifti_array(mesh.faces.astype(np.int32), "NIFTI_INTENT_TRIANGLE"),
        ],
        meta,
    )


def check_surface_name(path: str | os.PathLike[str]) -> None:
    """Refuse a name that `write_surface` would refuse, by the same ResultError."""
    _ending(path, _SURFACES)


def check_values_name(path: str | os.PathLike[str]) -> None:
    """Refuse a name that `write_values` would refuse, by the same ResultError."""
    _ending(path, _VALUES)


def write_values(
    path: str | os.PathLike[str],
    values: ArrayLike,
    structure: str | None = None,
    names: Sequence[str] = (),
    times: ArrayLike | None = None,
) -> None:
    """Write values at vertices: GIFTI, CIFTI, .npy, .csv, .txt or FreeSurfer's.

    GIFTI, which may also end in .gz and has an array a column, CIFTI (.dscalar.nii, .dtseries.nii),
    which needs to know the hemisphere, and FreeSurfer's, .mgh, .mgz and for one column ``lh.sulc``
    and the like, have single precision; all else keeps every digit.

    Parameters
    ----------
    values : (n,) or (n, C) array
        One row per vertex of the file that they belong to.
    names : sequence of C str, optional
        What the columns are called, in GIFTI and .csv; other formats have no names.
    times : (C,) array, optional
        Seconds of the frames in .dtseries.nii, evenly spaced, by default 0, 1, 2, ...; other
        formats have no times.

    Raises
    ------
    ResultError
        As in `write_surface`, whose other parameters are the same, or if values are no such array.
    """
    ending = _ending(path, _VALUES)
    array = real_numbers(values, "values", ResultError)
    if array.ndim not in (1, 2) or array.size == 0:
        raise ResultError(f"values have shape {array.shape}; expected (n,) or (n, C)")
    count = array.size // len(array)
    if names and len(names) != count:
        raise ResultError(f"{len(names)} names were given for {count} columns of values")
    called = [_printable(name, "a name of values") for name in names]
    if ending == ".npy" or ending in _TEXTS:
        is_whole = isinstance(values, np.ndarray) and values.dtype.kind in "iu"
        plain = array.astype(np.int64) if is_whole else array
        _write_plain(path, ending, plain, called if ending == ".csv" else [])
        return
    columns = _single(array.reshape(len(array), count).T, "values")
    if ending in CIFTI_VALUES:
        of = _structure(path, structure).get(_PRIMARY_STRUCTURE_KEY)
        write_cifti_values(path, columns.T, called, of, times)
        return
    if ending in _OVERLAYS:
        image = import_module("nibabel.freesurfer").MGHImage
        shape = (len(array), 1, 1) + ((count,) if count > 1 else ())
        data = image(columns.T.reshape(shape), np.eye(4)).to_bytes()
        write_whole(path, gzip.compress(data, mtime=0) if ending == ".mgz" else data)
        return
    if ending in FREESURFER_VALUES:
        if count != 1:
            raise ResultError(
                f"cannot write {path}: FreeSurfer's files hold one column, and {count} are given; "
                "write them one by one, or .mgh"
            )
        write = import_module("nibabel.freesurfer").write_morph_data
        with write_atomically(path) as temporary:
            write(temporary, columns[0])
        return
    intent = _INTENTS.get(ending, "NIFTI_INTENT_NONE")
    metas = [{"Name": name} for name in called] or [{}] * count
    arrays = [_gifti_array(c, intent, meta) for c, meta in zip(columns, metas, strict=True)]
    _write_gifti(path, arrays, _structure(path, structure))


def write_labels(
    path: str | os.PathLike[str], labels: Labels, structure: str | None = None
) -> None:
    """Write labels: .label.gii, .gii, .annot, .dlabel.nii, and only their keys .npy, .csv, .txt.

    GIFTI, which may also end in .gz, keeps keys, names and colours; vertices without a label, whose
    key is -1, get the key called "???" or "unknown" there, which is added if it is missing. An
    .annot file gives every vertex a colour, and has no keys: names come back numbered from 0 in
    their order, and vertices whose key has no name with the key -1. Of names that have one colour,
    black or none, all but the first get the next colour that is free.

    Parameters
    ----------
    labels : Labels
        As `abfm.functions.read_labels` returns them.

    Raises
    ------
    ResultError
        As in `write_surface`, whose other parameters are the same, or if keys, names or colours
        cannot be written.
    """
    ending = _ending(path, _LABELS)
    keys = _keys(labels)
    if ending == ".npy" or ending in _TEXTS:
        _write_plain(path, ending, keys)
        return
    if ending == ".annot":
        _write_annotation(path, keys, labels)
        return
    meta, known = _structure(path, structure), replace(labels, values=keys).with_unknown()
    if ending == CIFTI_LABELS:
        write_cifti_labels(path, known, meta.get(_PRIMARY_STRUCTURE_KEY))
    else:
        _write_gifti(path, [_gifti_array(known.values.astype(np.int32), LABEL)], meta, known)


def _ending(path: str | os.PathLike[str], known: tuple[str, ...]) -> str:
    """Return the one of the known endings that a file's name has, .gz left out."""
    name = Path(path).name.lower()
    plain = name.removesuffix(".gz") if name.endswith(".gii.gz") else name
    ending = next((end for end in (*_GIFTI, *known) if plain.endswith(end)), None)
    if ending not in known:
        raise ResultError(f"cannot write {path}: its name must end in {', '.join(known)}")
    return ending


def _single(values: FloatArray, name: str) -> NDArray[np.float32]:
    with np.errstate(over="ignore"):
        single = np.ascontiguousarray(values, dtype=np.float32)
    if (np.isinf(single) & np.isfinite(values)).any():
        raise ResultError(f"{name} are too large for single precision: scale them")
    return single


def _structure(path: str | os.PathLike[str], given: str | None) -> dict[str, str]:
    structure = given or STRUCTURES.get(hemisphere(path) or "")
    if not structure:
        return {}
    return {_PRIMARY_STRUCTURE_KEY: _printable(structure, "structure")}


def _printable(text: object, what: str) -> str:
    if not (isinstance(text, str) and text.isprintable()):
        raise ResultError(f"{what} is {brief(text)}; expected a name that can be printed")
    return text


def _gifti_array(values: NDArray[Any], intent: str, meta: Mapping[str, str] | None = None) -> Any:
    gifti = import_module("nibabel.gifti")
    kind = f"NIFTI_TYPE_{values.dtype.name.upper()}"
    return gifti.GiftiDataArray(values, intent, kind, meta=gifti.GiftiMetaData(meta or {}))


def _write_gifti(
    path: str | os.PathLike[str],
    arrays: list[Any],
    meta: Mapping[str, str],
    labels: Labels | None = None,
) -> None:
    gifti = import_module("nibabel.gifti")
    image = gifti.GiftiImage(darrays=arrays, meta=gifti.GiftiMetaData(meta))
    if labels:
        for key, name in labels.names.items():
            label = gifti.GiftiLabel(int(key), *_color(labels, key))
            label.label = name
            image.labeltable.labels.append(label)
    data = image.to_bytes()
    is_packed = os.fspath(path).lower().endswith(".gz")
    write_whole(path, gzip.compress(data, mtime=0) if is_packed else data)


def _write_plain(
    path: str | os.PathLike[str], ending: str, values: NDArray[Any], names: Sequence[str] = ()
) -> None:
    if names:
        write_csv(path, [names, *values.reshape(len(values), -1).tolist()])
        return
    with write_atomically(path) as temporary, temporary.open("wb") as file:
        if ending == ".npy":
            np.save(file, values)
        else:
            form = "%d" if values.dtype.kind == "i" else "%.17g"
            np.savetxt(file, values, form, _TEXTS[ending])


def _write_annotation(path: str | os.PathLike[str], keys: IntArray, labels: Labels) -> None:
    write = import_module("nibabel.freesurfer").write_annot
    if not labels.names:
        raise ResultError(f"cannot write {path}: its labels have no names; write them as .npy")
    numbers = {int(key): number for number, key in enumerate(labels.names)}
    known, place = np.unique(keys, return_inverse=True)
    found = np.array([numbers.get(key, -1) for key in known.tolist()])[place]
    names = [name.encode("utf-8") for name in labels.names.values()]
    with write_atomically(path) as temporary:
        write(temporary, found, _table(labels), names)


def _table(labels: Labels) -> IntArray:
    """Return red, green, blue and transparency of each name, (n, 4), no two alike, none black."""
    taken, rows = {0}, []
    for key in labels.names:
        color = _color(labels, key)
        code = (round(_BYTE_MAX * part) for part in color or (0.5, 0.5, 0.5, 1.0))
        red, green, blue, opacity = code
        packed = red | green << 8 | blue << 16
        while packed in taken:
            packed = (packed + 1) % _COLOURS
        taken.add(packed)
        rows.append([packed & 255, packed >> 8 & 255, packed >> 16, _BYTE_MAX - opacity])
    return np.array(rows, dtype=np.int64)


def _keys(labels: Labels) -> IntArray:
    """Return the keys of vertices, (n,), of labels that can be written."""
    if not isinstance(labels, Labels):
        raise ResultError(f"labels are {brief(labels)}; expected what read_labels returns")
    values = real_numbers(labels.values, "keys of labels", ResultError)
    named = real_numbers([*labels.names], "keys of names", ResultError)
    if values.ndim != 1 or len(values) == 0:
        raise ResultError(f"keys of labels have shape {values.shape}; expected (n,)")
    for key in (*np.unique(values).tolist(), *named.tolist()):
        if not (abs(key) <= _LARGEST_KEY and key == int(key)):
            raise ResultError(
                f"a label has the key {key:g}; expected a whole number of at most {_LARGEST_KEY}"
            )
    for key, name in labels.names.items():
        _printable(name, f"the name of label {key}")
        _color(labels, key)
    return values.astype(np.int64)


def _color(labels: Labels, key: int) -> tuple[float, ...]:
    """Return red, green, blue and opacity of a label, or nothing where it has no colour."""
    if key not in labels.colors:
        return ()
    color = real_numbers(labels.colors[key], f"the colour of label {key}", ResultError)
    if color.shape != (4,) or not ((color >= 0) & (color <= 1)).all():
        raise ResultError(
            f"the colour of label {key} is {one_line(color, 60)}; expected four numbers from 0 to 1"
        )
    return tuple(color.tolist())
