"""Exports of meshes with data (PLY, VTU), and of the energy as a table."""

import os
import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pyevtk.hl import unstructuredGridToVTK
from pyevtk.vtk import VtkTriangle

from abfm.errors import ResultError
from abfm.io.atomic import write_atomically, write_file
from abfm.io.tables import write_csv
from abfm.mesh import TriangleMesh
from abfm.numerics.real_numbers import real_numbers

Data = Mapping[str, ArrayLike]
_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_.-]*")


def export_ply(
    path: str | os.PathLike[str], mesh: TriangleMesh, point_data: Data, cell_data: Data
) -> None:
    """Write a binary PLY file with the data as additional properties, all in double precision.

    Programs use the properties differently. trimesh returns all, MeshLab shows point data named
    ``quality``, and ParaView ignores them (use `export_vtu`). An array of C columns becomes the
    properties ``name_0`` to ``name_{C-1}``.

    Parameters
    ----------
    point_data : mapping of names to (V,) or (V, C) arrays
    cell_data : mapping of names to (F,) or (F, C) arrays

    Raises
    ------
    ResultError
        If a name or a shape does not fit, or the file cannot be written.
    """
    positions = dict(zip("xyz", mesh.vertices.T, strict=True))
    vertex = positions | _columns(point_data, len(mesh.vertices), reserved=list(positions))
    face = _columns(cell_data, len(mesh.faces), reserved=["vertex_indices"])
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"element vertex {len(mesh.vertices)}",
        *(f"property double {name}" for name in vertex),
        f"element face {len(mesh.faces)}",
        "property list uchar int vertex_indices",
        *(f"property double {name}" for name in face),
        "end_header\n",
    ]
    count, corners = np.full(len(mesh.faces), 3, dtype="u1"), mesh.faces.astype("<i4")
    body = _records(vertex) + _records({"count": count, "vertex_indices": corners} | face)
    write_file(path, "\n".join(header).encode("ascii") + body)


def export_vtu(
    path: str | os.PathLike[str], mesh: TriangleMesh, point_data: Data, cell_data: Data
) -> None:
    """Write a binary VTK unstructured grid with point and cell data in double precision.

    Bytes (uint8) keep their type. ParaView, VTK and PyVista can read the file; its name must end
    with ``.vtu``. An array of three columns becomes a vector. Other parameters and errors are those
    of `export_ply`.
    """
    if not str(path).endswith(".vtu"):
        raise ResultError(
            f"cannot write {path}: the name of a VTK unstructured grid must end with .vtu"
        )
    points = _columns(point_data, len(mesh.vertices), vectors=True)
    cells = _columns(cell_data, len(mesh.faces), vectors=True)
    with write_atomically(path) as temporary:
        unstructuredGridToVTK(
            str(temporary).removesuffix(".vtu"),  # pyevtk appends the suffix
            *np.ascontiguousarray(mesh.vertices.T),
            connectivity=mesh.faces.ravel(),
            offsets=3 * np.arange(1, len(mesh.faces) + 1),
            cell_types=np.full(len(mesh.faces), VtkTriangle.tid, dtype=np.uint8),
            pointData=points,
            cellData=cells,
        )


def export_energy_csv(
    path: str | os.PathLike[str], energy_history: ArrayLike, stages: ArrayLike
) -> None:
    """Write a .csv with a line for each iteration: its number, its stage and its energies.

    The energies are in solver units. Raises ResultError if the file cannot be written.

    Parameters
    ----------
    energy_history : (I, 3) array
        Total energy, regularity and mismatch of each iterate.
    stages : (I,) array of int
        Stage of the continuation of each iterate.
    """
    rows = zip(np.asarray(stages).tolist(), np.asarray(energy_history).tolist(), strict=True)
    numbered = ([number, stage, *energies] for number, (stage, energies) in enumerate(rows))
    write_csv(path, [["iteration", "stage", "total", "regularity", "mismatch"], *numbered])


def _columns(
    data: Data, count: int, reserved: Sequence[str] = (), vectors: bool = False
) -> dict[str, Any]:
    """Return the columns of data arrays by name, each (count,) as float64.

    If ``vectors``, an array of three columns becomes a tuple, and bytes (uint8) keep their type.
    Raises ResultError for a wrong shape, and for a name that is invalid, repeated or ``reserved``.
    """
    columns: dict[str, Any] = {}
    for name, array in data.items():
        values = real_numbers(array, f"data {name!r}", ResultError)
        if values.ndim not in (1, 2) or len(values) != count or values.size == 0:
            raise ResultError(
                f"data {name!r} has shape {values.shape}; expected ({count},) or ({count}, C)"
            )
        split = np.ascontiguousarray(values.reshape(count, -1).T)
        if vectors and np.asarray(array).dtype == np.uint8:
            split = split.astype(np.uint8)
        named: dict[str, Any] = {f"{name}_{k}": column for k, column in enumerate(split)}
        if values.ndim == 1 or (vectors and len(split) == 3):
            named = {name: split[0] if values.ndim == 1 else tuple(split)}
        for new in named:
            if not _NAME.fullmatch(new) or new in columns or new in reserved:
                raise ResultError(
                    f"the name {new!r} of data is invalid or already used. Use another name of "
                    "letters, digits and _ . -"
                )
        columns |= named
    return columns


def _records(columns: Mapping[str, NDArray[Any]]) -> bytes:
    """Return packed little-endian records of columns (n,) or (n, k) as bytes."""
    little = [(name, x.dtype.newbyteorder("<"), x.shape[1:]) for name, x in columns.items()]
    return np.rec.fromarrays(list(columns.values()), little).tobytes()
