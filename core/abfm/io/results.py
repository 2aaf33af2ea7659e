"""Result files: ``.npz`` files of plain arrays without pickles.

Project files use the same functions for the arrays in their zip. All arrays are checked before they
are written, and each array is checked when it is read.
"""

import math
import os
import zipfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from functools import partial
from typing import Any, NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from abfm.errors import ResultError, brief, one_line, printable
from abfm.io.atomic import write_atomically
from abfm.mesh import TriangleMesh
from abfm.mesh.draft import NO_COPIES, FileNumbers
from abfm.reading import Archive, from_json, open_regular
from abfm.types import File
from abfm.workers.control import CancelledError

FORMAT_VERSION = 3  # version of the format of result files
REMEDY = "Compute the result again, or use another copy of the file"
SIZE_MAX = 1e154
"""Largest value of functions, and of fields in units of ``length_scale``; larger squares overflow.
"""
# largest number of vertices of the mesh file that no face uses; vertex maps have a line for each
_DROPPED_VERTICES_MAX = 10_000_000
_REASON_LENGTH_MAX = 400  # largest number of characters of a reason in a message
_TEXT_LENGTH_MAX = 10_000  # largest number of characters of a text in a file
_FILE_BYTES_MAX = 1 << 40  # results of thousands of frames exceed the limit for other files
_KINDS: dict[str, tuple[str, Any]] = {
    "real": ("fiu", np.float64),
    "single": ("fiu", np.float32),
    "integer": ("iu", np.int64),
    "boolean": ("b", np.bool_),
    "text": ("U", np.str_),
}

Loaded = TypeVar("Loaded")
Path = str | os.PathLike[str]
Arrays = Mapping[str, NDArray[Any]]
Parts = Mapping[str, Callable[[], Mapping[str, Any]]]
"""Functions that return the arrays of a file, by the names of parts, each usable on its own."""


class Entry(NamedTuple):
    """Expected type, shape and range of an array in a file.

    A word in shapes, such as ``"V"``, is a size that is equal in all arrays.
    """

    kind: str
    shape: tuple[str | int, ...]
    required: bool = True
    may_be_empty: bool = False
    low: float = -math.inf
    high: float = math.inf
    allow_missing: bool = False  # whether values may be NaN
    is_mapped: bool = False  # whether it is memory-mapped, as it may be larger than the memory

    def check(self, name: str, array: NDArray[Any], sizes: dict[str, int]) -> NDArray[Any]:
        """Check an array, and return it in the type of the entry; ValueError if it is invalid.

        ``sizes`` has the known sizes by word. The sizes of this array are added.
        """
        kinds, dtype = _KINDS[self.kind]
        if array.dtype.kind not in kinds:
            raise ValueError(f"{name} has type {array.dtype}; expected {self.kind} values")
        shape = tuple(sizes.get(str(size), size) for size in self.shape)
        agrees = array.ndim == len(shape) and all(
            isinstance(size, str) or size == count
            for size, count in zip(shape, array.shape, strict=True)
        )
        if not agrees or (array.size == 0 and not self.may_be_empty):
            expected = ", ".join(map(str, shape))
            raise ValueError(f"{name} has shape {array.shape}; expected ({expected})")
        named = zip(self.shape, array.shape, strict=True)
        sizes |= {word: count for word, count in named if isinstance(word, str)}
        if array.size:
            self._check_values(name, array)
        return array.astype(dtype, order="C", copy=False)

    def _check_values(self, name: str, array: NDArray[Any]) -> None:
        if self.kind == "text":
            if not all(len(text) <= _TEXT_LENGTH_MAX and text.isprintable() for text in array.flat):
                limit = f"more than {_TEXT_LENGTH_MAX} characters, or unprintable ones"
                raise ValueError(f"{name} has {limit}")
            return
        # without copies, as arrays may be larger than the memory
        smallest, largest = (np.fmin, np.fmax) if self.allow_missing else (np.minimum, np.maximum)
        ends = [each.reduce(array, axis=None) for each in (smallest, largest)]
        if self.allow_missing and np.isnan(ends).all():
            return
        if self.kind in ("real", "single") and not np.isfinite(ends).all():
            raise ValueError(f"{name} has values that are not finite")
        for value in ends:
            if not self.low <= value.item() <= self.high:
                bounds = f"{self.low:g} to {self.high:g}"
                raise ValueError(f"{name} has the value {value:g}; expected {bounds}")
        if self.kind == "integer" and array.max() > np.iinfo(np.int64).max:
            raise ValueError(f"{name} has values that do not fit in 64 bits with a sign")


MESH_ENTRIES = {
    "vertices": Entry("real", ("V", 3)),
    "faces": Entry("integer", ("F", 3)),
    "vertex_ids": Entry("integer", ("V",)),
    "file_vertex_count": Entry("integer", (), low=1),
    # vertices of the mesh file that were merged, and the vertices that they were merged into
    "copies": Entry("integer", ("copied", 2), required=False, may_be_empty=True, low=0),
    "structure": Entry("text", (), required=False),
    "file_name": Entry("text", (), required=False),  # of the mesh file, without its folder
}
MESH_NAMES = "structure", "file_name"  # entries that do not change any result
_FUNCTION = Entry("real", ("V", "C"), low=-SIZE_MAX, high=SIZE_MAX)
_FUNCTIONS = {"source": _FUNCTION, "target": _FUNCTION}
_DATA = {
    "parameters": Entry("text", ()),
    "channels_given": Entry("boolean", ()),  # False if f and g have shape (V,) instead of (V, C)
    "mask": Entry("real", ("V",), required=False, low=0),
    "approximate": Entry("boolean", (), required=False),  # whether functions match only roughly
    # the last one is required, as a damaged directory of a zip can hide the last entry
    "weights": Entry("real", ("C",), low=0),
}
_START = {"start": Entry("real", ("M", "S", 3), required=False)}
SPEC_ENTRIES = {
    name: Entry("text", ("C",), required=False) for name in ("source_specs", "target_specs")
}
LANDMARK_ENTRIES = {
    # the face of each landmark and of its target
    "landmark_faces": Entry("integer", ("L", 2), required=False, low=0),
    "landmark_barycentric": Entry("real", ("L", 2, 3), required=False),
    "landmark_weights": Entry("real", ("L",), required=False, low=0),
}
PROBLEM_ENTRIES = MESH_ENTRIES | _FUNCTIONS | _START | SPEC_ENTRIES | LANDMARK_ENTRIES | _DATA
_MATCH = {
    "advected": _FUNCTION,
    "velocity": Entry("real", ("N", "F", 3)),
    # the field on the subdivided mesh, if the match was refined
    "fine_velocity": Entry("real", ("N", "D", 3), required=False),
    "energy_history": Entry("real", ("I", 3)),
    "stages": Entry("integer", ("I",), low=0),
    "residual": Entry("real", (), low=0),
    "stop_reason": Entry("text", ()),
    "verified_residual": Entry("real", (), required=False, low=0),
    "folded": Entry("real", (), required=False, low=0, high=1),
    "landmark_errors": Entry("real", ("L",), required=False, low=0),  # in sqrt(area)
    "verdict": Entry("text", (4,)),  # outcome, cause, reason, advice
    "remedies": Entry("text", (), required=False),
    # bound of |log2 J| and |log2 R|, share of faces within it, 99th percentile, folded faces
    "bound": Entry("real", (4,), required=False, low=0),
    # the columns of `abfm.matching.path.COLUMNS`
    "path_steps": Entry("real", ("S", 13), required=False, low=0, allow_missing=True),
    "path_step": Entry("integer", (), required=False, low=0),  # index of the step of the match
    # the number of fields of each step, if these differ
    "path_fields": Entry("integer", ("S",), required=False, low=1, high=1e6),
    # Fields of the other steps in units of length_scale, concatenated along the second axis, (N, P,
    # 3). If their numbers differ, all are in one row, (1, P, 3). Squares of larger values overflow.
    "path_velocity": Entry("single", ("R", "P", 3), required=False, low=-1e30, high=1e30),
}
MATCH_ENTRIES = _FUNCTIONS | _MATCH | SPEC_ENTRIES | LANDMARK_ENTRIES | _DATA


class FileKind(NamedTuple):
    """A kind of file: its name in messages, and the arrays that it contains."""

    name: str
    entries: Mapping[str, Entry]


RESULT = FileKind("result file", MESH_ENTRIES | MATCH_ENTRIES)
_OTHER_MESH = {  # surface A of two; surface B has the names of a single surface
    f"a_{name}": entry._replace(
        shape=tuple(f"{size}A" if isinstance(size, str) else size for size in entry.shape)
    )
    for name, entry in MESH_ENTRIES.items()
}
_CORRESPONDENCE = {
    # the directions of the vertices, if both surfaces are embedded in one sphere
    "a_sphere": Entry("real", ("VA", 3), required=False),
    "sphere": Entry("real", ("V", 3), required=False),
    # points of A for the vertices of B, and points of B for the vertices of A
    "image_faces": Entry("integer", ("V",), low=0),
    "image_barycentric": Entry("real", ("V", 3), low=-1e-9, high=1 + 1e-8),
    "back_faces": Entry("integer", ("VA",), low=0),
    "back_barycentric": Entry("real", ("VA", 3), low=-1e-9, high=1 + 1e-8),
    # candidates of the initial map, the chosen one first
    "candidates": Entry("text", ("Z",), required=False),
    "candidate_costs": Entry("real", ("Z",), required=False, allow_missing=True),
}
CORRESPONDENCE_ENTRIES = _OTHER_MESH | _CORRESPONDENCE
CORRESPONDENCE = FileKind("correspondence file", MESH_ENTRIES | CORRESPONDENCE_ENTRIES)
_MAP_ENTRIES = {
    "notes": Entry("text", ("K",), required=False),
    "warnings": Entry("text", ("W",), required=False),
    "registration_verdict": Entry("text", (4,), required=False),  # parts like those of `verdict`
    "a_functions": Entry("real", ("VA", "C"), required=False),  # functions compared with those of B
}
REGISTRATION = FileKind(
    "registration file", {**RESULT.entries, **CORRESPONDENCE_ENTRIES, **_MAP_ENTRIES}
)
PROBLEM = FileKind("problem file", PROBLEM_ENTRIES)
_SEQUENCE = {
    "frames": Entry("real", ("T", "V", "C"), low=-SIZE_MAX, high=SIZE_MAX),
    "times": Entry("real", ("T",)),
    "numbers": Entry("integer", ("T",), low=0),
    "unit_of_time": Entry("text", ()),
    "velocity": Entry("real", ("I", "F", 3)),
    "parameters": Entry("text", ()),
    "channels_given": Entry("boolean", ()),
    "mask": Entry("real", ("V",), required=False, low=0),
    "gamma": Entry("real", (), low=0),
    "sigma": Entry("real", (), low=0, allow_missing=True),
    "noise": Entry("real", (), low=0),
    "motion_share": Entry("real", (), low=0, high=1, allow_missing=True),
    "has_motion": Entry("boolean", ()),
    "notes": Entry("text", ("K",), required=False),
    "energies": Entry("real", ("I", 2, 3), allow_missing=True),
    "residual": Entry("real", ("I",), low=0, allow_missing=True),
    "verified_residual": Entry("real", ("I",), low=0, allow_missing=True),
    "folded": Entry("real", ("I",), low=0, high=1, allow_missing=True),
    "verdicts": Entry("text", ("I", 4)),  # rows like `verdict` of a match
    "weights": Entry("real", ("C",), low=0),
}
SEQUENCE = FileKind("sequence file", MESH_ENTRIES | _SEQUENCE)


@contextmanager
def open_archive(path: File, what: str, remedy: str) -> Iterator[Archive]:
    """Open a zip for reading; convert all errors to a ResultError.

    Its message has the expected kind of file, ``what``, and the ``remedy``.
    """
    name = name_of(path)
    try:
        with _opened(path, partial(open_regular, size_max=_FILE_BYTES_MAX)) as file:
            yield Archive(file)
    except ResultError as error:
        raise ResultError(f"{name}: {one_line(error, _REASON_LENGTH_MAX)}") from error
    except OSError as error:
        raise ResultError(
            f"cannot read {name}: {one_line(error)}. Check the path and its permissions"
        ) from error
    # damaged files can cause any error in the readers of zips and JSON
    except Exception as error:
        is_of_python = isinstance(error, TypeError | AttributeError | IndexError | ArithmeticError)
        reason = (
            "its parts do not fit together" if is_of_python else one_line(error, _REASON_LENGTH_MAX)
        )
        raise ResultError(
            f"{name} is not a {what} of abfm, or is damaged or cut off ({reason}). {remedy}"
        ) from error


def _opened(
    path: File, of_path: Callable[[Path], AbstractContextManager[Any]]
) -> AbstractContextManager[Any]:
    return of_path(path) if isinstance(path, str | os.PathLike) else nullcontext(path)


def name_of(path: File) -> str:
    name = path if isinstance(path, str | os.PathLike) else getattr(path, "name", "the result")
    return one_line(name)


def check_version(version: object, current: int = FORMAT_VERSION) -> None:
    """Raise a ResultError unless the format version of a file is ``current``.

    Raises ValueError if the version is not a positive integer.
    """
    if type(version) is not int or version < 1:
        raise ValueError(f"format_version is {brief(version)}; expected {current}")
    if version != current:
        is_newer = version > current
        remedy = "Upgrade abfm" if is_newer else "Solve again, as formats before 0.1.0 are not read"
        raise ResultError(
            f"the file has format {version}, but this version of abfm reads format {current}. "
            f"{remedy}"
        )


def pieces(arrays: Arrays) -> Iterator[bytes | memoryview]:
    """Yield the names and values of arrays as bytes for a digest, the same on every computer."""
    for name, value in sorted(arrays.items()):
        array = np.ascontiguousarray(value, value.dtype.newbyteorder("<"))
        yield f"{name} {array.dtype.str} {value.shape}\n".encode()
        yield array.reshape(-1).view(np.uint8).data


def write_arrays(archive: zipfile.ZipFile, arrays: Arrays) -> None:
    """Write each array into a zip as ``name.npy``; equal arrays give equal bytes."""
    for name, array in arrays.items():
        with archive.open(zipfile.ZipInfo(f"{name}.npy"), "w", force_zip64=True) as file:
            np.save(file, array, allow_pickle=False)


def check_arrays(
    arrays: Mapping[str, Any], entries: Mapping[str, Entry], prefix: str = "", **sizes: int
) -> dict[str, NDArray[Any]]:
    """Check arrays by their entries; return them by the names of the entries, in their types.

    The names in ``arrays`` begin with ``prefix``. ``sizes`` are known sizes by the words in shapes.
    Raises ValueError if a required array is missing, or an array is invalid.
    """
    places = {name: f"{prefix}{name}" for name in entries}
    missing = [
        place for name, place in places.items() if entries[name].required and place not in arrays
    ]
    if missing:
        raise ValueError(f"arrays are missing: {', '.join(missing)}")
    found = dict[str, NDArray[Any]]()
    for name, place in places.items():
        if place in arrays:
            if isinstance(arrays, Archive) and entries[name].is_mapped:
                array = arrays.mapped(place)
            else:
                array = np.asarray(arrays[place])
            found[name] = entries[name].check(place, array, sizes)
    return found


def save_arrays(path: File, arrays: Mapping[str, Any], kind: FileKind = RESULT) -> None:
    """Check and write the arrays of a file and its format version; equal arrays give equal bytes.

    Raises
    ------
    ResultError
        If the arrays could not be loaded again, or the file cannot be written.
    """
    unknown = sorted(arrays.keys() - kind.entries.keys())
    if unknown:
        raise ResultError(
            f"{name_of(path)}: a {kind.name} cannot store {', '.join(unknown)}; expected only "
            f"{', '.join(kind.entries)}"
        )
    try:
        checked = _checked(arrays, kind)
    except ValueError as error:
        reason = one_line(error, _REASON_LENGTH_MAX)
        raise ResultError(
            f"{name_of(path)}: the file was not written: {reason}. Compute the result again"
        ) from error
    with _opened(path, write_atomically) as file, zipfile.ZipFile(file, "w") as archive:
        write_arrays(archive, {"format_version": np.array(FORMAT_VERSION), **checked})


def all_arrays(parts: Parts) -> dict[str, Any]:
    return {name: array for make in parts.values() for name, array in make().items()}


def save_parts(
    path: Path, parts: Parts, substitutes: Mapping[str, Any], kind: FileKind = RESULT
) -> tuple[str, ...]:
    """Write all parts that can be computed and loaded again; return a line for each missing part.

    A line has the name of a part and the reason why it is missing. ``substitutes`` replace required
    arrays of missing parts. Raises ResultError if a required array without a substitute is missing,
    or the file cannot be written.
    """
    arrays: dict[str, Any] = {}
    sizes: dict[str, int] = {}
    missing = []
    for part, make in parts.items():
        new_sizes = dict(sizes)
        try:
            of_part = {
                name: kind.entries[name].check(name, np.asarray(array), new_sizes)
                for name, array in make().items()
            }
        except Exception as error:  # the other parts are saved, whatever the error
            missing.append(f"{part} ({one_line(error, _REASON_LENGTH_MAX)})")
        else:
            arrays |= of_part
            sizes = new_sizes
    save_arrays(path, {**substitutes, **arrays}, kind)
    return tuple(missing)


class Saved(Protocol):
    """A result that can be saved to a file."""

    def save(self, path: Path) -> None: ...

    def save_parts(self, path: Path) -> tuple[str, ...]: ...


def save_with_fallback(path: Path, found: Saved) -> str:
    """Save a result, or those parts of it that can be saved.

    Return a line with the missing parts and the reasons, or an empty one. If the required parts
    cannot be saved, the error of the method ``save`` is raised.
    """
    try:
        found.save(path)
    except CancelledError:
        raise
    except Exception:
        with suppress(Exception):
            missing = "; ".join(found.save_parts(path))
            return f"{one_line(path)} was saved without {missing}" if missing else ""
        raise
    return ""


def load_arrays(path: File, kind: FileKind = RESULT) -> dict[str, NDArray[Any]]:
    """Read and check the arrays of a file as float64, float32, int64, bool or unicode.

    Raises
    ------
    ResultError
        If the file is missing, damaged, not a result, or from another version. Also if an array is
        missing, or has a wrong shape, type or value.
    """
    with open_archive(path, kind.name, REMEDY) as archive:
        version = archive.get("format_version")
        check_version(version.item() if version is not None and version.ndim == 0 else version)
        others = {"frames", "subject_weights"} - kind.entries.keys()
        is_map = "a_vertices" in archive and "velocity" not in archive
        if others & archive.keys() or (is_map and "velocity" in kind.entries):
            raise ResultError("the file has another kind of result. `abfm info` describes it")
        return _checked(archive, kind)


def loaded(path: File, kind: FileKind, make: Callable[[dict[str, NDArray[Any]]], Loaded]) -> Loaded:
    """Load the arrays of a file, and return ``make(arrays)``; ResultError if either step fails."""
    arrays = load_arrays(path, kind)
    try:
        return make(arrays)
    except Exception as error:  # invalid texts, numbers or lists may cause any error
        reason = one_line(error, _REASON_LENGTH_MAX)
        raise ResultError(f"{name_of(path)}: {reason}. {REMEDY}") from error


def _checked(arrays: Mapping[str, Any], kind: FileKind) -> dict[str, NDArray[Any]]:
    checked = check_arrays(arrays, kind.entries)
    for prefix in ("", "a_"):
        if f"{prefix}faces" in checked:
            _check_indices(checked, prefix)
    if "parameters" in kind.entries:
        _check_parameters(str(checked["parameters"]))
    return checked


def mesh_arrays(mesh: TriangleMesh) -> dict[str, Any]:
    arrays = {name: getattr(mesh, name) for name in MESH_ENTRIES}
    if not len(mesh.copies):
        del arrays["copies"]
    for name in MESH_NAMES:
        if text := arrays.pop(name):
            arrays[name] = printable(text)
    return arrays


def mesh_of(arrays: Arrays, prefix: str = "") -> TriangleMesh:
    """Return the mesh of arrays whose names have a prefix; ValueError if the mesh needs repairs."""
    _check_indices(arrays, prefix)
    vertices, faces, ids, total, copies = _of_mesh(arrays, prefix)
    count = int(total)
    if count - len(ids) > _DROPPED_VERTICES_MAX:
        raise ValueError(
            f"the mesh uses only {len(ids)} of the {count} vertices of its file; at most "
            f"{_DROPPED_VERTICES_MAX} vertices may be unused"
        )
    structure, file_name = (arrays.get(f"{prefix}{name}") for name in MESH_NAMES)
    mesh = TriangleMesh(
        vertices,
        faces,
        numbers=FileNumbers(ids, count, copies),
        structure=None if structure is None else str(structure),
        file_name="" if file_name is None else str(file_name),
    )
    if not (np.array_equal(mesh.vertex_ids, ids) and np.array_equal(mesh.faces, faces)):
        raise ValueError(f"the mesh needs repairs: {' '.join(mesh.messages)}")
    return mesh


def _of_mesh(arrays: Arrays, prefix: str) -> list[NDArray[Any]]:
    names = [name for name in MESH_ENTRIES if name not in MESH_NAMES]
    return [arrays.get(f"{prefix}{name}", NO_COPIES) for name in names]


def _check_indices(arrays: Arrays, prefix: str = "") -> None:
    vertices, faces, ids, total, copies = _of_mesh(arrays, prefix)
    count = len(vertices)
    for name, numbers, limit in (("faces", faces, count), ("vertex_ids", ids, int(total))):
        if numbers.min() < 0 or numbers.max() >= limit:
            raise ValueError(f"{prefix}{name} has an index outside 0 to {limit - 1}")
    if (np.diff(ids) <= 0).any():
        raise ValueError(f"{prefix}vertex_ids are not in ascending order")
    merged, targets = copies.T
    if (np.diff(merged) <= 0).any() or (merged >= total).any() or np.isin(merged, ids).any():
        raise ValueError(
            f"{prefix}copies are not in ascending order, or have vertices that were not merged"
        )
    if not np.isin(targets, ids).all():
        raise ValueError(f"{prefix}copies were merged into vertices that do not exist")
    unused = np.count_nonzero(np.bincount(faces.ravel(), minlength=count) == 0)
    if unused:
        raise ValueError(f"the mesh needs repairs: no face uses {unused} of its {count} vertices")


def _check_parameters(text: str) -> None:
    try:
        parameters = from_json(text)
    except ValueError as error:
        raise ValueError(f"parameters: {error}") from None
    if not isinstance(parameters, dict) or dict in map(type, parameters.values()):
        raise ValueError("the parameters are not a flat JSON object")
