"""Project files (``.abfm``): zip files with all data of a document.

The members of the zip file are:

- ``result.npz``: the result file, as written by the result's `save`
- ``view.json``: the view of the document, without theme and UI scale
- ``project.json``: the other fields of the document
- ``*.npy``: arrays

JSON refers to arrays and meshes by the names of their members. Objects that the result contains are
named ``result/NAME``.
"""

from __future__ import annotations

import json
import math
import os
import types
import zipfile
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import MISSING, dataclass, fields, is_dataclass
from functools import cache, partial
from operator import attrgetter
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np

import abfm
from abfm import Parameters, ResultError, TriangleMesh
from abfm.errors import brief, one_line
from abfm.io import results, write_atomically
from abfm.io.results import MESH_ENTRIES, SEQUENCE, Entry
from abfm.pages.colormaps import NAMES
from abfm.reading import from_json
from abfm.types import FloatArray
from abfm_viewer.document.document import (
    APPEARANCE,
    SIDES,
    Document,
    Point,
    Range,
    RunRecord,
    Side,
    Surface,
    View,
)
from abfm_viewer.document.kinds import KINDS
from abfm_viewer.document.label_map import LabelMap

MEMBER = "origin.json"  # member of an autosaved copy that names the original project file
_FORMAT = 10
_JSON_BYTES_MAX = 2 << 20  # limit for a member
_RESULT = "result.npz"
_KNOWN = Entry("real", ("V",), allow_missing=True)
_ENTRIES = {
    RunRecord.__name__: {
        "energies": Entry("real", ("n", 3), may_be_empty=True),
        "stages": Entry("integer", ("n",), may_be_empty=True, low=0),
        "vertices": Entry("integer", ("v",), may_be_empty=True, low=0),
        "reaches": Entry("real", ("v",), may_be_empty=True, low=0),
        "shares": Entry("real", ("s", "T"), may_be_empty=True, low=0),
        "residuals": Entry("real", ("r",), may_be_empty=True, low=0),
        "sigmas": Entry("real", ("i",), may_be_empty=True, low=0),
        "attempts": Entry("integer", ("a",), may_be_empty=True, low=1),
    },
    LabelMap.__name__: {"values": Entry("integer", ("V",))},
    "Frames": {
        "values": SEQUENCE.entries["frames"],
        **{name: SEQUENCE.entries[name] for name in ("times", "numbers", "mask", "weights")},
    },
}
"""Array fields by dataclass and field; V is the vertex count of the dataclass's mesh, if any."""
_PARTS = ("match", "initial", "functions", "initial.a", "initial.b", "mesh", "_frames")
"""Attributes of results that documents contain as well."""
# types of results are not loaded for documents without a result
_OF_RESULT: dict[str, Any] = {
    name: Annotated[Any, name] for name in ("Match", "Correspondence", "Sequence")
}
_hints = cache(partial(get_type_hints, localns=_OF_RESULT, include_extras=True))


@dataclass(frozen=True)
class Origin:
    """A project file, with time and size when the app last read or wrote it."""

    path: Path
    modified: int  # time in ns
    size: int  # in bytes

    @classmethod
    def of(cls, path: Path) -> Origin:
        """Return a file with its present time and size; the size of a missing file is negative."""
        return cls(path, *_state(path))

    @property
    def exists(self) -> bool:
        return _state(self.path)[1] >= 0

    @property
    def changed(self) -> bool:
        return self.exists and _state(self.path) != (self.modified, self.size)


@dataclass(frozen=True)
class _Header:
    kind: str
    has_result: bool
    document: dict[str, Any]
    known: dict[str, str]  # names of arrays by `Document.values_key`


def save_project(
    path: str | os.PathLike[str],
    document: Document,
    known: Mapping[str, FloatArray],
    origin: Origin | None = None,
) -> None:
    """Write a document as a project file, completely or not at all.

    Equal documents give equal bytes. ``known`` are the values (V,) of functions that need files
    (see `terms_from_files`), by `Document.values_key`. For an autosaved copy, ``origin`` is the
    project file of the document. If the file cannot be written, or could not be opened again, a
    `ResultError` is raised.
    """
    document, found = document.saved(), document.complete_result
    writer = _Writer(_parts(found))
    plain = writer.plain(document, "document")
    view = {name: part for name, part in plain.pop("view").items() if name not in APPEARANCE}
    kind = next(name for name, each in KINDS.items() if each is type(document))
    values = {spec: f"known/{number}" for number, spec in enumerate(sorted(known))}
    writer.arrays |= {name: known[spec] for spec, name in values.items()}
    header = {"kind": kind, "has_result": found is not None, "document": plain, "known": values}
    try:
        texts = {
            "project.json": _text({"format_version": _FORMAT, **header}),
            "view.json": _text(view),
        }
        plain, view = map(json.loads, texts.values())
        _read(plain, view, _Reader(writer.arrays, writer.objects))
    except ValueError as error:
        raise ResultError(f"{one_line(path)} not written: {one_line(error, 400)}") from error
    if origin is not None:
        texts[MEMBER] = json.dumps({**vars(origin), "path": str(origin.path)})
    with write_atomically(path) as temporary, zipfile.ZipFile(temporary, "w") as archive:
        for name, text in texts.items():
            archive.writestr(zipfile.ZipInfo(name), text)
        results.write_arrays(archive, writer.arrays)
        if found is not None:
            with archive.open(zipfile.ZipInfo(_RESULT), "w", force_zip64=True) as file:
                try:
                    found.save(file)
                except ResultError as error:
                    raise ResultError(f"{one_line(path)}: {one_line(error, 400)}") from error


def load_project(path: str | os.PathLike[str]) -> tuple[Document, dict[str, FloatArray]]:
    """Return the document in a project file, and the values of its functions that need files.

    The values (V,) are by `Document.values_key`. A damaged file raises a `ResultError`.
    """
    with results.open_archive(path, "project", "Use another copy of the file") as archive:
        if "format_version" in archive:
            raise ResultError(
                "a result file, not a project; rename it so that its name ends in .npz"
            )
        if archive.packed:
            raise ValueError(
                f"{archive.packed[0]} is compressed; expected a zip without compression"
            )
        plain = from_json(archive.read("project.json", _JSON_BYTES_MAX))
        version = plain.get("format_version") if isinstance(plain, dict) else None
        results.check_version(version, _FORMAT)
        view = from_json(archive.read("view.json", _JSON_BYTES_MAX))
        found = abfm.load(archive.part(_RESULT)) if plain.get("has_result") is True else None
        return _read(plain, view, _Reader(archive, _parts(found)))


def value_of(hint: Any, plain: Any, name: str) -> Any:
    """Return JSON data as a value of type ``hint``; data of a wrong type raise `ValueError`."""
    return _Reader({}, {}).read(hint, plain, name)


def load_origin(copy: str | os.PathLike[str]) -> Origin | None:
    """Return the project file of an autosaved copy; None if it had none or it no longer exists."""
    try:
        with results.open_archive(copy, "project", "") as archive:
            plain = json.loads(archive.read(MEMBER))
            origin = Origin(Path(plain["path"]), int(plain["modified"]), int(plain["size"]))
    except ResultError:
        return None
    return origin if origin.exists else None


def terms_from_files(spec: str) -> list[str]:
    """Return the terms of a spec that read files; an invalid spec raises a `FunctionError`."""

    def reads_file(part: abfm.functions.Spec) -> bool:
        is_map = isinstance(part, abfm.functions.Permuted) and not part.is_detected
        return is_map or isinstance(part, abfm.functions.ValuesFile)

    tree = abfm.functions.parse(spec)
    terms = tree.terms if isinstance(tree, abfm.functions.Sum) else (tree,)
    return [str(each) for each in terms if any(map(reads_file, abfm.functions.functions_in(each)))]


def _parts(found: Any) -> dict[str, Any]:
    """Return a result and its parts that the document also uses, by their names in the JSON."""
    parts = {} if found is None else {"result": found}
    for name in _PARTS:
        with suppress(AttributeError):
            parts[f"result/{name}"] = attrgetter(name)(found)
    return {name: part for name, part in parts.items() if part is not None}


def _text(plain: Any) -> str:
    text = json.dumps(plain, indent=1)
    if len(text) > _JSON_BYTES_MAX:
        raise ValueError(
            f"its settings and texts have {len(text)} bytes; expected at most {_JSON_BYTES_MAX}. "
            "Shorten its texts"
        )
    return text


class _Writer:
    def __init__(self, objects: dict[str, Any]) -> None:
        self.arrays: dict[str, Any] = {}
        self.objects = objects  # objects with names, such as parts of the result

    def plain(self, value: Any, place: str) -> Any:
        """Return a value as JSON data; the names of arrays in the value begin with ``place``."""
        if (name := self._name(value)) is not None:
            return name
        if isinstance(value, np.ndarray):
            self.arrays[place] = value
            return place
        if isinstance(value, TriangleMesh):
            arrays = results.mesh_arrays(value)
            self.arrays |= {f"{place}/{name}": array for name, array in arrays.items()}
            self.objects[place] = value
            return place
        if isinstance(value, Parameters):
            return value.to_dict()
        if is_dataclass(value):
            parts = {e.name: getattr(value, e.name) for e in fields(value) if e.name != "identity"}
            return {name: self.plain(part, f"{place}/{name}") for name, part in parts.items()}
        if isinstance(value, tuple):
            return [self.plain(part, f"{place}/{number}") for number, part in enumerate(value)]
        return value

    def _name(self, value: Any) -> str | None:
        """Return the name of an object, or of an equal mesh, in the project; None if it is new."""
        for name, known in self.objects.items():
            if known is value:
                return name
        if isinstance(value, TriangleMesh):
            for name, known in self.objects.items():
                is_other = isinstance(known, TriangleMesh) and name.startswith("result/")
                if is_other and known.digest == value.digest:
                    return name
        return None


class _Reader:
    """Converts JSON and arrays to a document; data of a wrong type raise `ValueError`."""

    def __init__(self, arrays: Mapping[str, Any], objects: dict[str, Any]) -> None:
        self._arrays, self._objects = arrays, objects

    def read(self, hint: Any, value: Any, where: str) -> Any:
        """Return JSON data as a value of type ``hint``; ``where`` is its place, for messages."""
        origin, options = get_origin(hint), get_args(hint)
        if origin in (Union, types.UnionType):
            [inner] = [option for option in options if option is not type(None)]
            return None if value is None else self.read(inner, value, where)
        if origin is Annotated and isinstance(options[1], Range):
            number = self.read(options[0], value, where)
            _require(options[1].contains(number), f"{where} is {number}; expected {options[1]}")
            return number
        is_named = self._has(value) and hint not in (str, Any)
        if is_named or origin is Annotated or hint is TriangleMesh:
            return self._object(hint, value, where)
        if origin is tuple:
            _expect(isinstance(value, list), where, value, "a list")
            kinds = [options[0]] * len(value) if options[1:] == (Ellipsis,) else list(options)
            _expect(len(kinds) == len(value), where, value, f"{len(kinds)} entries")
            return tuple(self.read(kind, value[i], f"{where}[{i}]") for i, kind in enumerate(kinds))
        if origin is dict or is_dataclass(hint):
            _expect(isinstance(value, dict), where, value, "an object")
            if origin is dict:
                return {name: self.read(options[1], value[name], where) for name in value}
            return Parameters.of(**value) if hint is Parameters else self._made(hint, value, where)
        return _scalar(hint, value, where)

    def _has(self, value: Any) -> bool:
        return isinstance(value, str) and value in self._objects

    def array(self, entry: Entry, value: Any, where: str, sizes: dict[str, int]) -> Any:
        is_there = isinstance(value, str) and value in self._arrays
        _expect(is_there, where, value, "an array that is in the file")
        return entry.check(where, np.asarray(self._arrays[value]), sizes)

    def _object(self, hint: Any, value: Any, where: str) -> Any:
        """Return the object that JSON data name: a part of the result, or a mesh."""
        _expect(isinstance(value, str), where, value, "a name")
        if hint is TriangleMesh and value not in self._objects:
            arrays = results.check_arrays(self._arrays, MESH_ENTRIES, f"{value}/")
            self._objects[value] = results.mesh_of(arrays)
        is_of_result = get_origin(hint) is Annotated
        wanted = getattr(abfm, get_args(hint)[1]) if is_of_result else get_origin(hint) or hint
        found = self._objects.get(value)
        _expect(isinstance(found, wanted), where, value, f"the name of a {wanted.__name__}")
        return found

    def _made(self, hint: Any, value: dict[str, Any], where: str) -> Any:
        hints = _hints(hint)
        known = {each.name: each for each in fields(hint)}
        if hint is View:
            known = {name: one for name, one in known.items() if name not in APPEARANCE}
        unknown = sorted(value.keys() - known.keys())
        _expect(not unknown, where, unknown, f"only {', '.join(known)}")
        required = {
            name
            for name, e in known.items()
            if e.default is MISSING and e.default_factory is MISSING
        }
        missing = sorted(required - value.keys())
        _expect(not missing, where, value, f"also {', '.join(missing)}")
        entries = _ENTRIES.get(hint.__name__, {})
        sizes: dict[str, int] = {}
        parts = {}
        for name in (name for name in known if name in value):
            place, part = f"{where}.{name}", value[name]
            if name in entries and part is not None and not self._has(part):
                parts[name] = self.array(entries[name], part, place, sizes)
            else:
                parts[name] = self.read(hints[name], part, place)
            if isinstance(parts[name], TriangleMesh):
                sizes["V"] = len(parts[name].vertices)
        return hint(**parts)


def _scalar(hint: Any, value: Any, where: str) -> Any:
    if get_origin(hint) is Literal:
        options = get_args(hint)
        _expect(value in options, where, value, " or ".join(map(repr, options)))
    elif hint is float:
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        _expect(is_number and math.isfinite(value), where, value, "a finite number")
        return float(value)
    elif hint is not Any:
        _expect(type(value) is hint, where, value, f"a value of type {hint.__name__}")
    return value


def _read(plain: Any, view: Any, reader: _Reader) -> tuple[Document, dict[str, FloatArray]]:
    plain = {name: part for name, part in plain.items() if name != "format_version"}
    header: _Header = reader.read(_Header, plain, "project")
    _expect(header.kind in KINDS, "project.kind", header.kind, " or ".join(KINDS))
    content = header.document | {"view": view}
    document: Document = reader.read(KINDS[header.kind], content, "project.document")
    names: dict[str, Any] = dict(header.known)
    known = {}
    for side in SIDES[-len(document.surfaces) :]:
        sizes = {"V": len(document.surface(side).mesh.vertices)}
        for spec, name in document.values_on(side, names).items():
            array = reader.array(_KNOWN, name, f"the values of {spec}", sizes)
            known[document.values_key(side, spec)] = array
    _check(document)
    return document, known


def _check(document: Document) -> None:
    result, initial = document.result, document.initial_map
    meshes = [surface.mesh for surface in document.surfaces]
    count = document.surface_count
    _require(len(meshes) == count, f"it has {len(meshes)} surfaces; expected {count}")
    is_on = result is None or result.mesh is meshes[-1]
    _require(is_on, "the result is on another surface")
    if initial is not None:
        _require(result is not None, "it has an initial map but no result")
        ends = initial.correspondence.a, initial.correspondence.b
        is_between = ends[0] is meshes[0] and ends[1] is meshes[-1]
        _require(is_between, "the initial map is not between the surfaces of the project")
    for number, run in enumerate(document.runs):
        _check_run(run, f"run {number} of {run.stages.size} rows")
    if document.labels is not None:
        _check_labels(document.labels, document.surface("source"))
    for function in document.functions:
        terms_from_files(function.spec)
    _within("channel", document.channel, 0, document.channel_count - 1)
    document.check()
    _within("time", document.time, document.start or 0, document.end)
    _check_points(document, "target", *document.lines, *document.points)
    for landmark in document.landmarks + (initial.request.landmarks if initial else ()):
        for side in SIDES:
            if (point := landmark.point(side)) is not None:
                _check_points(document, side, point)
    view, viewpoint = document.view, document.view.viewpoint
    colormaps = ("automatic", *NAMES)
    _expect(view.colormap in colormaps, "colormap", view.colormap, " or ".join(colormaps))
    fronts = [surface.front for surface in document.surfaces]
    for front in (*fronts, viewpoint.front if viewpoint else None):
        axes = np.eye(3)[:2] if front is None else np.array([front.direction, front.up])
        is_upright = bool(np.allclose(axes @ axes.T, np.eye(2), atol=1e-6))
        _require(is_upright, f"front is {front}; expected two unit vectors at a right angle")


def _check_run(run: RunRecord, name: str) -> None:
    rows = len(run.stages)
    inside = all(0 <= row <= rows for row in run.restarts)
    _require(inside, f"{name} has restarts {list(run.restarts)}; expected iterations 0 to {rows}")
    for part in ("vertices", "reaches", "residuals", "sigmas", "shares", "attempts"):
        count = len(getattr(run, part))
        _require(count in (0, rows), f"{name} has {count} {part}")
    shares = run.shares.shape[1]
    named = not run.term_names or shares == len(run.term_names)
    _require(named, f"{name} has energies of {shares} terms but {len(run.term_names)} names")


def _check_labels(labels: LabelMap, surface: Surface) -> None:
    counts = {len(labels.keys), len(labels.names), len(labels.colors)}
    _require(len(counts) == 1, "the labels have different numbers of keys, names and colours")
    keys = np.array(labels.keys, dtype=np.int64)
    _require(bool((np.diff(keys) > 0).all()), "the keys of the labels are not in ascending order")
    values, vertices = len(labels.values), len(surface.mesh.vertices)
    _require(values == vertices, f"it has {values} labels; expected {vertices}")
    _require(
        bool(np.isin(labels.values, keys).all()),
        "vertices have labels that are not in the list of keys",
    )
    inside = all(0 <= channel <= 1 for color in labels.colors for channel in color)
    _require(inside, "the labels have colours outside 0 to 1")


def _check_points(document: Document, side: Side, *points: Point) -> None:
    F = len(document.surface(side).mesh.faces)
    for point in points:
        inside = min(point.barycentric) >= -1e-9 and abs(sum(point.barycentric) - 1) <= 1e-9
        _require(0 <= point.face < F, f"a point lies on face {point.face}; expected 0 to {F - 1}")
        _require(inside, f"a point has weights {point.barycentric}; expected 0 or more, with sum 1")


def _within(name: str, value: float, low: float, high: float) -> None:
    _require(low <= value <= high, f"{name} is {value}; expected {low} to {high}")


def _require(fits: bool, problem: str) -> None:
    if not fits:
        raise ValueError(problem)


def _expect(fits: bool, where: str, value: Any, expected: str) -> None:
    if not fits:
        raise ValueError(f"{where} is {brief(value)}; expected {expected}")


def _state(path: Path) -> tuple[int, int]:
    try:
        found = path.stat()
    except (OSError, ValueError):
        return 0, -1
    return found.st_mtime_ns, found.st_size
