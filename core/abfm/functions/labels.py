"""Labels of vertices read from files that count as the mesh file does, and the place of a label."""

import os
from collections.abc import Iterable

from abfm.errors import brief, did_you_mean, one_line
from abfm.functions.value_files import columns_of, reported, request_for
from abfm.mesh import TriangleMesh
from abfm.reading import Columns, Format, Labels, open_file
from abfm.types import BoolArray

__all__ = ["Labels", "read_label_columns", "read_labels", "where_label"]

_WHOLE_NUMBERS = (Format.TABLE, Format.NPY, Format.NPZ, Format.MAT, Format.MGH)
_SHOWN_NAMES_MAX = 8


def read_labels(
    path: str | os.PathLike[str],
    column: str | None = None,
    mesh: TriangleMesh | None = None,
    hemisphere: str = "",
) -> Labels:
    """Read one key per vertex with the names and colours of the keys.

    GIFTI files hold labels if their arrays, their names (.label.gii) or names for whole values say
    so; .annot and .dlabel.nii files do, and tables, .npy, .npz, .mat and .mgh of whole numbers.

    Parameters
    ----------
    path : path
    column : str, optional
        One of several columns, by its name or number, counted from 0.
    mesh : TriangleMesh, optional
        The mesh whose vertices get the labels, as in `read_values`; those without one get the key
        -1.
    hemisphere : str
        "L" or "R", of files that hold both.

    Raises
    ------
    FunctionError
        If the file cannot be read, holds no labels, or does not fit the mesh.
    """
    found = read_label_columns(path, mesh, column, hemisphere)
    with reported(path):
        return found.labels(column)


def read_label_columns(
    path: str | os.PathLike[str],
    mesh: TriangleMesh | None = None,
    column: str | None = None,
    hemisphere: str = "",
) -> Columns:
    """Read all columns of labels from a file; see `read_labels`."""
    with reported(path):
        opened = open_file(path)
        found = columns_of(opened, request_for(mesh, column, hemisphere))
        if opened.format is Format.LABEL_LIST:
            raise ValueError(
                "it holds no labels, but lists the vertices of one: use it as file:, a function "
                "that is 1 there"
            )
        if opened.format not in _WHOLE_NUMBERS:
            found = found.of_labels()
        if mesh is not None:
            return found.on(mesh)
        found = found.by_vertex()
        if found.vertices is not None:
            raise ValueError("it holds labels of some vertices only: give the mesh, too")
        return found


def where_label(
    path: str, label: str, mesh: TriangleMesh, column: str | None = None, hemisphere: str = ""
) -> BoolArray:
    """Return which vertices, (V,), have a label of a file, given by its name or its key.

    A FunctionError reports that there is none, or why the file cannot be read.
    """
    labels = read_labels(path, column, mesh, hemisphere)
    with reported(path):
        try:
            return labels.where(label)
        except KeyError:
            near = _near(label, labels.names.values())
            raise ValueError(f"it has no label {brief(label)}{near}") from None


def _near(label: str, names: Iterable[str]) -> str:
    known = [name for name in names if name]
    shown = ", ".join(one_line(name, 30) for name in known[:_SHOWN_NAMES_MAX])
    more = ", ..." if len(known) > _SHOWN_NAMES_MAX else ""
    return did_you_mean(label, known) or (f"; there are {shown}{more}" if known else "")
