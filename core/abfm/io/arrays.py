"""Arrays in a zip, as result files and projects hold them: each checked when written and when read."""

import io
import math
import os
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from abfm.errors import ResultError

FORMAT_VERSION = 1
"""Of result files and of projects."""


class Entry(NamedTuple):
    """What an array must be; a word in its shape stands for a size that all arrays agree on."""

    kind: str
    shape: tuple[str | int, ...]
    required: bool = True
    may_be_empty: bool = False


KINDS: dict[str, tuple[str, Any]] = {
    "real": ("fiu", np.float64),
    "integer": ("iu", np.int64),
    "boolean": ("b", np.bool_),
    "text": ("U", np.str_),
}
_DAMAGE = (ValueError, EOFError, KeyError, RuntimeError, OverflowError, MemoryError, zipfile.BadZipFile, zlib.error)


@contextmanager
def open_archive(path: str | os.PathLike[str], what: str, cure: str) -> Iterator[zipfile.ZipFile]:
    """A zip to read from.

    Raises
    ------
    ResultError
        For all that goes wrong while it is open, in one line: the path, what the file should be, and what to do.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            yield archive
    except ResultError as error:
        raise ResultError(f"{path}: {error}") from error
    except OSError as error:
        reason = error.strerror or error
        raise ResultError(f"cannot read {path}: {reason}; check the path and its permissions") from error
    except _DAMAGE as error:
        reason = " ".join(str(error).split())
        raise ResultError(f"{path}: no {what} of abfm, or damaged or cut short ({reason}); {cure}") from error


def check_version(version: object, newest: int = FORMAT_VERSION) -> None:
    """Refuse a format that this version, which reads up to the `newest`, cannot read.

    Raises
    ------
    ResultError
        If it is newer.
    ValueError
        If it is no version.
    """
    if type(version) is not int or version < 1:
        raise ValueError(f"format_version is {version!r}; expected a number from 1 to {newest}")
    if version > newest:
        raise ResultError(f"written in format {version}, and this abfm reads up to {newest}; upgrade abfm")


def write_arrays(archive: zipfile.ZipFile, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Add a member ``name.npy`` for each; the same arrays give the same bytes."""
    for name, array in arrays.items():
        with archive.open(zipfile.ZipInfo(f"{name}.npy"), "w", force_zip64=True) as file:
            np.save(file, array, allow_pickle=False)


def read_arrays(archive: zipfile.ZipFile) -> dict[str, NDArray[Any]]:
    """All that `write_arrays` wrote.

    Raises
    ------
    ValueError, zipfile.BadZipFile, OSError
        If an array is damaged, holds Python objects, or not as much as it says.
    """
    names = [name.removesuffix(".npy") for name in archive.namelist() if name.endswith(".npy")]
    return {name: _read(archive, name) for name in names}


def check_arrays(
    arrays: Mapping[str, Any], entries: Mapping[str, Entry], prefix: str = "", **sizes: int
) -> dict[str, NDArray[Any]]:
    """The arrays that are listed, as float64, int64, bool or unicode.

    Their names begin with ``prefix``, which the entries and the answer have not; ``sizes`` are known before.

    Raises
    ------
    ValueError
        If one is missing, or has the wrong kind, the wrong shape or values that are not finite.
    """
    places = {name: f"{prefix}{name}" for name in entries}
    missing = [place for name, place in places.items() if entries[name].required and place not in arrays]
    if missing:
        raise ValueError(f"it lacks {', '.join(missing)}")
    return {
        name: _checked(place, np.asarray(arrays[place]), entries[name], sizes)
        for name, place in places.items()
        if place in arrays
    }


def _checked(name: str, array: NDArray[Any], entry: Entry, sizes: dict[str, int]) -> NDArray[Any]:
    """One array in its own type; ``sizes`` holds what the arrays before it have fixed, and learns from this one."""
    kinds, dtype = KINDS[entry.kind]
    if array.dtype.kind not in kinds:
        raise ValueError(f"{name} has type {array.dtype}; expected {entry.kind} values")
    expected = [sizes.get(size, size) if isinstance(size, str) else size for size in entry.shape]
    agrees = len(expected) == array.ndim and all(
        isinstance(size, str) or size == given for size, given in zip(expected, array.shape, strict=True)
    )
    if not agrees or (array.size == 0 and not entry.may_be_empty):
        raise ValueError(f"{name} has shape {array.shape}; expected ({', '.join(map(str, expected))})")
    sizes |= {word: given for word, given in zip(entry.shape, array.shape, strict=True) if isinstance(word, str)}
    if entry.kind == "real" and not np.isfinite(array).all():
        raise ValueError(f"{name} has values that are not finite")
    return array.astype(dtype, order="C", copy=False)


def _read(archive: zipfile.ZipFile, name: str) -> NDArray[Any]:
    file = io.BytesIO(archive.read(f"{name}.npy"))
    try:
        np.lib.format.read_magic(file)
        shape, _, dtype = np.lib.format.read_array_header_1_0(file)
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from error
    if dtype.hasobject:
        raise ValueError(f"{name} has type {dtype}; expected no Python objects")
    if file.tell() + math.prod(shape) * dtype.itemsize != len(file.getbuffer()):
        raise ValueError(f"{name} has another size than its shape {shape} says")
    file.seek(0)
    return np.lib.format.read_array(file, allow_pickle=False)
