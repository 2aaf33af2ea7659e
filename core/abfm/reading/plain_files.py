"""Reading plain files of bounded size, bounded decompression, and arrays of NumPy.

The kind and the size of a file are checked before it is read. The header of an array (.npy) must
fit the bytes that follow it: NumPy reads the header, but not the array, for which it would reserve
memory first.
"""

import errno
import gzip
import json
import math
import os
import stat
import struct
import sys
import warnings
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from io import BufferedReader, BytesIO, RawIOBase
from pathlib import Path
from typing import Any, BinaryIO, Literal

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from abfm.errors import brief, one_line

FILE_BYTES_MAX = 4 << 30
"""Bytes of the largest file that is read."""
# inflated data may have so many bytes, or so many times those of its file
_INFLATED_BYTES_MIN = 64 << 20
_INFLATION_MAX = 20
_NPY_HEADERS = {
    (1, 0): npy.read_array_header_1_0,
    (2, 0): npy.read_array_header_2_0,
    (3, 0): npy.read_array_header_2_0,  # whose letters beyond ASCII are in names of fields
}
_FLAGS = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
_BLOCK_BYTES = 1 << 20
_LOCAL_HEADER_BYTES = 30  # of a zip's member, without its name and extra field
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # those that can be read in bounded steps
# what is no plain file and no folder, by its mode's format
SPECIAL_FILES = {stat.S_IFIFO: "a pipe", stat.S_IFSOCK: "a socket"}
SPECIAL_FILES |= dict.fromkeys((stat.S_IFCHR, stat.S_IFBLK), "a device")


@contextmanager
def open_plain(path: str | os.PathLike[str], most: int = FILE_BYTES_MAX) -> Iterator[BinaryIO]:
    """Open a plain file for reading: no folder, pipe, socket or device, of at most so many bytes.

    It is looked at before it is opened, as opening alone makes some devices act, and again when it
    is open. The ``strerror`` of an OSError reports why it cannot be read.
    """
    try:
        _check(os.stat(path), most)
    except ValueError:  # a name with a zero in it
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT)) from None
    descriptor = os.open(path, _FLAGS)
    with os.fdopen(descriptor, "rb") as file:
        _check(os.fstat(descriptor), most)
        yield file


def read_bytes(path: str | os.PathLike[str], most: int = FILE_BYTES_MAX) -> bytes:
    """Read all of a plain file that there is when it is opened; see `open_plain`."""
    with open_plain(path, most) as file:
        size = os.fstat(file.fileno()).st_size
        try:
            return file.read(size)
        except MemoryError:
            raise OSError(errno.ENOMEM, f"its {size} bytes do not fit into memory") from None


def referenced_file(file: str | os.PathLike[str], name: str) -> Path:
    """Return the path of a file that another file names.

    Files from others must not choose what is read on this machine: the named file is in the folder
    of the file that names it, or below. Symbolic links there are followed.

    Raises
    ------
    ValueError
        If the name leads out of that folder.
    """
    folder = os.path.abspath(os.path.dirname(os.path.expanduser(os.fspath(file))))
    path = os.path.abspath(os.path.join(folder, name))
    if not path.startswith(os.path.join(folder, "")):
        raise ValueError(
            f"it refers to the file {brief(name)}; only files in its own folder or below are read: "
            "move the file there and correct its name"
        )
    return Path(path)


def inflated(data: bytes, most: int | None = None) -> bytes:
    """Decompress what a gzip file, or zlib's compressed data, holds.

    A ValueError reports that it is damaged, cut short, or has more bytes than ``most``, or than
    `most_inflated` gives.
    """
    bound = most_inflated(len(data)) if most is None else most
    try:
        if data[:2] == b"\x1f\x8b":
            with gzip.GzipFile(fileobj=BytesIO(data)) as file:
                found = file.read(bound + 1)
        else:
            stream = zlib.decompressobj()
            found = stream.decompress(data, bound + 1)
            if len(found) <= bound and not stream.eof:
                raise EOFError("the compressed data is cut short")
    except (OSError, EOFError, zlib.error) as error:
        raise ValueError("its compressed data is damaged or cut short") from error
    if len(found) > bound:
        raise ValueError(
            f"its {len(data)} bytes of compressed data hold more than {bound}, the most that is "
            "read"
        )
    return found


def most_inflated(size: int) -> int:
    """Return the bytes that what a file of this size holds may have when it is decompressed."""
    return max(_INFLATED_BYTES_MIN, _INFLATION_MAX * size)


def _check(status: os.stat_result, most: int) -> None:
    if stat.S_ISDIR(status.st_mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
    if not stat.S_ISREG(status.st_mode):
        kind = SPECIAL_FILES.get(stat.S_IFMT(status.st_mode), "something else")
        raise OSError(errno.EINVAL, f"it is {kind}, not a file as is expected")
    if status.st_size > most:
        raise OSError(errno.EFBIG, f"it has {status.st_size} bytes, and at most {most} are read")


def from_json(text: str | bytes) -> Any:
    """Return what a text in JSON holds, or raise a ValueError in plain words."""
    try:
        return json.loads(text)
    except RecursionError:
        raise ValueError("its JSON is nested too deeply") from None
    except json.JSONDecodeError as error:
        raise ValueError(f"its JSON is damaged in line {error.lineno}: {error.msg}") from None
    except UnicodeDecodeError:
        raise
    except ValueError:
        raise ValueError("its JSON has a number of too many digits") from None


def array_from(data: bytes) -> NDArray[Any]:
    """Return the array of numbers, booleans or texts that the bytes of a .npy file hold.

    A ValueError reports that they hold anything else, or are more or fewer than the array.
    """
    start, shape, is_fortran, dtype = _header(data, len(data))
    array = np.frombuffer(data, dtype, math.prod(shape), start)
    if dtype.kind == "b" and (array.view(np.uint8) > 1).any():
        raise ValueError("a boolean is neither 0 nor 1")
    if dtype.kind == "U":
        letters = array.view(np.dtype("u4").newbyteorder(dtype.byteorder))
        if (letters > sys.maxunicode).any():
            raise ValueError("a letter is none of Unicode's")
    return array.reshape(shape, order="F" if is_fortran else "C").copy(order="K")


def _header(data: bytes, total: int) -> tuple[int, tuple[int, ...], bool, np.dtype[Any]]:
    """Return where the array of a .npy file of so many bytes begins, its shape, whether it is in
    Fortran's order, and its type; ValueError as of `array_from`.
    """
    file = BytesIO(data)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of headers that Python 2 wrote
            shape, is_fortran, dtype = _NPY_HEADERS[npy.read_magic(file)](file)
    except Exception as error:
        reason = one_line(error, 80)
        raise ValueError(
            f"its header is damaged, or not of a .npy file of version 1, 2 or 3 ({reason})"
        ) from error
    if dtype.kind not in "biufcSU" or dtype.itemsize == 0:
        raise ValueError(f"its type is {one_line(dtype, 40)}; expected numbers, such as '<f8'")
    start, size = file.tell(), math.prod(shape) * dtype.itemsize
    if min(shape, default=0) < 0 or start + size != total:
        raise ValueError(
            f"its size is not what its header says: {total - start} bytes follow, and {dtype} "
            f"of shape {one_line(shape, 60)} have {size}"
        )
    return start, shape, is_fortran, dtype


class Archive(Mapping[str, NDArray[Any]]):
    """A zip open for reading: its arrays by name, in all no more bytes than it can hold."""

    def __init__(self, file: BinaryIO) -> None:
        self._file, self._zip = file, zipfile.ZipFile(file)
        size = file.seek(0, os.SEEK_END)
        self._left, self._most = most_inflated(size), max(FILE_BYTES_MAX, size)
        names = self._zip.namelist()
        self._names = {name.removesuffix(".npy") for name in names if name.endswith(".npy")}
        self.packed = [member.filename for member in self._zip.infolist() if member.compress_type]

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)

    def __contains__(self, name: object) -> bool:
        return name in self._names

    def __getitem__(self, name: str) -> NDArray[Any]:
        self._check_name(name)
        try:
            return array_from(self.read(f"{name}.npy"))
        except ValueError as error:
            raise ValueError(f"{name}: {one_line(error)}") from error

    def mapped(self, name: str) -> NDArray[Any]:
        """Return an array of numbers that stays in the file, which must not be changed meanwhile.

        It is read into memory if it is compressed, and on Windows, where no other file could
        take the place of one that is mapped.
        """
        self._check_name(name)
        member = self._zip.getinfo(f"{name}.npy")
        if os.name == "nt" or member.compress_type != zipfile.ZIP_STORED:
            return self[name]
        with self._zip.open(member) as content:
            begin = content.read(_BLOCK_BYTES)
            while content.read(_BLOCK_BYTES):  # to its end, where its checksum is compared
                pass
        try:
            start, shape, is_fortran, dtype = _header(begin, member.file_size)
        except ValueError as error:
            raise ValueError(f"{name}: {one_line(error)}") from error
        if dtype.kind not in "iuf" or not math.prod(shape):
            return self[name]
        self._file.seek(member.header_offset + _LOCAL_HEADER_BYTES - 4)
        start += _LOCAL_HEADER_BYTES + sum(struct.unpack("<HH", self._file.read(4)))
        order: Literal["F", "C"] = "F" if is_fortran else "C"
        offset = member.header_offset + start
        return np.memmap(self._file, dtype, "r", offset, shape, order).view(np.ndarray)

    def _check_name(self, name: str) -> None:
        if name not in self._names:
            raise KeyError(f"it lacks {name}")
        if (count := self._zip.namelist().count(f"{name}.npy")) > 1:
            raise ValueError(f"{count} of its arrays are called {brief(name)}: rename all but one")

    def read(self, name: str, most: int | None = None) -> bytes:
        """Return the bytes of a member; damage makes any error of the zip's reader."""
        member = self._member(name, self._most if most is None else most)
        with self._zip.open(member) as file:
            return file.read(member.file_size + 1)

    def part(self, name: str) -> BufferedReader:
        """Return a member that is not compressed as an open file, such as a zip in a zip."""
        member = self._member(name, self._most)
        if member.compress_type:
            raise ValueError(f"{name} is compressed; expected it as it is")
        with self._zip.open(member):
            start = self._file.tell()
        return BufferedReader(_Part(self._file, name, start, member.file_size))

    def _member(self, name: str, most: int) -> zipfile.ZipInfo:
        """Return a member that may be read."""
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
        return member


class _Part(RawIOBase):
    """A part of an open file, to be read like a file; the seek of zip members reads all before."""

    def __init__(self, file: BinaryIO, name: str, start: int, size: int) -> None:
        self.name = name
        self._file, self._start, self._size, self._at = file, start, size, 0

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        self._at = max(0, offset + (0, self._at, self._size)[whence])
        return self._at

    def readinto(self, buffer: Any) -> int:
        self._file.seek(self._start + self._at)
        count = max(0, min(len(buffer), self._size - self._at))
        data = self._file.read(count)
        buffer[: len(data)] = data
        self._at += len(data)
        return len(data)
