"""Result files, one ``.npz`` of plain arrays, no pickles; and what projects share with them: arrays
in a zip, checked whole when written, and each when it is asked for.
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

from abfm.errors import ResultError, brief, one_line
from abfm.io.atomic import write_atomically
from abfm.mesh import TriangleMesh
from abfm.mesh.draft import NO_COPIES, FileNumbers
from abfm.reading import Archive, from_json, open_regular
from abfm.types import File
from abfm.workers.control import CancelledError

FORMAT_VERSION = 3
"""Of result files and of projects."""
MEND = "match again and save, or take another copy of the file"
SIZE_MAX = 1e154
"""Of functions and, in lengths of the mesh, of fields: squares of more overflow, so no match was
made of them.
"""
# vertices of the mesh file that no face uses: maps to its vertices have a line for each
_DROPPED_VERTICES_MAX = 10_000_000
# characters
_REASON_MAX = 400
_TEXT_LENGTH_MAX = 10_000
# bytes of files of abfm's own: those of thousands of frames are larger than any that others make
_LARGEST_FILE = 1 << 40
_KINDS: dict[str, tuple[str, Any]] = {
    "real": ("fiu", np.float64),
    "single": ("fiu", np.float32),
    "integer": ("iu", np.int64),
    "boolean": ("b", np.bool_),
    "text": ("U", np.str_),
}

Made = TypeVar("Made")
Path = str | os.PathLike[str]
Arrays = Mapping[str, NDArray[Any]]
Parts = Mapping[str, Callable[[], Mapping[str, Any]]]
"""What makes the arrays of a file, in parts that are of use without the others, by their names."""


class Entry(NamedTuple):
    """An array of a file; a word in its shape stands for a size that all agree on."""

    kind: str
    shape: tuple[str | int, ...]
    required: bool = True
    may_be_empty: bool = False
    low: float = -math.inf
    high: float = math.inf
    allow_missing: bool = False  # NaN
    is_mapped: bool = False  # it may be larger than the memory, and stays in the file

    def check(self, name: str, array: NDArray[Any], sizes: dict[str, int]) -> NDArray[Any]:
        """Return an array in its own type; ``sizes`` holds what was fixed before, and learns."""
        kinds, dtype = _KINDS[self.kind]
        if array.dtype.kind not in kinds:
            raise ValueError(f"{name} has type {array.dtype}; expected {self.kind} values")
        known = tuple(sizes.get(str(size), size) for size in self.shape)
        agrees = array.ndim == len(known) and all(
            isinstance(size, str) or size == given
            for size, given in zip(known, array.shape, strict=True)
        )
        if not agrees or (array.size == 0 and not self.may_be_empty):
            expected = ", ".join(map(str, known))
            raise ValueError(f"{name} has shape {array.shape}; expected ({expected})")
        named = zip(self.shape, array.shape, strict=True)
        sizes |= {word: given for word, given in named if isinstance(word, str)}
        if array.size:
            self._check_values(name, array)
        return array.astype(dtype, order="C", copy=False)

    def _check_values(self, name: str, array: NDArray[Any]) -> None:
        if self.kind == "text":
            if not all(len(text) <= _TEXT_LENGTH_MAX and text.isprintable() for text in array.flat):
                limit = f"more than {_TEXT_LENGTH_MAX} characters, or some that cannot be shown"
                raise ValueError(f"{name} has {limit}")
            return
        # without copies of arrays that may be larger than the memory
        least, most = (np.fmin, np.fmax) if self.allow_missing else (np.minimum, np.maximum)
        ends = [each.reduce(array, axis=None) for each in (least, most)]
        if self.allow_missing and np.isnan(ends).all():
            return
        if self.kind in ("real", "single") and not np.isfinite(ends).all():
            raise ValueError(f"{name} has values that are not finite")
        for value in ends:
            if not self.low <= value.item() <= self.high:
                bounds = f"{self.low:g} to {self.high:g}"
                raise ValueError(f"{name} has the value {value:g}; expected {bounds}")
        if self.kind == "integer" and array.max() > np.iinfo(np.int64).max:
            raise ValueError(f"{name} has values beyond those of 64 bits with a sign")


MESH_ENTRIES = {
    "vertices": Entry("real", ("V", 3)),
    "faces": Entry("integer", ("F", 3)),
    "vertex_ids": Entry("integer", ("V",)),
    "file_vertex_count": Entry("integer", (), low=1),
    # vertices of the file that were merged, and what they became
    "copies": Entry("integer", ("copied", 2), required=False, may_be_empty=True, low=0),
    "structure": Entry("text", (), required=False),
}
_FUNCTION = Entry("real", ("V", "C"), low=-SIZE_MAX, high=SIZE_MAX)
_FUNCTIONS = {"source": _FUNCTION, "target": _FUNCTION}
_DATA = {
    "parameters": Entry("text", ()),
    "channels_given": Entry("boolean", ()),  # False: f and g were (V,), and come back so
    "mask": Entry("real", ("V",), required=False, low=0),
    "approximate": Entry("boolean", (), required=False),  # functions are only alike
    # the last one is required: damage to a zip's directory can hide the last entry
    "weights": Entry("real", ("C",), low=0),
}
_START = {"start": Entry("real", ("M", "S", 3), required=False)}
SPEC_ENTRIES = {
    name: Entry("text", ("C",), required=False) for name in ("source_specs", "target_specs")
}
LANDMARK_ENTRIES = {
    # of each landmark, and of where it is wanted
    "landmark_faces": Entry("integer", ("L", 2), required=False, low=0),
    "landmark_barycentric": Entry("real", ("L", 2, 3), required=False),
    "landmark_weights": Entry("real", ("L",), required=False, low=0),
}
PROBLEM_ENTRIES = MESH_ENTRIES | _FUNCTIONS | _START | SPEC_ENTRIES | LANDMARK_ENTRIES | _DATA
_MATCH = {
    "advected": _FUNCTION,
    "velocity": Entry("real", ("N", "F", 3)),
    # on the subdivided mesh, where the match was refined
    "fine_velocity": Entry("real", ("N", "D", 3), required=False),
    "energy_history": Entry("real", ("I", 3)),
    "stages": Entry("integer", ("I",), low=0),
    "residual": Entry("real", (), low=0),
    "stop_reason": Entry("text", ()),
    "verified_residual": Entry("real", (), required=False, low=0),
    "folded": Entry("real", (), required=False, low=0, high=1),
    "landmark_errors": Entry("real", ("L",), required=False, low=0),  # of sqrt(area)
    "verdict": Entry("text", (4,)),  # outcome, cause, reason, advice
    "remedies": Entry("text", (), required=False),
    # largest |log2 J| and |log2 R|, share of the faces within it, what 99% are within, folded faces
    "bound": Entry("real", (4,), required=False, low=0),
    # the columns of `abfm.matching.path.COLUMNS`
    "path_steps": Entry("real", ("S", 13), required=False, low=0, allow_missing=True),
    "path_step": Entry("integer", (), required=False, low=0),  # which of them the match is
    # the number of fields of each step, if these differ
    "path_fields": Entry("integer", ("S",), required=False, low=1, high=1e6),
    # the others' fields in lengths of the mesh, side by side, (N, P, 3); one after another,
    # (1, P, 3), if their numbers differ. Squares of larger values overflow
    "path_velocity": Entry("single", ("R", "P", 3), required=False, low=-1e30, high=1e30),
}
MATCH_ENTRIES = _FUNCTIONS | _MATCH | SPEC_ENTRIES | LANDMARK_ENTRIES | _DATA


class FileKind(NamedTuple):
    """What a file is called, and which arrays it holds."""

    name: str
    entries: Mapping[str, Entry]


RESULT = FileKind("result file", MESH_ENTRIES | MATCH_ENTRIES)
_OTHER_MESH = {  # surface A of two; B has the names of the only one
    f"a_{name}": entry._replace(
        shape=tuple(f"{size}A" if isinstance(size, str) else size for size in entry.shape)
    )
    for name, entry in MESH_ENTRIES.items()
}
_CORRESPONDENCE = {
    # the directions of the vertices, where both surfaces are laid out on one sphere
    "a_sphere": Entry("real", ("VA", 3), required=False),
    "sphere": Entry("real", ("V", 3), required=False),
    # where on A the vertices of B lie, and those of A on B
    "image_faces": Entry("integer", ("V",), low=0),
    "image_barycentric": Entry("real", ("V", 3), low=-1e-9, high=1 + 1e-8),
    "back_faces": Entry("integer", ("VA",), low=0),
    "back_barycentric": Entry("real", ("VA", 3), low=-1e-9, high=1 + 1e-8),
    # initial maps that were tried, the chosen one first
    "candidates": Entry("text", ("Z",), required=False),
    "candidate_costs": Entry("real", ("Z",), required=False, allow_missing=True),
}
CORRESPONDENCE_ENTRIES = _OTHER_MESH | _CORRESPONDENCE
CORRESPONDENCE = FileKind("correspondence file", MESH_ENTRIES | CORRESPONDENCE_ENTRIES)
# the initial map, and the match on B
_MAP_ENTRIES = {
    "notes": Entry("text", ("K",), required=False),
    "warnings": Entry("text", ("W",), required=False),
    "registration_verdict": Entry("text", (4,), required=False),  # as `verdict`
    "a_functions": Entry("real", ("VA", "C"), required=False),  # as they are compared
}
REGISTRATION = FileKind(
    "registration file", {**RESULT.entries, **CORRESPONDENCE_ENTRIES, **_MAP_ENTRIES}
)
PROBLEM = FileKind("problem file", PROBLEM_ENTRIES)
_SEQUENCE = {
    "frames": Entry("real", ("T", "V", "C"), low=-SIZE_MAX, high=SIZE_MAX),
    "times": Entry("real", ("T",)),
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
    "verdicts": Entry("text", ("I", 4)),  # as of a match
    "weights": Entry("real", ("C",), low=0),
}
SEQUENCE = FileKind("sequence file", MESH_ENTRIES | _SEQUENCE)


@contextmanager
def open_archive(path: File, what: str, cure: str) -> Iterator[Archive]:
    """Open a zip to read from; one line, with what to do, for all that goes wrong meanwhile."""
    name = name_of(path)
    try:
        with _opened(path, partial(open_regular, size_max=_LARGEST_FILE)) as file:
            yield Archive(file)
    except ResultError as error:
        raise ResultError(f"{name}: {one_line(error, _REASON_MAX)}") from error
    except OSError as error:
        reason = f"{one_line(error)}; check the path and its permissions"
        raise ResultError(f"cannot read {name}: {reason}") from error
    # damage makes anything of the readers of zips, of JSON and of what they hold
    except Exception as error:
        is_of_python = isinstance(error, TypeError | AttributeError | IndexError | ArithmeticError)
        reason = "its parts do not fit together" if is_of_python else one_line(error, _REASON_MAX)
        raise ResultError(
            f"{name}: no {what} of abfm, or damaged or cut short ({reason}); {cure}"
        ) from error


def _opened(
    path: File, of_path: Callable[[Path], AbstractContextManager[Any]]
) -> AbstractContextManager[Any]:
    """Return a file that is open, or what a function makes of its path."""
    return of_path(path) if isinstance(path, str | os.PathLike) else nullcontext(path)


def name_of(path: File) -> str:
    """Return how messages call a file."""
    known = path if isinstance(path, str | os.PathLike) else getattr(path, "name", "the result")
    return one_line(known)


def is_own(archive: Mapping[str, Any]) -> bool:
    """Tell whether an archive is one of `save_arrays`, whatever arrays others give such names."""
    return "format_version" in archive


def check_version(version: object, current: int = FORMAT_VERSION) -> None:
    """Refuse another format (ResultError), or what is no version (ValueError)."""
    if type(version) is not int or version < 1:
        raise ValueError(f"format_version is {brief(version)}; expected {current}")
    if version != current:
        cure = "upgrade abfm" if version > current else "it is of an earlier version: solve again"
        raise ResultError(f"written in format {version}; this abfm reads format {current}; {cure}")


def pieces(arrays: Arrays) -> Iterator[bytes | memoryview]:
    """Yield what names arrays by their content, the same in every process and on every machine."""
    for name, value in sorted(arrays.items()):
        array = np.ascontiguousarray(value, value.dtype.newbyteorder("<"))
        yield f"{name} {array.dtype.str} {value.shape}\n".encode()
        yield array.reshape(-1).view(np.uint8).data


def write_arrays(archive: zipfile.ZipFile, arrays: Arrays) -> None:
    """Add a member ``name.npy`` for each; the same arrays give the same bytes."""
    for name, array in arrays.items():
        with archive.open(zipfile.ZipInfo(f"{name}.npy"), "w", force_zip64=True) as file:
            np.save(file, array, allow_pickle=False)


def check_arrays(
    arrays: Mapping[str, Any], entries: Mapping[str, Entry], prefix: str = "", **sizes: int
) -> dict[str, NDArray[Any]]:
    """Return the arrays that are listed, under the prefix, in their types; or a ValueError."""
    places = {name: f"{prefix}{name}" for name in entries}
    missing = [
        place for name, place in places.items() if entries[name].required and place not in arrays
    ]
    if missing:
        raise ValueError(f"it lacks {', '.join(missing)}")
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
    """Write the arrays of its kind and ``format_version``; the same give the same bytes.

    Raises
    ------
    ResultError
        If the arrays would not load again, or the file cannot be written.
    """
    unknown = sorted(arrays.keys() - kind.entries.keys())
    if unknown:
        raise ResultError(
            f"{name_of(path)}: no place for {', '.join(unknown)} in a {kind.name}; expected "
            f"{', '.join(kind.entries)}"
        )
    try:
        checked = _checked(arrays, kind)
    except ValueError as error:
        reason = one_line(error, _REASON_MAX)
        raise ResultError(f"{name_of(path)} not written: {reason}; {MEND}") from error
    with _opened(path, write_atomically) as file, zipfile.ZipFile(file, "w") as archive:
        write_arrays(archive, {"format_version": np.array(FORMAT_VERSION), **checked})


def made(parts: Parts) -> dict[str, Any]:
    """Return the arrays of all parts."""
    return {name: array for make in parts.values() for name, array in make().items()}


def save_parts(
    path: Path, parts: Parts, substitutes: Mapping[str, Any], kind: FileKind = RESULT
) -> tuple[str, ...]:
    """Write those parts that can be made and would load again, and substitutes for required arrays
    that are in none of them; return what is missing and why, a line each.

    Raises
    ------
    ResultError
        If a required array without a substitute is missing, or the file cannot be written.
    """
    arrays: dict[str, Any] = {}
    sizes: dict[str, int] = {}
    missing = []
    for part, make in parts.items():
        known = dict(sizes)
        try:
            own = {
                name: kind.entries[name].check(name, np.asarray(array), known)
                for name, array in make().items()
            }
        except Exception as error:  # whatever is wrong with a part, the others are kept
            missing.append(f"{part} ({one_line(error, _REASON_MAX)})")
        else:
            arrays |= own
            sizes = known
    save_arrays(path, {**substitutes, **arrays}, kind)
    return tuple(missing)


class Saved(Protocol):
    """A result that has a file of its own."""

    def save(self, path: Path) -> None: ...

    def save_parts(self, path: Path) -> tuple[str, ...]: ...


def save_what_can_be(path: Path, found: Saved) -> str:
    """Save a result; if that fails, save those parts of it that can be saved, and return what is
    missing and why, in a line.

    Raises
    ------
    Exception
        As the result's ``save``, if nothing of use can be written there.
    """
    try:
        found.save(path)
    except CancelledError:
        raise
    except Exception:
        with suppress(Exception):
            missing = "; ".join(found.save_parts(path))
            return f"{one_line(path)} is without {missing}" if missing else ""
        raise
    return ""


def load_arrays(path: File, kind: FileKind = RESULT) -> dict[str, NDArray[Any]]:
    """Read the arrays of its kind, others left out: float64, int64, bool or unicode.

    Raises
    ------
    ResultError
        If the file is missing, damaged, no result, or from a newer version, or if an array is
        missing, has the wrong shape or kind, or holds values that make no sense.
    """
    with open_archive(path, kind.name, MEND) as archive:
        version = archive.get("format_version")
        check_version(version.item() if version is not None and version.ndim == 0 else version)
        others = {"frames", "subject_weights"} - kind.entries.keys()
        is_map = "a_vertices" in archive and "velocity" not in archive
        if others & archive.keys() or (is_map and "velocity" in kind.entries):
            raise ResultError("it holds another kind of result, which `abfm info` describes")
        return _checked(archive, kind)


def loaded(path: File, kind: FileKind, make: Callable[[dict[str, NDArray[Any]]], Made]) -> Made:
    """Return what is made of the arrays that a file of a kind holds.

    Raises
    ------
    ResultError
        As of `load_arrays`, or if they do not fit together.
    """
    arrays = load_arrays(path, kind)
    try:
        return make(arrays)
    except Exception as error:  # what stands in for a text, a number or a list may do anything
        raise ResultError(f"{name_of(path)}: {one_line(error, _REASON_MAX)}; {MEND}") from error


def _checked(arrays: Mapping[str, Any], kind: FileKind) -> dict[str, NDArray[Any]]:
    checked = check_arrays(arrays, kind.entries)
    for prefix in ("", "a_"):
        if f"{prefix}faces" in checked:
            _check_indices(checked, prefix)
    if "parameters" in kind.entries:
        _check_parameters(str(checked["parameters"]))
    return checked


def mesh_arrays(mesh: TriangleMesh) -> dict[str, Any]:
    """Return what files hold of a mesh."""
    arrays = {name: getattr(mesh, name) for name in MESH_ENTRIES}
    if not len(mesh.copies):
        del arrays["copies"]
    if mesh.structure is None:
        del arrays["structure"]
    return arrays


def mesh_of(arrays: Arrays, prefix: str = "") -> TriangleMesh:
    """Return the mesh of `mesh_arrays`, under a prefix; ValueError if it needs repairs."""
    _check_indices(arrays, prefix)
    vertices, faces, ids, total, copies = _of_mesh(arrays, prefix)
    count = int(total)
    if count - len(ids) > _DROPPED_VERTICES_MAX:
        raise ValueError(f"the mesh file had {count} vertices, and {len(ids)} are used")
    structure = arrays.get(f"{prefix}structure")
    mesh = TriangleMesh(
        vertices,
        faces,
        numbers=FileNumbers(ids, count, copies),
        structure=None if structure is None else str(structure),
    )
    if not (np.array_equal(mesh.vertex_ids, ids) and np.array_equal(mesh.faces, faces)):
        raise ValueError(f"the mesh needs repairs: {' '.join(mesh.messages)}")
    return mesh


def _of_mesh(arrays: Arrays, prefix: str) -> list[NDArray[Any]]:
    names = [name for name in MESH_ENTRIES if name != "structure"]
    return [arrays.get(f"{prefix}{name}", NO_COPIES) for name in names]


def _check_indices(arrays: Arrays, prefix: str = "") -> None:
    vertices, faces, ids, total, copies = _of_mesh(arrays, prefix)
    count = len(vertices)
    for name, numbers, limit in (("faces", faces, count), ("vertex_ids", ids, int(total))):
        if numbers.min() < 0 or numbers.max() >= limit:
            raise ValueError(f"{prefix}{name} has an index outside 0 to {limit - 1}")
    if (np.diff(ids) <= 0).any():
        raise ValueError(f"{prefix}vertex_ids do not ascend")
    gone, became = copies.T
    if (np.diff(gone) <= 0).any() or (gone >= total).any() or np.isin(gone, ids).any():
        raise ValueError(f"{prefix}copies do not ascend, or name vertices that are there")
    if not np.isin(became, ids).all():
        raise ValueError(f"{prefix}copies became vertices that are not there")
    unused = np.count_nonzero(np.bincount(faces.ravel(), minlength=count) == 0)
    if unused:
        raise ValueError(f"the mesh needs repairs: {unused} of its {count} vertices are in no face")


def _check_parameters(text: str) -> None:
    try:
        parameters = from_json(text)
    except ValueError as error:
        raise ValueError(f"parameters: {error}") from None
    if not isinstance(parameters, dict) or dict in map(type, parameters.values()):
        raise ValueError("parameters are not one flat JSON object")
