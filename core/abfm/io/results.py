"""Result files: one ``.npz`` of plain arrays, no pickles, checked whole when written and when read."""

from __future__ import annotations

import json
import os
import zipfile
import zlib
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from abfm.errors import ResultError
from abfm.io.atomic import write_atomically

FORMAT_VERSION = 1
MEND = "match again and save, or take another copy of the file"


class Entry(NamedTuple):
    """What an array of a result file must be; a letter stands for a size that all arrays agree on."""

    kind: str
    shape: tuple[str | int, ...]
    required: bool = True


ENTRIES = {
    "vertices": Entry("real", ("V", 3)),
    "faces": Entry("integer", ("F", 3)),
    "source": Entry("real", ("V", "C")),
    "target": Entry("real", ("V", "C")),
    "advected": Entry("real", ("V", "C")),
    "velocity": Entry("real", ("N", "F", 3)),
    "energy_history": Entry("real", ("I", 3)),
    "stages": Entry("integer", ("I",)),
    "mismatch": Entry("real", ()),
    "stop_reason": Entry("text", ()),
    "parameters": Entry("text", ()),
    "vertex_ids": Entry("integer", ("V",)),
    "file_vertex_count": Entry("integer", ()),
    "channels_given": Entry("boolean", ()),  # False: f and g were (V,), and come back so
    "mask": Entry("real", ("V",), required=False),
    "verified_mismatch": Entry("real", (), required=False),
    "folded": Entry("real", (), required=False),
    "verdict": Entry("text", (3,), required=False),
    "weights": Entry("real", ("C",)),  # the last one is required: damage to a zip's directory can hide the last entry
}
KINDS: dict[str, tuple[str, Any]] = {
    "real": ("fiu", np.float64),
    "integer": ("iu", np.int64),
    "boolean": ("b", np.bool_),
    "text": ("U", np.str_),
}


def save_arrays(path: str | os.PathLike[str], arrays: Mapping[str, Any]) -> None:
    """Write a result file with the arrays that ``ENTRIES`` lists and ``format_version``; see `load_arrays`.

    The same arrays give the same bytes.

    Raises
    ------
    ResultError
        If the arrays would not load again, or the file cannot be written.
    """
    unknown = sorted(arrays.keys() - ENTRIES.keys())
    if unknown:
        raise ResultError(f"{path}: no place for {', '.join(unknown)} in a result file; expected {', '.join(ENTRIES)}")
    try:
        checked: dict[str, Any] = _checked({name: np.asarray(value) for name, value in arrays.items()})
    except ResultError as error:
        raise ResultError(f"{path} not written: {error}") from error
    with write_atomically(path) as temporary, temporary.open("wb") as file:
        np.savez(file, format_version=np.int64(FORMAT_VERSION), **checked)


def load_arrays(path: str | os.PathLike[str]) -> dict[str, NDArray[Any]]:
    """Read a result file: the arrays that ``ENTRIES`` lists, with the shapes and kinds given there.

    Arrays that this version does not know are left out. Reals come as float64, integers as int64, text as unicode.

    Raises
    ------
    ResultError
        If the file is missing, damaged, no result, or from a newer version, or if an array is missing, has the wrong
        shape or kind, or holds values that make no sense.
    """
    try:
        with open(path, "rb") as file:
            if not zipfile.is_zipfile(file):
                raise ResultError(f"not a result file of abfm, or cut short; {MEND}")
            file.seek(0)
            with np.load(file, allow_pickle=False) as archive:
                _check_version(archive)
                return _checked({name: np.asarray(archive[name]) for name in archive.files})
    except ResultError as error:
        raise ResultError(f"{path}: {error}") from error
    except OSError as error:
        reason = error.strerror or error
        raise ResultError(f"cannot read {path}: {reason}; check the path and its permissions") from error
    except (ValueError, EOFError, KeyError, RuntimeError, MemoryError, zipfile.BadZipFile, zlib.error) as error:
        reason = " ".join(str(error).split())
        raise ResultError(f"{path}: the file is damaged ({reason}); {MEND}") from error


def _check_version(archive: Mapping[str, Any]) -> None:
    if "format_version" not in archive:
        raise ResultError(f"no array 'format_version', so not a result file of abfm; {MEND}")
    version = np.asarray(archive["format_version"])
    if version.shape != () or version.dtype.kind not in "iu" or version < 1:
        raise ResultError(f"format_version is {version}; expected a number from 1 to {FORMAT_VERSION}; {MEND}")
    if version > FORMAT_VERSION:
        raise ResultError(f"written in format {version}, and this abfm reads up to {FORMAT_VERSION}; upgrade abfm")


def _checked(arrays: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """The arrays in their own types, after every check."""
    missing = [name for name, entry in ENTRIES.items() if entry.required and name not in arrays]
    if missing:
        raise ResultError(f"the result lacks {', '.join(missing)}; {MEND}")
    sizes: dict[str, int] = {}
    checked = {name: _array(name, arrays[name], entry, sizes) for name, entry in ENTRIES.items() if name in arrays}
    for name, limit in (("faces", sizes["V"]), ("vertex_ids", int(checked["file_vertex_count"]))):
        if checked[name].min() < 0 or checked[name].max() >= limit:
            raise ResultError(f"{name} has an index outside 0 to {limit - 1}; {MEND}")
    if (np.diff(checked["vertex_ids"]) <= 0).any():
        raise ResultError(f"vertex_ids do not ascend; {MEND}")
    _check_parameters(str(checked["parameters"]))
    return checked


def _array(name: str, array: NDArray[Any], entry: Entry, sizes: dict[str, int]) -> NDArray[Any]:
    """One array in its own type; ``sizes`` holds what the arrays before it have fixed, and learns from this one."""
    kinds, dtype = KINDS[entry.kind]
    if array.dtype.kind not in kinds:
        raise ResultError(f"{name} has type {array.dtype}; expected {entry.kind} values; {MEND}")
    expected = tuple(sizes.get(size, size) if isinstance(size, str) else size for size in entry.shape)
    wanted = f"({', '.join(map(str, expected))})"
    if array.ndim != len(expected) or array.size == 0:
        raise ResultError(f"{name} has shape {array.shape}; expected {wanted}; {MEND}")
    for size, given in zip(expected, array.shape, strict=True):
        if isinstance(size, str):
            sizes[size] = given
        elif size != given:
            raise ResultError(f"{name} has shape {array.shape}; expected {wanted}; {MEND}")
    if entry.kind == "real" and not np.isfinite(array).all():
        raise ResultError(f"{name} has values that are not finite; {MEND}")
    return array.astype(dtype)


def _check_parameters(text: str) -> None:
    try:
        parameters = json.loads(text, parse_int=float)  # so that no integer is too large for the test of tau
    except ValueError as error:
        raise ResultError(f"parameters are not JSON ({error}); {MEND}") from error
    if not isinstance(parameters, dict) or any(isinstance(value, dict) for value in parameters.values()):
        raise ResultError(f"parameters are not one flat JSON object; {MEND}")
    tau = parameters.get("tau")
    if not isinstance(tau, float) or not np.isfinite(tau):
        raise ResultError(f"parameters give tau = {tau!r}; expected a finite number; {MEND}")
