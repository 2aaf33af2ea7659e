"""Arrays in a zip, as result files and projects hold them: each checked when written, and when
it is asked for.
"""

import io
import math
import os
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from abfm.errors import ResultError, brief, one_line
from abfm.reading import LARGEST, array_from, most_inflated, open_plain

FORMAT_VERSION = 1
"""Of result files and of projects."""


KINDS: dict[str, tuple[str, Any]] = {
    "real": ("fiu", np.float64),
    "integer": ("iu", np.int64),
    "boolean": ("b", np.bool_),
    "text": ("U", np.str_),
}


class Entry(NamedTuple):
    """An array of a file: its kind, its shape, in which a word stands for a size that all arrays
    agree on, and the bounds of its values.
    """

    kind: str
    shape: tuple[str | int, ...]
    required: bool = True
    may_be_empty: bool = False
    low: float = -math.inf
    high: float = math.inf

    def check(self, name: str, array: NDArray[Any], sizes: dict[str, int]) -> NDArray[Any]:
        """Return an array in its own type; ``sizes`` holds what the arrays before it have fixed,
        and learns from this one.
        """
        kinds, dtype = KINDS[self.kind]
        if array.dtype.kind not in kinds:
            raise ValueError(f"{name} has type {array.dtype}; expected {self.kind} values")
        self._check_shape(name, array, sizes)
        if self.kind == "text":
            _check_text(name, array)
        elif array.size:
            self._check_numbers(name, array)
        return array.astype(dtype, order="C", copy=False)

    def _check_shape(self, name: str, array: NDArray[Any], sizes: dict[str, int]) -> None:
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

    def _check_numbers(self, name: str, array: NDArray[Any]) -> None:
        if self.kind == "real" and not np.isfinite(array).all():
            raise ValueError(f"{name} has values that are not finite")
        for value in (array.min(), array.max()):
            if not self.low <= value <= self.high:
                bounds = f"{self.low:g} to {self.high:g}"
                raise ValueError(f"{name} has the value {value:g}; expected {bounds}")
        if self.kind == "integer" and array.max() > np.iinfo(np.int64).max:
            raise ValueError(f"{name} has values beyond those of 64 bits with a sign")


def _check_text(name: str, array: NDArray[Any]) -> None:
    if not all(len(text) <= _LONGEST_TEXT and text.isprintable() for text in array.flat):
        raise ValueError(
            f"{name} has more than {_LONGEST_TEXT} characters, or some that cannot be shown"
        )


_MOST_TOLD, _LONGEST_TEXT = 400, 10_000  # characters
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # those that can be read in bounded steps


class Archive(Mapping[str, NDArray[Any]]):
    """A zip open for reading: its arrays by name, each read when it is asked for.

    All that is read of it together has no more bytes than it can hold, also where members overlap
    or are compressed.
    """

    def __init__(self, file: BinaryIO) -> None:
        self._zip = zipfile.ZipFile(file)
        self._left = most_inflated(file.seek(0, io.SEEK_END))
        self._names = {
            name.removesuffix(".npy") for name in self._zip.namelist() if name.endswith(".npy")
        }
        self.packed = [member.filename for member in self._zip.infolist() if member.compress_type]

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)

    def __contains__(self, name: object) -> bool:
        return name in self._names

    def __getitem__(self, name: str) -> NDArray[Any]:
        if name not in self._names:
            raise KeyError(f"it lacks {name}")
        try:
            return array_from(self.read(f"{name}.npy"))
        except ValueError as error:
            raise ValueError(f"{name}: {one_line(error)}") from error

    def read(self, name: str, most: int = LARGEST) -> bytes:
        """Return the bytes of a member, so many at most.

        Raises
        ------
        ValueError, zipfile.BadZipFile, or anything else that damage makes of the zip's reader
            If there is none, or it is damaged, too large, or with what was read before more than
            the zip can hold.
        """
        member = self._zip.getinfo(name)
        if member.file_size > most:
            raise ValueError(f"{name} has {member.file_size} bytes; expected at most {most}")
        self._left -= member.file_size
        if self._left < 0:
            raise ValueError(
                f"its members up to {name} have more bytes than a zip of this size can hold"
            )
        if member.compress_type not in _METHODS:
            raise ValueError(f"{name} is compressed by a method other than deflate")
        with self._zip.open(member) as file:
            return file.read(member.file_size + 1)


@contextmanager
def open_archive(path: str | os.PathLike[str], what: str, cure: str) -> Iterator[Archive]:
    """Open a zip to read from.

    Raises
    ------
    ResultError
        For all that goes wrong while it is open, in one line: the path, what the file should be,
        and what to do.
    """
    try:
        with open_plain(path) as file:
            yield Archive(file)
    except ResultError as error:
        raise ResultError(f"{one_line(path)}: {one_line(error, _MOST_TOLD)}") from error
    except OSError as error:
        reason = f"{one_line(error)}; check the path and its permissions"
        raise ResultError(f"cannot read {one_line(path)}: {reason}") from error
    except (
        Exception
    ) as error:  # damage makes anything of the readers of zips, of JSON and of what they hold
        told = one_line(error, _MOST_TOLD)
        raise ResultError(
            f"{one_line(path)}: no {what} of abfm, or damaged or cut short ({told}); {cure}"
        ) from error


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
        raise ValueError(
            f"format_version is {brief(version)}; expected a number from 1 to {newest}"
        )
    if version > newest:
        raise ResultError(
            f"written in format {version}, and this abfm reads up to {newest}; upgrade abfm"
        )


def write_arrays(archive: zipfile.ZipFile, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Add a member ``name.npy`` for each; the same arrays give the same bytes."""
    for name, array in arrays.items():
        with archive.open(zipfile.ZipInfo(f"{name}.npy"), "w", force_zip64=True) as file:
            np.save(file, array, allow_pickle=False)


def check_arrays(
    arrays: Mapping[str, Any], entries: Mapping[str, Entry], prefix: str = "", **sizes: int
) -> dict[str, NDArray[Any]]:
    """Return the arrays that are listed, as float64, int64, bool or unicode.

    Their names begin with ``prefix``, which the entries and the answer have not; ``sizes`` are
    known before.

    Raises
    ------
    ValueError
        If one is missing, or has the wrong kind, the wrong shape or values that are not finite.
    """
    places = {name: f"{prefix}{name}" for name in entries}
    missing = [
        place for name, place in places.items() if entries[name].required and place not in arrays
    ]
    if missing:
        raise ValueError(f"it lacks {', '.join(missing)}")
    return {
        name: entries[name].check(place, np.asarray(arrays[place]), sizes)
        for name, place in places.items()
        if place in arrays
    }
