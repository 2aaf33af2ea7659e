"""Writers of surfaces, values and labels for brain imaging: GIFTI, CIFTI and FreeSurfer.

nibabel formats the data; it is imported when a file is written, as the import is slow. GIFTI files
follow the conventions of Connectome Workbench: values in single precision, keys of 32 bits, and the
hemisphere as ``AnatomicalStructurePrimary``. Equal data always give equal files.
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
from abfm.io.atomic import write_atomically, write_file
from abfm.io.cifti_files import CIFTI_LABELS, CIFTI_VALUES, write_cifti_labels, write_cifti_values
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
from abfm.wording import counted

_PRIMARY_STRUCTURE_KEY = "AnatomicalStructurePrimary"
_INTENTS = {".shape.gii": "NIFTI_INTENT_SHAPE", ".func.gii": "NIFTI_INTENT_NONE"}
_TEXTS = {".csv": ",", ".txt": " "}
# longer endings first, so that .gii only matches other GIFTI files
_GIFTI = (".surf.gii", ".shape.gii", ".func.gii", ".label.gii", ".gii")
_SURFACES = (".surf.gii", ".gii", ".ply", *FREESURFER_SURFACES)
_OVERLAYS = (".mgh", ".mgz")
_VALUES = (
    *(*_GIFTI[1:3], ".gii", ".npy", *_TEXTS),
    *(*_OVERLAYS, *CIFTI_VALUES, *FREESURFER_VALUES),
)
_LABELS = (".label.gii", ".gii", ".annot", CIFTI_LABELS, ".npy", *_TEXTS)
_KEY_MAX = 2**31 - 1
_STAMP = "created by abfm"
_BYTE_MAX = 255
_COLOR_COUNT = 1 << 24


def write_surface(
    path: str | os.PathLike[str], mesh: TriangleMesh, structure: str | None = None
) -> None:
    """Write a mesh as .surf.gii, .gii, .ply or a FreeSurfer surface.

    GIFTI files, which may also end with .gz, and FreeSurfer files (``lh.white``, ``lh.sphere.reg``)
    have single precision and coordinates without a transform. Vertices are those of the mesh,
    without unused vertices of its file.

    Parameters
    ----------
    path : path
        File to write; the ending of its name determines the format.
    mesh : TriangleMesh
    structure : str, optional
        Anatomical structure, in the words of Connectome Workbench. The default is that of the mesh,
        or else ``CortexLeft`` or ``CortexRight`` from the file name (see
        ``abfm.reading.hemisphere``).

    Raises
    ------
    ResultError
        If the ending is not supported, a number is too large for single precision, or the file
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
    points = _gifti_array(vertices, "NIFTI_INTENT_POINTSET", meta)
    faces = _gifti_array(mesh.faces.astype(np.int32), "NIFTI_INTENT_TRIANGLE")
    _write_gifti(path, [points, faces], meta)


def check_surface_name(path: str | os.PathLike[str]) -> None:
    """Raise a ResultError if `write_surface` does not support the name."""
    _ending(path, _SURFACES)


def check_values_name(path: str | os.PathLike[str]) -> None:
    """Raise a ResultError if `write_values` does not support the name."""
    _ending(path, _VALUES)


def write_values(
    path: str | os.PathLike[str],
    values: ArrayLike,
    structure: str | None = None,
    names: Sequence[str] = (),
    times: ArrayLike | None = None,
) -> None:
    """Write values at vertices as GIFTI, CIFTI, .npy, .csv, .txt or a FreeSurfer file.

    The following formats have single precision; the others have all digits.

    - GIFTI (.shape.gii, .func.gii, .gii, also with .gz), with an array for each column
    - CIFTI (.dscalar.nii, .dtseries.nii), which requires the hemisphere
    - FreeSurfer: .mgh and .mgz, or a name such as ``lh.sulc`` for one column

    Parameters
    ----------
    values : (n,) or (n, C) array
        One row for each vertex of the mesh file.
    names : sequence of C str, optional
        Names of the columns in GIFTI, .dscalar.nii and .csv; other formats have no names.
    times : (C,) array, optional
        Times of the frames in .dtseries.nii in seconds, evenly spaced; by default 0, 1, 2, ...
        Other formats have no times.

    Raises
    ------
    ResultError
        In the cases of `write_surface`, whose other parameters are the same, or if values have
        another shape.
    """
    ending = _ending(path, _VALUES)
    array = real_numbers(values, "values", ResultError)
    if array.ndim not in (1, 2) or array.size == 0:
        raise ResultError(f"values have shape {array.shape}; expected (n,) or (n, C)")
    count = array.size // len(array)
    if names and len(names) != count:
        raise ResultError(
            f"values have {counted(count, 'column')} but {counted(len(names), 'name')}; "
            "expected a name for each"
        )
    column_names = [_printable(name, "a name of values") for name in names]
    if ending == ".npy" or ending in _TEXTS:
        is_integer = isinstance(values, np.ndarray) and values.dtype.kind in "iu"
        numbers = array.astype(np.int64) if is_integer else array
        _write_numbers(path, ending, numbers, column_names if ending == ".csv" else [])
        return
    columns = _single(array.reshape(len(array), count).T, "values")
    if ending in CIFTI_VALUES:
        cortex = _structure(path, structure).get(_PRIMARY_STRUCTURE_KEY)
        write_cifti_values(path, columns.T, column_names, cortex, times)
        return
    if ending in _OVERLAYS:
        image = import_module("nibabel.freesurfer").MGHImage
        shape = (len(array), 1, 1) + ((count,) if count > 1 else ())
        data = image(columns.T.reshape(shape), np.eye(4)).to_bytes()
        write_file(path, gzip.compress(data, mtime=0) if ending == ".mgz" else data)
        return
    if ending in FREESURFER_VALUES:
        if count != 1:
            raise ResultError(
                f"cannot write {path}: this FreeSurfer format has one column, but there are "
                f"{count}. Write .mgh, or a file for each column"
            )
        write = import_module("nibabel.freesurfer").write_morph_data
        with write_atomically(path) as temporary:
            write(temporary, columns[0])
        return
    intent = _INTENTS.get(ending, "NIFTI_INTENT_NONE")
    metas = [{"Name": name} for name in column_names] or [{}] * count
    arrays = [_gifti_array(c, intent, meta) for c, meta in zip(columns, metas, strict=True)]
    _write_gifti(path, arrays, _structure(path, structure))


def write_labels(
    path: str | os.PathLike[str], labels: Labels, structure: str | None = None
) -> None:
    """Write labels as GIFTI, .annot or .dlabel.nii, or only their keys as .npy, .csv or .txt.

    GIFTI files (.label.gii, .gii, also with .gz) store keys, names and colours. Vertices without a
    label, whose key is -1, get the key named "???" or "unknown", which is added if it is missing.

    An .annot file stores a colour for each vertex, but no keys. When it is read, names are numbered
    from 0, and vertices whose key has no name have the key -1. Each name needs its own colour: if a
    colour is missing, black, or already used, the next free colour is stored instead.

    Parameters
    ----------
    labels : Labels
        Labels as `abfm.functions.read_labels` returns them.

    Raises
    ------
    ResultError
        In the cases of `write_surface`, whose other parameters are the same, or if keys, names or
        colours cannot be written.
    """
    ending = _ending(path, _LABELS)
    keys = _keys(labels)
    if ending == ".npy" or ending in _TEXTS:
        _write_numbers(path, ending, keys)
        return
    if ending == ".annot":
        _write_annotation(path, keys, labels)
        return
    meta, complete = _structure(path, structure), replace(labels, values=keys).with_unknown()
    if ending == CIFTI_LABELS:
        write_cifti_labels(path, complete, meta.get(_PRIMARY_STRUCTURE_KEY))
    else:
        array = _gifti_array(complete.values.astype(np.int32), LABEL)
        _write_gifti(path, [array], meta, complete)


def _ending(path: str | os.PathLike[str], endings: tuple[str, ...]) -> str:
    """Return the ending of a file name, without .gz; ResultError if ``endings`` lacks it."""
    name = Path(path).name.lower()
    uncompressed = name.removesuffix(".gz") if name.endswith(".gii.gz") else name
    ending = next((end for end in (*_GIFTI, *endings) if uncompressed.endswith(end)), None)
    if ending not in endings:
        raise ResultError(
            f"cannot write {path}: the ending of the name is not supported; expected "
            f"{', '.join(endings)}"
        )
    return ending


def _single(values: FloatArray, name: str) -> NDArray[np.float32]:
    with np.errstate(over="ignore"):
        single = np.ascontiguousarray(values, dtype=np.float32)
    if (np.isinf(single) & np.isfinite(values)).any():
        raise ResultError(f"{name} are too large for single precision. Scale them down")
    return single


def _structure(path: str | os.PathLike[str], structure: str | None) -> dict[str, str]:
    structure = structure or STRUCTURES.get(hemisphere(path) or "")
    if not structure:
        return {}
    return {_PRIMARY_STRUCTURE_KEY: _printable(structure, "structure")}


def _printable(text: object, what: str) -> str:
    if not (isinstance(text, str) and text.isprintable()):
        raise ResultError(f"{what} is {brief(text)}; expected a text of printable characters")
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
    write_file(path, gzip.compress(data, mtime=0) if is_packed else data)


def _write_numbers(
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
        raise ResultError(f"cannot write {path}: the labels have no names. Write them as .npy")
    numbers = {int(key): number for number, key in enumerate(labels.names)}
    unique, place = np.unique(keys, return_inverse=True)
    found = np.array([numbers.get(key, -1) for key in unique.tolist()])[place]
    names = [name.encode("utf-8") for name in labels.names.values()]
    with write_atomically(path) as temporary:
        write(temporary, found, _table(labels), names)


def _table(labels: Labels) -> IntArray:
    """Return a colour table (n, 4) of label names: red, green, blue and transparency, 0 to 255.

    The next free colour replaces black and repeated colours. A label without a colour is grey.
    """
    used, rows = {0}, []
    for key in labels.names:
        color = _color(labels, key)
        code = (round(_BYTE_MAX * part) for part in color or (0.5, 0.5, 0.5, 1.0))
        red, green, blue, opacity = code
        packed = red | green << 8 | blue << 16
        while packed in used:
            packed = (packed + 1) % _COLOR_COUNT
        used.add(packed)
        rows.append([packed & 255, packed >> 8 & 255, packed >> 16, _BYTE_MAX - opacity])
    return np.array(rows, dtype=np.int64)


def _keys(labels: Labels) -> IntArray:
    """Return the key of each vertex, shape (n,), or raise a ResultError for invalid labels."""
    if not isinstance(labels, Labels):
        raise ResultError(
            f"labels are {brief(labels)}; expected Labels, as returned by read_labels"
        )
    values = real_numbers(labels.values, "keys of labels", ResultError)
    named = real_numbers([*labels.names], "keys of names", ResultError)
    if values.ndim != 1 or len(values) == 0:
        raise ResultError(f"keys of labels have shape {values.shape}; expected (n,)")
    for key in (*np.unique(values).tolist(), *named.tolist()):
        if not (abs(key) <= _KEY_MAX and key == int(key)):
            raise ResultError(
                f"the key of a label is {key:g}; expected an integer of at most {_KEY_MAX}"
            )
    for key, name in labels.names.items():
        _printable(name, f"the name of label {key}")
        _color(labels, key)
    return values.astype(np.int64)


def _color(labels: Labels, key: int) -> tuple[float, ...]:
    """Return red, green, blue and opacity of a label, 0 to 1; empty if it has no colour."""
    if key not in labels.colors:
        return ()
    color = real_numbers(labels.colors[key], f"the colour of label {key}", ResultError)
    if color.shape != (4,) or not ((color >= 0) & (color <= 1)).all():
        raise ResultError(
            f"the colour of label {key} is {one_line(color, 60)}; expected four numbers from 0 to 1"
        )
    return tuple(color.tolist())
