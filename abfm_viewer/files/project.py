"""Project files (``.abfm``): a zip of JSON and arrays with everything that is needed to go on elsewhere.

``project.json`` holds all that is small; ``mesh/*.npy``, ``result/*.npy`` and ``runs/*/*.npy`` the arrays of the
document, and ``known/*.npy`` the values of functions that come from other files.
"""

from __future__ import annotations

import json
import math
import os
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, Literal, TypeVar

import numpy as np

from abfm import Parameters, ResultError, TriangleMesh
from abfm.io import write_atomically
from abfm.types import FloatArray
from abfm_viewer.document.document import Channel, Document, Point, Run, Side, View
from abfm_viewer.files.array_zip import read_array, read_arrays, read_bytes, write_array, write_arrays, write_text
from abfm_viewer.files.plain import from_plain, to_plain
from abfm_viewer.files.project_checks import check, check_array, require, terms_from_files

if TYPE_CHECKING:
    from abfm import Match

__all__ = ["FORMAT_VERSION", "ProjectError", "load_project", "save_project", "terms_from_files"]

FORMAT_VERSION = 1
_MOST_DROPPED = 10_000_000  # vertices of the mesh file that no face uses: opening makes room for them again

_MESH = ("vertices", "faces", "vertex_ids")
_RUN, _COURSE = ("energies", "stages"), ("vertices", "reaches")
_RESULT = ("source", "target", "velocity", "advected", "energy_history", "stages", "weights")

Plain = TypeVar("Plain")


class ProjectError(ResultError):
    """A project file that cannot be written or read."""


@dataclass(frozen=True)
class _State:
    """The fields of `Document` that hold no arrays, by the same names."""

    name: str
    channels: tuple[Channel, ...]
    channel: int
    side: Side
    bump: int
    parameters: Parameters
    mask: str
    time: float
    lines: tuple[Point, ...]
    points: tuple[Point, ...]
    view: View


@dataclass(frozen=True)
class _RunState:
    """The same of `Run`."""

    restarts: tuple[int, ...]
    mismatch: float
    label: str
    has_course: bool = False


@dataclass(frozen=True)
class _VerdictState:
    """The same of `Verdict`."""

    kind: Literal["matched", "nearly", "not reached", "impossible"]
    reason: str
    advice: str


@dataclass(frozen=True)
class _ResultState:
    """The same of `Match`; None is what is not known, and what older versions did not tell."""

    parameters: Parameters
    mismatch: float
    stop_reason: str
    channels_given: bool
    verified_mismatch: float | None = None
    folded: float | None = None
    verdict: _VerdictState | None = None


@dataclass(frozen=True)
class _Header:
    """What `project.json` holds; `known` are the functions with values, in the order of their members."""

    file_vertex_count: int
    document: _State
    runs: tuple[_RunState, ...]
    result: _ResultState | None
    result_has_mask: bool
    known: tuple[str, ...]


def save_project(path: str | os.PathLike[str], document: Document, known: Mapping[str, FloatArray]) -> None:
    """Write a project, whole or not at all. The same document gives the same bytes.

    Parameters
    ----------
    path
        Usually ends in ``.abfm``.
    document : Document
    known : mapping of str to (V,) array
        Values of the terms that `terms_from_files` names.

    Raises
    ------
    ResultError
        If it would not open again, or cannot be written.
    """
    result = document.result
    header = _Header(
        file_vertex_count=document.mesh.file_vertex_count,
        document=_part(_State, document),
        runs=tuple(_part(_RunState, run) for run in document.runs),
        result=None if result is None else _result_state(result),
        result_has_mask=result is not None and result.mask is not None,
        known=tuple(sorted(known)),
    )
    text = json.dumps({"format_version": FORMAT_VERSION, **to_plain(header)}, indent=1)
    try:
        _header(text)
        check(document, known)
    except ValueError as error:
        raise ProjectError(f"{path} not written: {error}") from error
    with write_atomically(path) as temporary, zipfile.ZipFile(temporary, "w") as archive:
        write_text(archive, "project.json", text)
        write_arrays(archive, "mesh", _MESH, document.mesh)
        for number, run in enumerate(document.runs):
            write_arrays(archive, f"runs/{number}", (*_RUN, *_COURSE) if run.has_course else _RUN, run)
        if result is not None:
            write_arrays(archive, "result", _RESULT if result.mask is None else (*_RESULT, "mask"), result)
        for number, spec in enumerate(header.known):
            write_array(archive, f"known/{number}", known[spec])


def load_project(path: str | os.PathLike[str]) -> tuple[Document, dict[str, FloatArray]]:
    """Read a project: the document, and the values of its terms that came from other files.

    Raises
    ------
    ProjectError
        If the file is missing, damaged, no project, or from a newer version.
    """
    with _explained(path), zipfile.ZipFile(path) as archive:
        if "velocity.npy" in archive.namelist():
            raise ProjectError("a result file, not a project; open it as a result, under a name that ends in .npz")
        header = _header(read_bytes(archive, "project.json"))
        mesh = _mesh(archive, header.file_vertex_count)
        document = Document(
            mesh=mesh,
            result=None if header.result is None else _result(archive, mesh, header.result, header.result_has_mask),
            runs=tuple(_run(archive, number, run) for number, run in enumerate(header.runs)),
            **vars(header.document),
        )
        known = {spec: read_array(archive, f"known/{number}") for number, spec in enumerate(header.known)}
        check(document, known)
        return document, known


@contextmanager
def _explained(path: str | os.PathLike[str]) -> Iterator[None]:
    """Turn whatever damage does into one line that names the file."""
    try:
        yield
    except ProjectError as error:
        raise ProjectError(f"{path}: {error}") from error
    except OSError as error:
        reason = error.strerror or error
        raise ProjectError(f"cannot read {path}: {reason}; check the path and its permissions") from error
    except (ValueError, KeyError, EOFError, RuntimeError, OverflowError, zipfile.BadZipFile) as error:
        reason = " ".join(str(error).split())
        raise ProjectError(
            f"{path}: no project of abfm, or damaged ({reason}); take another copy of the file"
        ) from error


def _part(kind: type[Plain], whole: object) -> Plain:
    """The fields of a dataclass, taken from something that has them too."""
    return kind(**{entry.name: getattr(whole, entry.name) for entry in fields(kind)})  # type: ignore[arg-type]


def _header(text: str | bytes) -> _Header:
    content = json.loads(text)
    version = content.pop("format_version", None) if isinstance(content, dict) else None
    if isinstance(version, int) and version > FORMAT_VERSION:
        raise ProjectError(f"written in format {version}, and this abfm reads up to {FORMAT_VERSION}; upgrade abfm")
    require(version == FORMAT_VERSION, f"format_version is {version!r}; expected {FORMAT_VERSION}")
    header: _Header = from_plain(_Header, content, "project")
    return header


def _mesh(archive: zipfile.ZipFile, file_vertex_count: int) -> TriangleMesh:
    """The mesh, with its vertices at the places that they have in the mesh file, so that they keep their numbers."""
    vertices, faces, ids = read_arrays(archive, "mesh", _MESH).values()
    check_array("mesh/vertex_ids", ids, (ids.size,), "i")
    check_array("mesh/vertices", vertices, (ids.size, 3), "f")
    check_array("mesh/faces", faces, (faces.size // 3, 3), "i")
    ascend = len(ids) > 0 and ids[0] >= 0 and bool((np.diff(ids) > 0).all())
    require(ascend and ids[-1] < file_vertex_count, f"vertex_ids do not ascend from 0 to below {file_vertex_count}")
    require(file_vertex_count - len(ids) <= _MOST_DROPPED, f"{file_vertex_count} vertices, and {len(ids)} are used")
    require(bool(((faces >= 0) & (faces < len(ids))).all()), f"mesh/faces has an index outside 0 to {len(ids) - 1}")
    placed = np.full((file_vertex_count, 3), np.nan)
    placed[ids] = vertices
    mesh = TriangleMesh(placed, ids[faces])
    intact = np.array_equal(mesh.vertex_ids, ids) and np.array_equal(mesh.faces, faces)
    require(intact, f"the mesh needs repairs: {' '.join(mesh.messages)}")
    return mesh


def _run(archive: zipfile.ZipFile, number: int, state: _RunState) -> Run:
    names = (*_RUN, *_COURSE) if state.has_course else _RUN
    arrays = read_arrays(archive, f"runs/{number}", names)
    return Run(**arrays, restarts=state.restarts, mismatch=state.mismatch, label=state.label)


def _result_state(result: Match) -> _ResultState:
    def known(value: float) -> float | None:
        return None if math.isnan(value) else value

    state = _part(_ResultState, result)
    return replace(
        state,
        verified_mismatch=known(result.verified_mismatch),
        folded=known(result.folded),
        verdict=_part(_VerdictState, result.verdict),
    )


def _result(archive: zipfile.ZipFile, mesh: TriangleMesh, state: _ResultState, has_mask: bool) -> Match:
    from abfm import Match  # not before: these take long, and are for solved projects only
    from abfm.matching.judging.verdict import Verdict
    from abfm.matching.result import former_verdict

    told = state.verdict
    state_of_match: dict[str, Any] = {
        **vars(state),
        "verified_mismatch": math.nan if state.verified_mismatch is None else state.verified_mismatch,
        "folded": math.nan if state.folded is None else state.folded,
        "verdict": Verdict(**vars(told)) if told else former_verdict(state.mismatch, state.stop_reason),
    }
    mask = read_array(archive, "result/mask") if has_mask else None
    return Match(mesh=mesh, mask=mask, **read_arrays(archive, "result", _RESULT), **state_of_match)
