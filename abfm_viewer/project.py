"""Project files (``.abfm``): a zip of JSON and arrays with everything that is needed to go on elsewhere.

``project.json`` holds all that is small; ``mesh/*.npy`` the mesh, ``runs/*.npy`` the energies of earlier runs,
``known/*.npy`` values of functions that come from other files, and ``result.npz`` the result as a file of its own.
"""

from __future__ import annotations

import json
import os
import tempfile
import zipfile
import zlib
from collections.abc import Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from abfm import AbfmError, Parameters, ResultError, TriangleMesh
from abfm.io import write_atomically
from abfm.mesh import FloatArray
from abfm_viewer.document import EXTRAPOLATION, Channel, Document, Point, Run, Side, View
from abfm_viewer.plain import PlainError, from_plain, to_plain

if TYPE_CHECKING:
    from collections.abc import Iterator

    from abfm import Match

FORMAT_VERSION = 1
_EPOCH = (1980, 1, 1, 0, 0, 0)  # the same document gives the same bytes
_MESH = ("vertices", "faces", "vertex_ids")


class ProjectError(ResultError):
    """A project file that cannot be written or read."""


@dataclass(frozen=True)
class _RunHeader:
    restarts: tuple[int, ...]
    mismatch: float
    label: str


@dataclass(frozen=True)
class _Header:
    """What `project.json` holds, apart from the format and the parameters."""

    name: str
    file_vertex_count: int
    channels: tuple[Channel, ...]
    channel: int
    side: Side
    bump: int
    mask: str
    time: float
    lines: tuple[Point, ...]
    points: tuple[Point, ...]
    view: View
    runs: tuple[_RunHeader, ...]
    known: tuple[str, ...]
    has_result: bool


def terms_from_files(spec: str) -> list[str]:
    """The terms of a function that read files, in their text form: what a project must hold the values of."""
    from abfm.functions import Family, Sum, parse

    tree = parse(spec)
    terms = tree.terms if isinstance(tree, Sum) else (tree,)
    return [str(term) for term in terms if isinstance(term, Family) and term.family in ("file", "permuted")]


def save_project(path: str | os.PathLike[str], document: Document, known: Mapping[str, FloatArray]) -> None:
    """Write a project, whole or not at all.

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
        If it cannot be written.
    """
    mesh, runs = document.mesh, document.runs
    header = _Header(
        name=document.name,
        file_vertex_count=mesh.file_vertex_count,
        channels=document.channels,
        channel=document.channel,
        side=document.side,
        bump=document.bump,
        mask=document.mask,
        time=document.time,
        lines=document.lines,
        points=document.points,
        view=document.view,
        runs=tuple(_RunHeader(run.restarts, run.mismatch, run.label) for run in runs),
        known=tuple(known),
        has_result=document.result is not None,
    )
    content = {
        "format_version": FORMAT_VERSION,
        "parameters": document.parameters.to_dict(),
        **to_plain(header),
    }
    with write_atomically(path) as temporary, zipfile.ZipFile(temporary, "w") as archive:
        archive.writestr(zipfile.ZipInfo("project.json", _EPOCH), json.dumps(content, indent=1, allow_nan=False))
        for name in _MESH:
            _write(archive, f"mesh/{name}.npy", getattr(mesh, name))
        for number, run in enumerate(runs):
            _write(archive, f"runs/{number}-energies.npy", run.energies)
            _write(archive, f"runs/{number}-stages.npy", run.stages)
        for number, values in enumerate(known.values()):
            _write(archive, f"known/{number}.npy", values)
        if document.result is not None:
            with tempfile.TemporaryDirectory() as folder:
                result = Path(folder) / "result.npz"
                document.result.save(result)
                archive.writestr(zipfile.ZipInfo("result.npz", _EPOCH), result.read_bytes())


def load_project(path: str | os.PathLike[str]) -> tuple[Document, dict[str, FloatArray]]:
    """Read a project: the document, and the values of its terms that came from other files.

    Raises
    ------
    ProjectError
        If the file is missing, damaged, no project, or from a newer version.
    """
    with _explained(path), zipfile.ZipFile(path) as archive:
        if "project.json" not in archive.namelist():
            is_result = "velocity.npy" in archive.namelist()
            raise ProjectError("it is a result, not a project" if is_result else "it holds no project.json")
        content = json.loads(archive.read("project.json"))
        if not isinstance(content, dict):
            raise ProjectError("project.json is no object")
        version = content.pop("format_version", None)
        if isinstance(version, int) and version > FORMAT_VERSION:
            raise ProjectError(f"it has format {version}, and this abfm reads up to {FORMAT_VERSION}: upgrade abfm")
        if version != FORMAT_VERSION:
            raise ProjectError(f"format_version is {version!r}; expected {FORMAT_VERSION}")
        parameters = Parameters.from_dict(content.pop("parameters"))
        header: _Header = from_plain(_Header, content, "project")
        mesh = _mesh(archive, header.file_vertex_count)
        _check(header, mesh, parameters)
        runs = tuple(_run(archive, number, run) for number, run in enumerate(header.runs))
        known = {
            spec: _read(archive, f"known/{number}.npy", (len(mesh.vertices),), "f")
            for number, spec in enumerate(header.known)
        }
        document = Document(
            mesh=mesh,
            name=header.name,
            channels=header.channels,
            channel=header.channel,
            side=header.side,
            bump=header.bump,
            parameters=parameters,
            mask=header.mask,
            result=_result(archive, mesh) if header.has_result else None,
            runs=runs,
            time=header.time,
            lines=header.lines,
            points=header.points,
            view=header.view,
        )
        return document, known


@contextmanager
def _explained(path: str | os.PathLike[str]) -> Iterator[None]:
    """Turn whatever damage does into one line that names the file."""
    try:
        yield
    except zipfile.BadZipFile:
        raise ProjectError(f"cannot read {path}: it is no project file, or was cut off") from None
    except OSError as error:
        raise ProjectError(f"cannot read {path}: {error.strerror or error}") from error
    except (AbfmError, PlainError) as error:
        raise ProjectError(f"cannot read {path}: {error}") from error
    except (KeyError, ValueError, TypeError, EOFError, zlib.error, NotImplementedError, RuntimeError) as error:
        raise ProjectError(f"cannot read {path}: the file is damaged ({' '.join(str(error).split())})") from error


def _write(archive: zipfile.ZipFile, name: str, array: NDArray[Any]) -> None:
    with archive.open(zipfile.ZipInfo(name, _EPOCH), "w", force_zip64=True) as file:
        np.lib.format.write_array(file, np.ascontiguousarray(array), allow_pickle=False)


def _read(archive: zipfile.ZipFile, name: str, shape: tuple[int | None, ...], kind: str) -> NDArray[Any]:
    """An array of a shape, with None for any length, and of a NumPy kind: "f" (finite) or "i"."""
    with archive.open(name) as file:
        version = np.lib.format.read_magic(file)
        if version != (1, 0):
            raise ProjectError(f"{name} is no array of version 1.0")
        given, fortran, dtype = np.lib.format.read_array_header_1_0(file)
        fits = len(given) == len(shape) and all(w in (None, g) for g, w in zip(given, shape, strict=True))
        if not fits or fortran or dtype.kind != kind or dtype.hasobject:
            raise ProjectError(f"{name} is a {dtype} array {given}; expected {kind} {shape}")
        size = int(np.prod(given, dtype=object)) * dtype.itemsize
        if size > archive.getinfo(name).file_size:
            raise ProjectError(f"{name} is cut off")
        array = np.frombuffer(file.read(), dtype)
    if array.size != int(np.prod(given)):
        raise ProjectError(f"{name} has {array.size} numbers for shape {given}")
    if kind == "f" and not np.isfinite(array).all():
        raise ProjectError(f"{name} has values that are not finite")
    return array.reshape(given).copy()


def _mesh(archive: zipfile.ZipFile, file_vertex_count: int) -> TriangleMesh:
    """Vertices at the places that they have in the mesh file, so that they keep their numbers."""
    vertices = _read(archive, "mesh/vertices.npy", (None, 3), "f")
    ids = _read(archive, "mesh/vertex_ids.npy", (len(vertices),), "i")
    faces = _read(archive, "mesh/faces.npy", (None, 3), "i")
    ascending = len(ids) > 0 and ids[0] >= 0 and bool((np.diff(ids) > 0).all())
    if not ascending or ids[-1] >= file_vertex_count or file_vertex_count > 100 * len(ids) + 10_000_000:
        raise ProjectError(f"the vertices' numbers do not fit {file_vertex_count} vertices of the mesh file")
    if faces.size and not 0 <= faces.min() <= faces.max() < len(vertices):
        raise ProjectError(f"a face names a vertex outside 0 to {len(vertices) - 1}")
    placed = np.full((file_vertex_count, 3), np.nan)
    placed[ids] = vertices
    return TriangleMesh(placed, ids[faces])


def _check(header: _Header, mesh: TriangleMesh, parameters: Parameters) -> None:
    """Refuse what only fits together in part."""
    if not 0 <= header.channel < max(len(header.channels), 1):
        raise ProjectError(f"channel {header.channel} of {len(header.channels)}")
    if not 0 <= header.time <= EXTRAPOLATION * parameters.tau:
        raise ProjectError(f"time {header.time:g} outside 0 to {EXTRAPOLATION * parameters.tau:g}")
    if any(not 0 <= point.face < len(mesh.faces) for point in header.lines + header.points):
        raise ProjectError(f"a point on a face outside 0 to {len(mesh.faces) - 1}")


def _run(archive: zipfile.ZipFile, number: int, header: _RunHeader) -> Run:
    energies = _read(archive, f"runs/{number}-energies.npy", (None, 3), "f")
    stages = _read(archive, f"runs/{number}-stages.npy", (len(energies),), "i")
    return Run(energies, stages, header.restarts, header.mismatch, header.label)


def _result(archive: zipfile.ZipFile, mesh: TriangleMesh) -> Match:
    from abfm import load_match

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "result.npz"
        path.write_bytes(archive.read("result.npz"))
        try:
            match = load_match(path)
        except ResultError as error:
            raise ProjectError(f"its result: {str(error).removeprefix(f'{path}: ')}") from None
    if not np.array_equal(match.mesh.vertices, mesh.vertices) or not np.array_equal(match.mesh.faces, mesh.faces):
        raise ProjectError("its result is on another mesh")
    return replace(match, mesh=mesh)
