"""Result files: one ``.npz`` of plain arrays, no pickles, checked whole when written and when
read.
"""

import json
import os
import zipfile
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from abfm.errors import ResultError, brief, one_line
from abfm.io.arrays import (
    FORMAT_VERSION,
    Entry,
    check_arrays,
    check_version,
    open_archive,
    write_arrays,
)
from abfm.io.atomic import write_atomically
from abfm.mesh import TriangleMesh

MEND = "match again and save, or take another copy of the file"
LARGEST = 1e154
"""Of functions and, in lengths of the mesh, of fields: squares of more overflow, so no match was
made of them.
"""
# vertices of the mesh file that no face uses: maps to its vertices have a line for each
_MOST_DROPPED = 10_000_000

MESH_ENTRIES = {
    "vertices": Entry("real", ("V", 3)),
    "faces": Entry("integer", ("F", 3)),
    "vertex_ids": Entry("integer", ("V",)),
    "file_vertex_count": Entry("integer", (), low=1),
}
_FUNCTION = Entry("real", ("V", "C"), low=-LARGEST, high=LARGEST)
_FUNCTIONS = {"source": _FUNCTION, "target": _FUNCTION}
_DATA = {
    "parameters": Entry("text", ()),
    "channels_given": Entry("boolean", ()),  # False: f and g were (V,), and come back so
    "mask": Entry("real", ("V",), required=False, low=0),
    # the last one is required: damage to a zip's directory can hide the last entry
    "weights": Entry("real", ("C",), low=0),
}
_START = {"start": Entry("real", ("M", "F", 3), required=False)}
PROBLEM_ENTRIES = MESH_ENTRIES | _FUNCTIONS | _START | _DATA
_MATCH = {
    "advected": _FUNCTION,
    "velocity": Entry("real", ("N", "F", 3)),
    "energy_history": Entry("real", ("I", 3)),
    "stages": Entry("integer", ("I",), low=0),
    "mismatch": Entry("real", (), low=0),
    "stop_reason": Entry("text", ()),
    "verified_mismatch": Entry("real", (), required=False, low=0),
    "folded": Entry("real", (), required=False, low=0, high=1),
    "verdict": Entry("text", (3,), required=False),
    "remedies": Entry("text", (), required=False),
}
MATCH_ENTRIES = _FUNCTIONS | _MATCH | _DATA
ENTRIES = MESH_ENTRIES | MATCH_ENTRIES


class Kind(NamedTuple):
    """What a file is called, and which arrays it holds."""

    name: str
    entries: Mapping[str, Entry]


RESULT, PROBLEM = Kind("result file", ENTRIES), Kind("problem file", PROBLEM_ENTRIES)


def save_arrays(
    path: str | os.PathLike[str], arrays: Mapping[str, Any], kind: Kind = RESULT
) -> None:
    """Write a file with the arrays of its kind and ``format_version``.

    The same arrays give the same bytes.

    Raises
    ------
    ResultError
        If the arrays would not load again, or the file cannot be written.
    """
    unknown = sorted(arrays.keys() - kind.entries.keys())
    if unknown:
        raise ResultError(
            f"{path}: no place for {', '.join(unknown)} in a {kind.name}; expected "
            f"{', '.join(kind.entries)}"
        )
    try:
        checked = _checked(arrays, kind.entries)
    except ValueError as error:
        raise ResultError(
            f"{one_line(path)} not written: {one_line(error, 400)}; {MEND}"
        ) from error
    with write_atomically(path) as temporary, zipfile.ZipFile(temporary, "w") as archive:
        write_arrays(archive, {"format_version": np.array(FORMAT_VERSION), **checked})


def load_arrays(path: str | os.PathLike[str], kind: Kind = RESULT) -> dict[str, NDArray[Any]]:
    """Read such a file: the arrays of its kind, with the shapes and kinds given there.

    Arrays that this version does not know are left out. Reals come as float64, integers as int64,
    text as unicode.

    Raises
    ------
    ResultError
        If the file is missing, damaged, no result, or from a newer version, or if an array is
        missing, has the wrong shape or kind, or holds values that make no sense.
    """
    with open_archive(path, kind.name, MEND) as archive:
        version = archive.get("format_version")
        check_version(version.item() if version is not None and version.ndim == 0 else version)
        return _checked(archive, kind.entries)


def _checked(arrays: Mapping[str, Any], entries: Mapping[str, Entry]) -> dict[str, NDArray[Any]]:
    checked = check_arrays(arrays, entries)
    _check_indices(checked)
    _check_parameters(str(checked["parameters"]))
    return checked


def mesh_arrays(mesh: TriangleMesh) -> dict[str, Any]:
    """Return what files hold of a mesh."""
    return {name: getattr(mesh, name) for name in MESH_ENTRIES}


def mesh_of(arrays: Mapping[str, NDArray[Any]]) -> TriangleMesh:
    """Return the mesh that `mesh_arrays` was given: its vertices keep the numbers that they have in
    the mesh file.

    Raises
    ------
    ValueError
        If an index is out of range, or the mesh needs repairs.
    """
    _check_indices(arrays)
    ids, faces, count = arrays["vertex_ids"], arrays["faces"], int(arrays["file_vertex_count"])
    if count - len(ids) > _MOST_DROPPED:
        raise ValueError(f"the mesh file had {count} vertices, and {len(ids)} are used")
    mesh = TriangleMesh(arrays["vertices"], faces, numbers=(ids, count))
    if not (np.array_equal(mesh.vertex_ids, ids) and np.array_equal(mesh.faces, faces)):
        raise ValueError(f"the mesh needs repairs: {' '.join(mesh.messages)}")
    return mesh


def _check_indices(arrays: Mapping[str, NDArray[Any]]) -> None:
    for name, limit in (
        ("faces", len(arrays["vertices"])),
        ("vertex_ids", int(arrays["file_vertex_count"])),
    ):
        if arrays[name].min() < 0 or arrays[name].max() >= limit:
            raise ValueError(f"{name} has an index outside 0 to {limit - 1}")
    if (np.diff(arrays["vertex_ids"]) <= 0).any():
        raise ValueError("vertex_ids do not ascend")
    unused = np.count_nonzero(
        np.bincount(arrays["faces"].ravel(), minlength=len(arrays["vertices"])) == 0
    )
    if unused:
        raise ValueError(
            f"the mesh needs repairs: {unused} of its {len(arrays['vertices'])} vertices are in "
            "no face"
        )


def _check_parameters(text: str) -> None:
    try:
        # so that no integer is too large for the test of tau
        parameters = json.loads(text, parse_int=float)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"parameters are not JSON: {error}") from error
    if not isinstance(parameters, dict) or any(
        isinstance(value, dict) for value in parameters.values()
    ):
        raise ValueError("parameters are not one flat JSON object")
    tau = parameters.get("tau")
    if not isinstance(tau, float) or not np.isfinite(tau):
        raise ValueError(f"parameters give tau = {brief(tau)}; expected a finite number")
