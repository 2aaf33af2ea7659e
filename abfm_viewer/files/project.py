"""Project files (``.abfm``): a zip of JSON and arrays with everything that is needed to go on
elsewhere.

``project.json`` holds all that is small; ``mesh/*.npy``, ``result/*.npy`` and ``runs/*/*.npy`` the
arrays of the document, and ``known/*.npy`` the values of functions that come from other files.
Those of mesh and result are what result files hold.
"""

from __future__ import annotations

import json
import os
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, cast

import numpy as np

import abfm
from abfm import Parameters, ResultError, TriangleMesh
from abfm.errors import one_line
from abfm.io import write_atomically
from abfm.io.arrays import Entry, check_arrays, check_version, open_archive, write_arrays
from abfm.io.results import MATCH_ENTRIES, MESH_ENTRIES, mesh_arrays, mesh_of
from abfm.reading import from_json
from abfm.types import FloatArray
from abfm_viewer.document.document import Document, Identity, Run, Surface
from abfm_viewer.files.origin import MEMBER, Origin
from abfm_viewer.files.plain import from_plain, to_plain
from abfm_viewer.files.project_checks import check

_FORMAT = 2
_LARGEST_HEADER = 2 << 20  # bytes of `project.json`
_MESH = {name: MESH_ENTRIES[name] for name in ("vertex_ids", "vertices", "faces")}
_RUN = {
    "stages": Entry("integer", ("n",), may_be_empty=True, low=0),
    "energies": Entry("real", ("n", 3), may_be_empty=True),
}
_COURSE = _RUN | {
    "vertices": Entry("integer", ("n",), low=0),
    "reaches": Entry("real", ("n",), low=0),
}
_RESULT = {
    name: entry
    for name, entry in MATCH_ENTRIES.items()
    if name not in ("parameters", "verdict", "remedies")
}


@dataclass(frozen=True)
class _Header:
    """What `project.json` holds; `known` are functions with values, as their members count."""

    file_vertex_count: int
    document: dict[str, Any]
    runs: tuple[dict[str, Any], ...]
    result: dict[str, Any] | None
    result_has_mask: bool
    known: tuple[str, ...]


def save_project(
    path: str | os.PathLike[str],
    document: Document,
    known: Mapping[str, FloatArray],
    origin: Origin | None = None,
) -> None:
    """Write a project, whole or not at all. The same document gives the same bytes.

    Known are the values (V,) of the terms that `terms_from_files` names. A copy of unsaved work
    says of which project file it is one, for `load_origin`.

    Raises
    ------
    ResultError
        If it would not open again, or cannot be written.
    """
    surface = document.surface()
    mesh = mesh_arrays(surface.mesh)
    arrays = {f"mesh/{name}": mesh[name] for name in _MESH}
    for number, run in enumerate(document.runs):
        names = _COURSE if run.has_course else _RUN
        arrays |= {f"runs/{number}/{name}": getattr(run, name) for name in names}
    plain_result = None
    if document.result is not None:
        plain_result, own = _plain_result(document.result)
        arrays |= {f"result/{name}": part for name, part in own.items()}
    content = {
        "file_vertex_count": surface.mesh.file_vertex_count,
        "document": _plain_document(document),
        "runs": [
            to_plain(run, tuple(_COURSE)) | {"has_course": run.has_course} for run in document.runs
        ],
        "result": plain_result,
        "result_has_mask": "result/mask" in arrays,
        "known": sorted(known),
    }
    arrays |= {f"known/{number}": known[spec] for number, spec in enumerate(sorted(known))}
    try:
        text = json.dumps({"format_version": _FORMAT, **content}, indent=1)
        if len(text) > _LARGEST_HEADER:
            raise ValueError(
                f"it has {len(text)} bytes besides its arrays, and at most {_LARGEST_HEADER} can "
                "be read"
            )
        _document(content, arrays, surface.mesh)
    except ValueError as error:
        raise ResultError(f"{one_line(path)} not written: {one_line(error, 400)}") from error
    with write_atomically(path) as temporary, zipfile.ZipFile(temporary, "w") as archive:
        archive.writestr(zipfile.ZipInfo("project.json"), text)
        if origin is not None:
            archive.writestr(zipfile.ZipInfo(MEMBER), origin.to_json())
        write_arrays(archive, arrays)


def load_project(path: str | os.PathLike[str]) -> tuple[Document, dict[str, FloatArray]]:
    """Read a project: the document, and the values of its terms that came from other files.

    Raises
    ------
    ResultError
        If the file is missing, damaged, no project, or from a newer version.
    """
    with open_archive(path, "project", "take another copy of the file") as archive:
        if "velocity" in archive:
            raise ResultError(
                "a result file, not a project; open it as a result, under a name that ends in .npz"
            )
        if archive.packed:
            raise ValueError(
                f"{archive.packed[0]} is compressed; expected a zip without compression"
            )
        content = from_json(archive.read("project.json", _LARGEST_HEADER))
        check_version(
            content.pop("format_version", None) if isinstance(content, dict) else None, _FORMAT
        )
        return _document(content, archive)


def _plain_result(result: abfm.Match) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return what of a result goes into `project.json`, and its arrays."""
    parts = abfm.matching.match_arrays(result)
    arrays = {name: part for name, part in parts.items() if isinstance(part, np.ndarray)}
    plain = {name: part for name, part in parts.items() if name not in arrays}
    plain.pop("remedies", None)  # they are the verdict's
    values = {"parameters": result.parameters, "verdict": result.verdict}
    return plain | {name: to_plain(value) for name, value in values.items()}, arrays


def _plain_document(document: Document) -> dict[str, Any]:
    """Return what of a document is neither an array nor another part of the file.

    The surface's name is the document's there, and its front the view's.
    """
    plain: dict[str, Any] = to_plain(document, ("identity", "surfaces", "result", "runs"))
    surface = document.surface()
    plain["view"]["front"] = to_plain(surface.front)
    return {"name": surface.name} | plain


def _document(
    content: object, arrays: Mapping[str, Any], mesh: TriangleMesh | None = None
) -> tuple[Document, dict[str, FloatArray]]:
    """Document and known values from what a file holds; the mesh is made unless it is given."""
    header: _Header = from_plain(_Header, content, "project")
    mesh_parts = check_arrays(arrays, _MESH, "mesh/")
    mesh = mesh or mesh_of({**mesh_parts, "file_vertex_count": np.array(header.file_vertex_count)})
    runs = tuple(_run(number, state, arrays) for number, state in enumerate(header.runs))
    result = None
    if header.result is not None:
        result = _result(header.result, header.result_has_mask, arrays, mesh)
    surface, plain = _surface(header.document, mesh)
    given = {"surfaces": (surface,), "result": result, "runs": runs, "identity": Identity()}
    document = from_plain(Document, plain, "project.document", **given)
    values = {
        f"the values of {spec}": arrays[f"known/{number}"]
        for number, spec in enumerate(header.known)
    }
    entries = dict.fromkeys(header.known, Entry("real", ("V",)))
    known = check_arrays(values, entries, "the values of ", V=len(mesh.vertices))
    check(document)
    return document, known


def _surface(document: dict[str, Any], mesh: TriangleMesh) -> tuple[Surface, dict[str, Any]]:
    """The surface of a document as `_plain_document` gives it, and the rest of that."""
    view = document.get("view")
    known = view if isinstance(view, dict) else {}
    plain = {"name": document.get("name"), "front": known.get("front")}
    surface: Surface = from_plain(Surface, plain, "project.document", mesh=mesh)
    rest = {name: value for name, value in document.items() if name != "name"}
    if known:
        rest["view"] = {name: value for name, value in known.items() if name != "front"}
    return surface, rest


def _run(number: int, state: dict[str, Any], arrays: Mapping[str, Any]) -> Run:
    plain = {name: value for name, value in state.items() if name != "has_course"}
    parts = check_arrays(arrays, _COURSE if state.get("has_course") else _RUN, f"runs/{number}/")
    return cast(Run, from_plain(Run, plain, f"project.runs[{number}]", **parts))


def _result(
    state: dict[str, Any], has_mask: bool, arrays: Mapping[str, Any], mesh: TriangleMesh
) -> abfm.Match:
    known = {name: value for name, value in state.items() if value is not None}
    entries = _RESULT | {"mask": _RESULT["mask"]._replace(required=has_mask)}
    given = {place: arrays[place] for name in entries if (place := f"result/{name}") in arrays}
    given |= {f"result/{name}": value for name, value in known.items()}
    parts = check_arrays(given, entries, "result/", V=len(mesh.vertices), F=len(mesh.faces))
    parameters = from_plain(Parameters, known.get("parameters"), "project.result.parameters")
    verdict = from_plain(
        abfm.matching.Verdict | None, known.get("verdict"), "project.result.verdict"
    )
    return abfm.matching.match_of(mesh, parts, parameters, verdict)
