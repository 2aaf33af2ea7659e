"""Project files (``.abfm``): a zip with everything that is needed to go on elsewhere.

``project.json`` holds all that is small; ``mesh/*.npy``, ``result/*.npy`` and ``runs/*/*.npy`` the
arrays of the document, and ``known/*.npy`` the values of functions that come from other files. Of
two surfaces ``mesh/*.npy`` is B, on which the result is, ``mesh_a/*.npy`` A, and ``initial/*.npy``
the initial map that the result began with. Of a film ``film/*.npy`` are its frames, and
``sequence/*.npy`` the fields between them.
"""

from __future__ import annotations

import json
import math
import os
import types
import zipfile
from collections.abc import Collection, Mapping
from dataclasses import MISSING, dataclass, fields, is_dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Any, Literal, Union, cast, get_args, get_origin, get_type_hints

import numpy as np

import abfm
from abfm import Parameters, ResultError, TriangleMesh
from abfm.errors import brief, one_line
from abfm.io import results, write_atomically
from abfm.io.results import (
    CORRESPONDENCE_ENTRIES,
    MATCH_ENTRIES,
    MESH_ENTRIES,
    Entry,
    check_arrays,
    mesh_of,
)
from abfm.pages.colormaps import NAMES
from abfm.pages.front import Front
from abfm.reading import from_json
from abfm.types import FloatArray
from abfm_viewer.document.document import (
    SIDES,
    ZOOM_MAX,
    ZOOM_MIN,
    Document,
    Identity,
    InitialMap,
    Point,
    RunRecord,
    Side,
    Surface,
    View,
)
from abfm_viewer.document.film import Film, FilmSettings
from abfm_viewer.document.kinds import OF_A, FilmDocument, MatchDocument, PairDocument
from abfm_viewer.document.label_map import LabelMap

_FORMAT = 6
_LARGEST_HEADER = 2 << 20  # bytes of `project.json`
_MESH = {
    name: MESH_ENTRIES[name] for name in ("vertex_ids", "vertices", "faces", "copies", "structure")
}
_RUN = {
    "stages": Entry("integer", ("n",), may_be_empty=True, low=0),
    "energies": Entry("real", ("n", 3), may_be_empty=True),
}
_COURSE = _RUN | {
    "vertices": Entry("integer", ("n",), low=0),
    "reaches": Entry("real", ("n",), low=0),
}
_RESIDUALS = {
    name: Entry("real", ("n",), required=False, low=0) for name in ("residuals", "sigmas")
}
_SHARES = {"shares": Entry("real", ("n", "T"), low=0)}
_INITIAL_ENTRIES = {  # without the meshes
    name: entry
    for name, entry in CORRESPONDENCE_ENTRIES.items()
    if name.removeprefix("a_") not in MESH_ENTRIES
}
_FUNCTIONS = {"functions": Entry("real", ("VA", "C"), required=False)}
_LABELS = {"values": Entry("integer", ("V",))}
_FRAMES = {
    name: results.SEQUENCE.entries[name]
    for name in ("frames", "times", "mask", "channels_given", "weights")
}
_FIELDS = {
    name: entry
    for name, entry in results.SEQUENCE.entries.items()
    if name not in (*MESH_ENTRIES, *_FRAMES, "notes")
}
_RESULT = {name: entry for name, entry in MATCH_ENTRIES.items() if name != "parameters"}
_ABOVE_0 = {"ui_scale": 10, "arrow_length": 10}
_VIEW_BOUNDS = {"arrow_density": (0, 1), "isoline_count": (1, 1000)}
MEMBER = "origin.json"
"""Where a copy of unsaved work says what it is a copy of."""


@dataclass(frozen=True)
class Origin:
    """A project file, and when (ns) it was modified, and its bytes, when last read or written."""

    path: Path
    modified: int
    size: int

    @classmethod
    def of(cls, path: Path) -> Origin:
        """The file as it is now; with a negative size if there is none."""
        return cls(path, *_state(path))

    @property
    def exists(self) -> bool:
        return _state(self.path)[1] >= 0

    @property
    def changed(self) -> bool:
        return self.exists and _state(self.path) != (self.modified, self.size)


@dataclass(frozen=True)
class _SurfaceA:
    """What `project.json` holds of surface A of two."""

    name: str
    file_vertex_count: int
    front: Front | None = None


@dataclass(frozen=True)
class _Film:
    """What `project.json` holds of a film."""

    name: str
    unit: str
    settings: FilmSettings
    has_fields: bool
    has_mask: bool


@dataclass(frozen=True)
class _Header:
    """What `project.json` holds; `known` are functions with values, as their members count."""

    file_vertex_count: int
    document: dict[str, Any]
    runs: tuple[dict[str, Any], ...]
    result: dict[str, Any] | None
    result_has_mask: bool
    known: tuple[str, ...]
    surface_a: _SurfaceA | None = None
    initial_map: dict[str, Any] | None = None
    labels: dict[str, Any] | None = None
    film: _Film | None = None


def save_project(
    path: str | os.PathLike[str],
    document: Document,
    known: Mapping[str, FloatArray],
    origin: Origin | None = None,
) -> None:
    """Write a project, whole or not at all; the same document gives the same bytes.

    Known are the values (V,) of the terms that `terms_from_files` names. A copy of unsaved work
    says of which project file it is one. A `ResultError` says why it would not open again, or
    cannot be written.
    """
    surface, (arrays, others) = document.surface(), _of_surface_a(document)
    arrays |= _mesh_arrays(surface.mesh, "mesh/")
    runs = []
    for number, run in enumerate(document.runs):
        names = (_COURSE if run.has_course else _RUN) | (_SHARES if run.words else {})
        names |= {name: _RESIDUALS[name] for name in _RESIDUALS if len(getattr(run, name))}
        arrays |= {f"runs/{number}/{name}": getattr(run, name) for name in names}
        runs.append(
            to_plain(run, without=_COURSE | _SHARES | _RESIDUALS) | {"has_course": run.has_course}
        )
    result = None
    if (match := document.match) is not None:
        result = abfm.matching.match_arrays(match)
        own = [name for name, part in result.items() if isinstance(part, np.ndarray)]
        arrays |= {f"result/{name}": result.pop(name) for name in own}
        result["parameters"] = match.parameters
    of_film, film = _of_film(document)
    arrays |= of_film
    arrays |= {f"known/{number}": known[spec] for number, spec in enumerate(sorted(known))}
    # the surface's name is the document's in the file, and its front the view's
    kept_apart: tuple[str, ...] = ("identity", "surfaces", "result", "runs", "initial_map")
    kept_apart += ("labels", "comparison", "film", "settings")
    plain = to_plain(document, without=kept_apart)
    plain["view"] = to_plain(document.view) | {"front": surface.front}
    content = {
        "format_version": _FORMAT,
        "file_vertex_count": surface.mesh.file_vertex_count,
        "document": {"name": surface.name} | plain,
        "runs": runs,
        "result": result,
        "result_has_mask": "result/mask" in arrays,
        "known": sorted(known),
        **others,
        **film,
    }
    try:
        text = json.dumps(content, indent=1, default=to_plain)
        if len(text) > _LARGEST_HEADER:
            raise ValueError(
                f"it has {len(text)} bytes besides its arrays, and at most {_LARGEST_HEADER} can "
                "be read"
            )
        _document(json.loads(text), arrays, document)
    except ValueError as error:
        raise ResultError(f"{one_line(path)} not written: {one_line(error, 400)}") from error
    with write_atomically(path) as temporary, zipfile.ZipFile(temporary, "w") as archive:
        archive.writestr(zipfile.ZipInfo("project.json"), text)
        if origin is not None:
            archive.writestr(zipfile.ZipInfo(MEMBER), json.dumps(to_plain(origin), default=str))
        results.write_arrays(archive, arrays)


def _of_surface_a(document: Document) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return what there is of surface A, the map from it and labels on it: arrays, and the rest."""
    arrays: dict[str, Any] = {}
    content: dict[str, Any] = {}
    if len(document.surfaces) > 1:
        first = document.surface("source")
        arrays |= _mesh_arrays(first.mesh, "mesh_a/")
        content["surface_a"] = _SurfaceA(first.name, first.mesh.file_vertex_count, first.front)
    if (initial := document.initial_map) is not None:
        of_map = initial.correspondence.arrays()
        arrays |= {f"initial/{name}": of_map[name] for name in _INITIAL_ENTRIES if name in of_map}
        if initial.functions is not None:
            arrays["initial/functions"] = initial.functions
        content["initial_map"] = to_plain(initial, without=("correspondence", "functions"))
    if (labels := document.labels) is not None:
        arrays["labels/values"] = labels.values
        content["labels"] = to_plain(labels, without=("values",))
    return arrays, content


def _of_film(document: Document) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return what there is of a film: arrays, and the rest."""
    if not isinstance(document, FilmDocument):
        return {}, {}
    film, sequence = document.film, document.result
    frames = film.frames
    arrays: dict[str, Any] = {
        "film/frames": frames.values,
        "film/times": frames.times,
        "film/weights": frames.weights,
        "film/channels_given": np.array(frames.channels_given),
    }
    has_mask, has_fields = frames.mask is not None, sequence is not None
    if has_mask:
        arrays["film/mask"] = frames.mask
    if sequence is not None:
        found = sequence.arrays()
        arrays |= {f"sequence/{name}": found[name] for name in _FIELDS}
    return arrays, {"film": _Film(film.name, film.unit, document.settings, has_fields, has_mask)}


def _film(
    header: _Film, arrays: Mapping[str, Any], mesh: TriangleMesh
) -> tuple[Film, abfm.Sequence | None]:
    from abfm.sequences.frames import Frames  # with all that it loads

    entries = _FRAMES | {"mask": _FRAMES["mask"]._replace(required=header.has_mask)}
    known = check_arrays(arrays, entries, "film/", V=len(mesh.vertices))
    count = len(known["times"])
    fits = count == len(known["frames"]) > 1 and bool((np.diff(known["times"]) > 0).all())
    _require(fits, f"a film has {count} times that do not fit its {len(known['frames'])} frames")
    weights, is_given = known["weights"], bool(known["channels_given"])
    parts = known["frames"], known["times"], known.get("mask"), weights, is_given
    film = Film(header.name, Frames(mesh, *parts, unit_of_time=header.unit))
    if not header.has_fields:
        return film, None
    sizes = {"F": len(mesh.faces), "I": count - 1}
    fields = check_arrays(arrays, _FIELDS, "sequence/", **sizes)
    found = abfm.Sequence.of_arrays({**known, **fields}, mesh)
    return film, replace(found, _frames=film.frames)


def load_project(path: str | os.PathLike[str]) -> tuple[Document, dict[str, FloatArray]]:
    """Read a document and its values from other files; a `ResultError` says what is wrong."""
    with results.open_archive(path, "project", "take another copy of the file") as archive:
        if "velocity" in archive:
            raise ResultError(
                "a result file, not a project; open it as a result, under a name that ends in .npz"
            )
        if archive.packed:
            raise ValueError(
                f"{archive.packed[0]} is compressed; expected a zip without compression"
            )
        content = from_json(archive.read("project.json", _LARGEST_HEADER))
        document, known = _document(content, archive)
    return document.borne_out(), known


def load_origin(copy: str | os.PathLike[str]) -> Origin | None:
    """Read what a copy of unsaved work is a copy of; None if of no file that is still there."""
    try:
        with results.open_archive(copy, "project", "") as archive:
            plain = json.loads(archive.read(MEMBER))
            origin = Origin(Path(plain["path"]), int(plain["modified"]), int(plain["size"]))
    except ResultError:
        return None
    return origin if origin.exists else None


def terms_from_files(spec: str) -> list[str]:
    """Return the terms of a function that read files; a `FunctionError` if it is no function."""

    def reads_file(part: abfm.functions.Spec) -> bool:
        is_map = isinstance(part, abfm.functions.Permuted) and not part.is_detected
        return is_map or isinstance(part, abfm.functions.ValuesFile)

    tree = abfm.functions.parse(spec)
    terms = tree.terms if isinstance(tree, abfm.functions.Sum) else (tree,)
    return [str(each) for each in terms if any(map(reads_file, abfm.functions.functions_in(each)))]


def _document(
    content: Any, arrays: Mapping[str, Any], written: Document | None = None
) -> tuple[Document, dict[str, FloatArray]]:
    """Document and known values from what a file holds; meshes and the map between them are made,
    unless what is `written` has them.
    """
    version = content.pop("format_version", None) if isinstance(content, dict) else None
    results.check_version(version, _FORMAT)
    header: _Header = from_plain(_Header, content, "project")
    meshes, initial = _meshes(header, arrays, written)
    mesh = meshes[-1]
    runs = tuple(_run(number, state, arrays) for number, state in enumerate(header.runs))
    result, plain = None, header.document
    if header.result is not None:
        result = _result(header.result, header.result_has_mask, arrays, mesh)
    view = plain.get("view")
    front = view.pop("front", None) if isinstance(view, dict) else None
    own = {"name": plain.pop("name", None), "front": front}
    surfaces: tuple[Surface, ...] = (from_plain(Surface, own, "project.document", mesh=mesh),)
    if (first := header.surface_a) is not None:
        surfaces = (Surface(meshes[0], first.name, first.front), *surfaces)
    labels = None if header.labels is None else _labels(header.labels, arrays, meshes[0])
    given: dict[str, Any] = {"surfaces": surfaces, "identity": Identity(), "labels": labels}
    kind: type[Document] = MatchDocument if len(surfaces) == 1 else PairDocument
    if header.film is not None:
        _require(len(surfaces) == 1 and result is None, "a film is on one surface, without a match")
        given["film"], given["result"] = _film(header.film, arrays, mesh)
        given["settings"] = header.film.settings
        kind = FilmDocument
    else:
        given |= {"result": result, "runs": runs}
        given |= {"initial_map": initial} if kind is PairDocument else {}
    document: Document = from_plain(kind, plain, "project.document", **given)
    values = {
        f"the values of {spec}": arrays[f"known/{number}"]
        for number, spec in enumerate(header.known)
    }
    entries = {
        name: Entry(
            "real",
            ("VA" if len(surfaces) > 1 and name.startswith(OF_A) else "V",),
            may_be_unknown=True,
        )
        for name in header.known
    }
    sizes = {"V": len(mesh.vertices), "VA": len(meshes[0].vertices)}
    known = check_arrays(values, entries, "the values of ", **sizes)
    _check(document)
    return document, known


def _meshes(
    header: _Header, arrays: Mapping[str, Any], written: Document | None
) -> tuple[tuple[TriangleMesh, ...], InitialMap | None]:
    """Return the surfaces' meshes, B last, and the map between them, if there is one."""
    parts = _mesh_parts(arrays, "mesh/", header.file_vertex_count)
    if header.surface_a is None:
        _require(header.initial_map is None, "there is an initial map of one surface")
        return (written.surface().mesh if written else mesh_of(parts),), None
    of_a = _mesh_parts(arrays, "mesh_a/", header.surface_a.file_vertex_count)
    state = header.initial_map
    if state is None:
        meshes = (surface.mesh for surface in written.surfaces) if written else ()
        return tuple(meshes) or (mesh_of(of_a), mesh_of(parts)), None
    sizes = {"V": len(parts["vertices"]), "VA": len(of_a["vertices"])}
    maps = check_arrays(arrays, _INITIAL_ENTRIES | _FUNCTIONS, "initial/", **sizes)
    functions = maps.pop("functions", None)
    if written is not None and written.initial_map is not None:
        found = written.initial_map.correspondence
    else:
        from abfm.registration.correspondence import correspondence_of  # with all that it loads

        of_both = parts | {f"a_{name}": part for name, part in of_a.items()} | maps
        found = correspondence_of(of_both)
    made = {"correspondence": found, "functions": functions}
    initial: InitialMap = from_plain(InitialMap, state, "project.initial_map", **made)
    return (found.a, found.b), initial


def _labels(state: dict[str, Any], arrays: Mapping[str, Any], mesh: TriangleMesh) -> LabelMap:
    parts = check_arrays(arrays, _LABELS, "labels/", V=len(mesh.vertices))
    labels: LabelMap = from_plain(LabelMap, state, "project.labels", **parts)
    counts = {len(labels.keys), len(labels.names), len(labels.colors)}
    _require(len(counts) == 1, "labels have not as many keys, names and colours")
    keys = np.array(labels.keys, dtype=np.int64)
    _require(bool((np.diff(keys) > 0).all()), "the keys of labels do not ascend")
    _require(bool(np.isin(labels.values, keys).all()), "labels have keys that are none of theirs")
    inside = all(0 <= channel <= 1 for color in labels.colors for channel in color)
    _require(inside, "labels have colours outside 0 to 1")
    return labels


def _mesh_arrays(mesh: TriangleMesh, prefix: str) -> dict[str, Any]:
    found = results.mesh_arrays(mesh)
    return {f"{prefix}{name}": found[name] for name in _MESH if name in found}


def _mesh_parts(arrays: Mapping[str, Any], prefix: str, count: int) -> dict[str, Any]:
    return {**check_arrays(arrays, _MESH, prefix), "file_vertex_count": np.array(count)}


def _run(number: int, state: dict[str, Any], arrays: Mapping[str, Any]) -> RunRecord:
    entries = _COURSE if state.pop("has_course", False) else _RUN
    entries = entries | _RESIDUALS | (_SHARES if state.get("words") else {})
    parts = check_arrays(arrays, entries, f"runs/{number}/")
    return cast(RunRecord, from_plain(RunRecord, state, f"project.runs[{number}]", **parts))


def _result(
    state: dict[str, Any], has_mask: bool, arrays: Mapping[str, Any], mesh: TriangleMesh
) -> abfm.Match:
    known = {name: value for name, value in state.items() if value is not None}
    entries = _RESULT | {"mask": _RESULT["mask"]._replace(required=has_mask)}
    given = {place: arrays[place] for name in entries if (place := f"result/{name}") in arrays}
    given |= {f"result/{name}": value for name, value in known.items()}
    parts = check_arrays(given, entries, "result/", V=len(mesh.vertices), F=len(mesh.faces))
    parameters = from_plain(Parameters, known.get("parameters"), "project.result.parameters")
    return abfm.matching.match_of(mesh, parts, parameters)


def _check(document: Document) -> None:
    """Refuse a document whose parts do not fit together, by a `ValueError` that says why."""
    for number, run in enumerate(document.runs):
        rows = run.stages.size
        inside = all(0 <= row <= rows for row in run.restarts)
        _require(inside, f"run {number} of {rows} rows restarts outside them")
        named = not run.words or run.shares.shape[1] == len(run.words)
        _require(named, f"run {number} has {run.shares.shape[1]} shares of {len(run.words)} terms")
    for function in document.functions:
        terms_from_files(function.spec)
    for weight in (channel.weight for channel in document.channels):
        _require(0 <= weight < np.inf, f"a channel has the weight {weight}; expected 0 or more")
    _within("channel", document.channel, 0, document.channel_count - 1)
    document.check()
    _within("time", document.time, document.start or 0, document.end)
    _check_points(document, "target", *document.lines, *document.points)
    initial = document.initial_map
    for landmark in document.landmarks + (initial.landmarks if initial else ()):
        fits = 0 < landmark.weight < np.inf
        _require(fits, f"a landmark has the weight {landmark.weight}; expected more than 0")
        for side in SIDES:
            if (point := landmark.point(side)) is not None:
                _check_points(document, side, point)
    _check_view(document.view)
    look = document.view.look
    _require(
        document.initial_map is None or document.result is not None,
        "there is an initial map of no result",
    )
    fronts = [surface.front for surface in document.surfaces]
    for front in (*fronts, look.front if look else None):
        axes = np.eye(3)[:2] if front is None else np.array([front.direction, front.up])
        is_upright = bool(np.allclose(axes @ axes.T, np.eye(2), atol=1e-6))
        _require(is_upright, f"front is {front}; expected two unit vectors at a right angle")


def _check_points(document: Document, side: Side, *points: Point) -> None:
    F = len(document.surface(side).mesh.faces)
    for point in points:
        inside = min(point.barycentric) >= -1e-9 and abs(sum(point.barycentric) - 1) <= 1e-9
        _require(0 <= point.face < F, f"a point lies on face {point.face}; expected 0 to {F - 1}")
        _require(inside, f"a point has weights {point.barycentric}; expected 0 or more, with sum 1")


def _check_view(view: View) -> None:
    colormaps = ("automatic", *NAMES)
    expected = " or ".join(colormaps)
    _require(view.colormap in colormaps, f"colormap is {view.colormap!r}; expected {expected}")
    for name, high in _ABOVE_0.items():
        value = getattr(view, name)
        _require(0 < value <= high, f"{name} is {value}; expected above 0 to {high:g}")
    for name, bounds in _VIEW_BOUNDS.items():
        _within(name, getattr(view, name), *bounds)
    if view.look is not None:
        _within("zoom", view.look.zoom, ZOOM_MIN, ZOOM_MAX)


def _within(name: str, value: float, low: float, high: float) -> None:
    _require(low <= value <= high, f"{name} is {value}; expected {low} to {high}")


def _require(fits: bool, problem: str) -> None:
    if not fits:
        raise ValueError(problem)


def to_plain(value: Any, without: Collection[str] = ()) -> dict[str, Any]:
    """Return the fields of a dataclass but for some; JSON writes those in it by this, too."""
    if isinstance(value, Parameters):
        return value.to_dict()
    return {e.name: getattr(value, e.name) for e in fields(value) if e.name not in without}


def from_plain(hint: Any, value: Any, where: str, **given: Any) -> Any:
    """Return what JSON was made of, for a type hint; a `ValueError` says where it does not fit.

    Missing fields take their defaults, and given ones are not looked for.
    """
    origin, options = get_origin(hint), get_args(hint)
    if origin is Literal:
        _expect(value in options, where, value, " or ".join(map(repr, options)))
        return value
    if origin in (Union, types.UnionType):
        [inner] = [option for option in options if option is not type(None)]
        return None if value is None else from_plain(inner, value, where)
    if origin is tuple:
        _expect(isinstance(value, list), where, value, "a list")
        kinds = [options[0]] * len(value) if options[1:] == (Ellipsis,) else list(options)
        _expect(len(kinds) == len(value), where, value, f"{len(kinds)} entries")
        return tuple(from_plain(kind, value[i], f"{where}[{i}]") for i, kind in enumerate(kinds))
    if origin is dict or is_dataclass(hint):
        _expect(isinstance(value, dict), where, value, "an object")
        if hint is Parameters:
            return Parameters.of(**value)
        return value if origin is dict else _dataclass(hint, value, where, given)
    if isinstance(hint, type) and issubclass(hint, StrEnum):
        _expect(value in list(hint), where, value, f"one of {', '.join(hint)}")
        return hint(value)
    if hint is float:
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        _expect(is_number and math.isfinite(value), where, value, "a finite number")
        return float(value)
    _expect(type(value) is hint, where, value, f"a value of type {hint.__name__}")
    return value


def _dataclass(hint: Any, value: dict[str, Any], where: str, given: dict[str, Any]) -> Any:
    # a document without a result does not load its type
    names = "Match", "Correspondence", "LabelMap", "Comparison", "Film", "Sequence"
    unknown_here: dict[str, Any] = dict.fromkeys(names, Any)
    hints = get_type_hints(hint, localns=unknown_here)
    known = {entry.name: entry for entry in fields(hint) if entry.name not in given}
    unknown = sorted(value.keys() - known.keys())
    _expect(not unknown, where, unknown, f"only {', '.join(known)}")
    required = {
        name for name, e in known.items() if e.default is MISSING and e.default_factory is MISSING
    }
    missing = sorted(required - value.keys())
    _expect(not missing, where, value, f"also {', '.join(missing)}")
    parts = {name: from_plain(hints[name], part, f"{where}.{name}") for name, part in value.items()}
    return hint(**parts, **given)


def _expect(fits: bool, where: str, value: Any, expected: str) -> None:
    if not fits:
        raise ValueError(f"{where} is {brief(value)}; expected {expected}")


def _state(path: Path) -> tuple[int, int]:
    try:
        found = path.stat()
    except (OSError, ValueError):
        return 0, -1
    return found.st_mtime_ns, found.st_size
