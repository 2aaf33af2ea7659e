"""Labels of vertices from files that number vertices like the mesh file."""

import os
from collections.abc import Iterable

from abfm.errors import brief, did_you_mean, one_line
from abfm.functions.value_files import columns_of, file_errors, request_for
from abfm.mesh import TriangleMesh
from abfm.reading import Columns, Format, Labels, open_file
from abfm.types import BoolArray

__all__ = ["Labels", "has_label", "read_label_columns", "read_labels"]

_INTEGER_FORMATS = (Format.TABLE, Format.NPY, Format.NPZ, Format.MAT, Format.MGH)
_SHOWN_NAMES_MAX = 8


def read_labels(
    path: str | os.PathLike[str],
    column: str | None = None,
    mesh: TriangleMesh | None = None,
    hemisphere: str = "",
) -> Labels:
    """Read the label of each vertex: an integer key, with the names and colours of all keys.

    Files of labels may be .annot, .dlabel.nii or GIFTI. A GIFTI file has arrays of labels, a name
    that ends with .label.gii, or names for integer values. Files of integers (.csv, .txt, .npy,
    .npz, .mat, .mgh) are also accepted.

    Parameters
    ----------
    path : path
    column : str, optional
        Name or number of one of several columns, counted from 0.
    mesh : TriangleMesh, optional
        The mesh whose vertices get the labels, as in `read_values`. Vertices without a label have
        the key -1.
    hemisphere : str
        Hemisphere, "L" or "R", in a file with both.

    Raises
    ------
    FunctionError
        If the file cannot be read, has no labels, or does not fit the mesh.
    """
    found = read_label_columns(path, mesh, column, hemisphere)
    with file_errors(path):
        return found.labels(column)


def read_label_columns(
    path: str | os.PathLike[str],
    mesh: TriangleMesh | None = None,
    column: str | None = None,
    hemisphere: str = "",
) -> Columns:
    """Read all columns of labels from a file, see `read_labels`."""
    with file_errors(path):
        opened = open_file(path)
        found = columns_of(opened, request_for(mesh, column, hemisphere))
        if opened.format is Format.LABEL_LIST:
            raise ValueError(
                "a .label file lists the vertices of one label; expected a file with a label for "
                "each vertex. Use it as a function, file:NAME, which is 1 at these vertices"
            )
        if opened.format not in _INTEGER_FORMATS:
            found = found.of_labels()
        if mesh is not None:
            return found.on(mesh)
        found = found.by_vertex()
        if found.vertices is not None:
            raise ValueError("only some vertices have labels. Use the mesh as an argument as well")
        return found


def has_label(
    path: str, label: str, mesh: TriangleMesh, column: str | None = None, hemisphere: str = ""
) -> BoolArray:
    """Return a mask (V,) of the vertices with a label, its name or key, in a file.

    Raises FunctionError if the file does not have the label.
    """
    labels = read_labels(path, column, mesh, hemisphere)
    with file_errors(path):
        try:
            return labels.where(label)
        except KeyError:
            alternatives = _alternatives(label, labels.names.values())
            raise ValueError(f"the file has no label {brief(label)}{alternatives}") from None


def _alternatives(label: str, names: Iterable[str]) -> str:
    valid_names = [name for name in names if name]
    shown = ", ".join(one_line(name, 30) for name in valid_names[:_SHOWN_NAMES_MAX])
    more = ", ..." if len(valid_names) > _SHOWN_NAMES_MAX else ""
    listed = f"; its labels are {shown}{more}" if valid_names else ""
    return did_you_mean(label, valid_names) or listed
