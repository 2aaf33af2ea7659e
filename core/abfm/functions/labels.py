"""Labels of vertices read from files that count as the mesh file does, and the place of a label."""

import os
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from abfm.errors import FunctionError, brief, did_you_mean, one_line
from abfm.mesh import TriangleMesh
from abfm.reading import (
    LABEL,
    Labels,
    freesurfer_annotation,
    freesurfer_label,
    read_gifti,
)
from abfm.types import BoolArray, FloatArray

__all__ = ["Labels", "listed_vertices", "read_labels", "where_label"]

LISTED = ".label"
"""Ending of files that list the vertices of one label."""
_SUFFIXES = (".label.gii", ".gii", ".gii.gz", ".annot")
_MOST_SHOWN = 8


def read_labels(path: str | os.PathLike[str], column: str | None = None) -> Labels:
    """Read one key per vertex with the names and colours of the keys, from .label.gii or .annot.

    Parameters
    ----------
    path : path
    column : str, optional
        Which array of a GIFTI file, by its name or number, counted from 0; needed where there are
        several.

    Raises
    ------
    FunctionError
        If the file cannot be read, or does not say that what it holds are labels.
    """
    name = os.fspath(path)
    file = Path(os.path.expanduser(name))
    try:
        if file.name.lower().endswith(".annot"):
            _check_column(column, 1)
            return freesurfer_annotation(file)
        if file.name.lower().endswith(_SUFFIXES):
            return _of_gifti(file, column)
    except OSError as error:
        raise FunctionError(f"file {brief(name)} cannot be read: {one_line(error)}") from error
    except Exception as error:  # whatever a broken file makes of the readers
        raise FunctionError(f"file {brief(name)} holds no labels: {one_line(error)}") from error
    only = ", but lists the vertices of one: give it as file:, a function that is 1 there"
    raise FunctionError(
        f"file {brief(name)} holds no labels"
        + (only if file.name.lower().endswith(LISTED) else f"; expected {', '.join(_SUFFIXES)}")
    )


def where_label(path: str, label: str, column: str | None = None) -> BoolArray:
    """Return which vertices, (n,), of a file have a label, given by its name or its key.

    A FunctionError says that there is none, or why the file cannot be read.
    """
    labels = read_labels(path, column)
    try:
        return labels.where(label)
    except KeyError:
        raise FunctionError(
            f"file {brief(path)} has no label {brief(label)}{_near(label, labels.names.values())}"
        ) from None


def listed_vertices(mesh: TriangleMesh, path: str, column: str | None = None) -> FloatArray:
    """Return a function, (V,), by what a .label file lists: 1 at its vertices, and 0 elsewhere.

    With the column ``value`` it has the values of the file there instead. A FunctionError says
    that the file cannot be read, or lists vertices that the mesh does not have.
    """
    if column not in (None, "value"):
        raise FunctionError(
            f"file {brief(path)}: column {brief(column)} is none of a list of vertices; give "
            "column=value, or none for 1 at its vertices"
        )
    try:
        vertices, values = freesurfer_label(Path(os.path.expanduser(path)))
    except OSError as error:
        raise FunctionError(f"file {brief(path)} cannot be read: {one_line(error)}") from error
    except ValueError as error:
        raise FunctionError(
            f"file {brief(path)} is no list of vertices: {one_line(error)}"
        ) from error
    if vertices.max(initial=0) >= mesh.file_vertex_count:
        raise FunctionError(
            f"file {brief(path)} lists vertex {vertices.max()}, and the mesh has "
            f"{mesh.file_vertex_count}, counted from 0: give the label of this surface"
        )
    found = np.zeros(len(mesh.vertices))
    places = mesh.local_vertices(vertices)
    is_used = places >= 0
    found[places[is_used]] = 1.0 if column is None else values[is_used]
    return found


def _of_gifti(file: Path, column: str | None) -> Labels:
    contents = read_gifti(file)
    arrays = [array for array in contents.arrays if array.intent == LABEL]
    if not arrays:
        raise ValueError(f"none of its {len(contents.arrays)} arrays has the intent {LABEL}")
    if column is None and len(arrays) > 1:
        raise ValueError(f"it has {len(arrays)} columns; choose column=0 to {len(arrays) - 1}")
    names = [array.name for array in arrays]
    if column and column in names:
        values = arrays[names.index(column)].values
    else:
        _check_column(column, len(arrays))
        values = arrays[int(column or 0)].values
    if values.size != len(values):
        raise ValueError(f"an array of keys has shape {values.shape}; expected (n,)")
    with np.errstate(invalid="ignore"):
        keys = values.reshape(-1).astype(np.int64)
    if not np.array_equal(keys, values.reshape(-1)):
        raise ValueError("a key is no whole number")
    return Labels(keys, contents.names, contents.colors)


def _check_column(column: str | None, count: int) -> None:
    number = column or "0"
    if not (len(number) < 10 and number.isdecimal() and int(number) < count):
        raise ValueError(f"its columns are 0 to {count - 1}, none called {brief(number)}")


def _near(label: str, names: Iterable[str]) -> str:
    known = [name for name in names if name]
    shown = ", ".join(one_line(name, 30) for name in known[:_MOST_SHOWN])
    more = ", ..." if len(known) > _MOST_SHOWN else ""
    return did_you_mean(label, known) or (f"; there are {shown}{more}" if known else "")
