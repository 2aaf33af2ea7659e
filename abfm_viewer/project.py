"""Project files (``.abfm``): a zip of JSON and arrays with everything that is needed to go on elsewhere.

``project.json`` holds all that is small; ``mesh/*.npy``, ``result/*.npy`` and ``runs/*/*.npy`` the arrays of the
document, and ``known/*.npy`` the values of functions that come from other files.
"""

from __future__ import annotations

import json
import os
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from abfm import Parameters, ResultError, TriangleMesh
from abfm.io import write_atomically
from abfm.mesh import FloatArray
from abfm_viewer.array_zip import read_array, read_arrays, read_bytes, write_array, write_arrays, write_text
from abfm_viewer.colormaps import NAMES
from abfm_viewer.document import EXTRAPOLATION, Channel, Document, Point, Run, Side, View
from abfm_viewer.plain import from_plain, to_plain

if TYPE_CHECKING:
    from abfm import Match

FORMAT_VERSION = 1
_MOST_DROPPED = 10_000_000  # vertices of the mesh file that no face uses: opening makes room for them again

_MESH = ("vertices", "faces", "vertex_ids")
_RUN = ("energies", "stages")
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


@dataclass(frozen=True)
class _ResultState:
    """The same of `Match`."""

    parameters: Parameters
    mismatch: float
    stop_reason: str
    channels_given: bool


@dataclass(frozen=True)
class _Header:
    """What `project.json` holds; `known` are the functions with values, in the order of their members."""

    file_vertex_count: int
    document: _State
    runs: tuple[_RunState, ...]
    result: _ResultState | None
    result_has_mask: bool
    known: tuple[str, ...]


def terms_from_files(spec: str) -> list[str]:
    """The terms of a function that read files, in their text form: what a project must hold the values of.

    Raises
    ------
    FunctionError
        If the text is no spec.
    """
    from abfm.functions import Spec, Sum, parse  # not before: it takes long
    from abfm.functions.permuted import Permuted
    from abfm.functions.values_file import ValuesFile

    def reads_files(term: Spec) -> bool:
        if isinstance(term, Permuted):
            return not term.is_detected or reads_files(term.function)
        return isinstance(term, ValuesFile) or (isinstance(term, Sum) and any(map(reads_files, term.terms)))

    tree = parse(spec)
    terms = tree.terms if isinstance(tree, Sum) else (tree,)
    return [str(term) for term in terms if reads_files(term)]


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
        result=None if result is None else _part(_ResultState, result),
        result_has_mask=result is not None and result.mask is not None,
        known=tuple(sorted(known)),
    )
    text = json.dumps({"format_version": FORMAT_VERSION, **to_plain(header)}, indent=1)
    try:
        _header(text)
        _check(document, known)
    except ValueError as error:
        raise ProjectError(f"{path} not written: {error}") from error
    with write_atomically(path) as temporary, zipfile.ZipFile(temporary, "w") as archive:
        write_text(archive, "project.json", text)
        write_arrays(archive, "mesh", _MESH, document.mesh)
        for number, run in enumerate(document.runs):
            write_arrays(archive, f"runs/{number}", _RUN, run)
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
            runs=tuple(
                Run(**read_arrays(archive, f"runs/{i}", _RUN), **vars(run)) for i, run in enumerate(header.runs)
            ),
            **vars(header.document),
        )
        known = {spec: read_array(archive, f"known/{number}") for number, spec in enumerate(header.known)}
        _check(document, known)
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
    _require(version == FORMAT_VERSION, f"format_version is {version!r}; expected {FORMAT_VERSION}")
    header: _Header = from_plain(_Header, content, "project")
    return header


def _mesh(archive: zipfile.ZipFile, file_vertex_count: int) -> TriangleMesh:
    """The mesh, with its vertices at the places that they have in the mesh file, so that they keep their numbers."""
    vertices, faces, ids = read_arrays(archive, "mesh", _MESH).values()
    _check_array("mesh/vertex_ids", ids, (ids.size,), "i")
    _check_array("mesh/vertices", vertices, (ids.size, 3), "f")
    _check_array("mesh/faces", faces, (faces.size // 3, 3), "i")
    ascend = len(ids) > 0 and ids[0] >= 0 and bool((np.diff(ids) > 0).all())
    _require(ascend and ids[-1] < file_vertex_count, f"vertex_ids do not ascend from 0 to below {file_vertex_count}")
    _require(file_vertex_count - len(ids) <= _MOST_DROPPED, f"{file_vertex_count} vertices, and {len(ids)} are used")
    _require(bool(((faces >= 0) & (faces < len(ids))).all()), f"mesh/faces has an index outside 0 to {len(ids) - 1}")
    placed = np.full((file_vertex_count, 3), np.nan)
    placed[ids] = vertices
    mesh = TriangleMesh(placed, ids[faces])
    intact = np.array_equal(mesh.vertex_ids, ids) and np.array_equal(mesh.faces, faces)
    _require(intact, f"the mesh needs repairs: {' '.join(mesh.messages)}")
    return mesh


def _result(archive: zipfile.ZipFile, mesh: TriangleMesh, state: _ResultState, has_mask: bool) -> Match:
    from abfm import Match  # not before: it takes long, and is for solved projects only

    mask = read_array(archive, "result/mask") if has_mask else None
    return Match(mesh=mesh, mask=mask, **read_arrays(archive, "result", _RESULT), **vars(state))


def _check(document: Document, known: Mapping[str, FloatArray]) -> None:
    """Refuse a document that does not fit together or could not be drawn."""
    V, F = len(document.mesh.vertices), len(document.mesh.faces)
    for spec, values in known.items():
        _check_array(f"the values of {spec}", values, (V,), "f")
    for number, run in enumerate(document.runs):
        rows = run.stages.size
        _check_array(f"runs/{number}/energies", run.energies, (rows, 3), "f")
        _check_array(f"runs/{number}/stages", run.stages, (rows,), "i")
        _require(all(0 <= row <= rows for row in run.restarts), f"run {number} of {rows} rows restarts outside them")
    if document.result is not None:
        _check_result(document.result, V, F)
    for spec in [spec for channel in document.channels for spec in (channel.source, channel.target)]:
        terms_from_files(spec)
    for channel in document.channels:
        _require(0 <= channel.weight < np.inf, f"a channel has the weight {channel.weight}; expected 0 or more")
    if document.mask:
        terms_from_files(document.mask)
    count, end = max(len(document.channels), 1), EXTRAPOLATION * document.parameters.tau
    _require(0 <= document.channel < count, f"channel is {document.channel}; expected 0 to {count - 1}")
    _require(document.bump >= 0, f"bump is {document.bump}; expected 0 or more")
    _require(0 <= document.time <= end, f"time is {document.time}; expected 0 to {end}")
    for point in document.lines + document.points:
        inside = min(point.barycentric) >= -1e-9 and abs(sum(point.barycentric) - 1) <= 1e-9
        _require(0 <= point.face < F, f"a point lies on face {point.face}; expected 0 to {F - 1}")
        _require(inside, f"a point has weights {point.barycentric}; expected 0 or more, with sum 1")
    view, camera, colormaps = document.view, document.view.camera, ("automatic", *NAMES)
    _require(view.colormap in colormaps, f"colormap is {view.colormap!r}; expected {' or '.join(colormaps)}")
    _require(0 < view.ui_scale <= 10, f"ui_scale is {view.ui_scale}; expected above 0 to 10")
    _require(0 < view.arrow_length <= 10, f"arrow_length is {view.arrow_length}; expected above 0 to 10")
    _require(0 <= view.arrow_density <= 1, f"arrow_density is {view.arrow_density}; expected 0 to 1")
    _require(0 < view.isoline_count <= 1000, f"isoline_count is {view.isoline_count}; expected 1 to 1000")
    if view.front is not None:
        axes = np.array([view.front.direction, view.front.up])
        upright = bool(np.allclose(axes @ axes.T, np.eye(2), atol=1e-6))
        _require(upright, f"front is {view.front}; expected two unit vectors at a right angle")
    if camera is not None:
        _require(camera.position != camera.target, f"the camera looks from {camera.position} at itself")
        _require(0 < camera.angle < 180, f"the camera's angle is {camera.angle}; expected between 0 and 180")


def _check_result(result: Match, V: int, F: int) -> None:
    rows, channels = result.stages.size, result.weights.size
    shapes: dict[str, tuple[int, ...]] = {
        **dict.fromkeys(("source", "target", "advected"), (V, channels)),
        "velocity": (result.parameters.segments, F, 3),
        "energy_history": (rows, 3),
        "weights": (channels,),
        **({} if result.mask is None else {"mask": (V,)}),
    }
    for name, shape in shapes.items():
        _check_array(f"result/{name}", getattr(result, name), shape, "f")
    _check_array("result/stages", result.stages, (rows,), "i")


def _check_array(name: str, array: NDArray[Any], shape: tuple[int, ...], kind: str) -> None:
    numbers = "reals" if kind == "f" else "integers"
    fits = array.shape == shape and array.dtype.kind == kind
    _require(fits, f"{name} is {array.dtype} of shape {array.shape}; expected {numbers} of shape {shape}")
    _require(kind == "i" or bool(np.isfinite(array).all()), f"{name} has values that are not finite")


def _require(fits: bool, problem: str) -> None:
    if not fits:
        raise ValueError(problem)
