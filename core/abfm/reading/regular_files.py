"""Reading of regular files of bounded size, bounded decompression, and NumPy arrays.

The type and the size of a file are checked before it is read. The header of an array (.npy) must
agree with the number of bytes after it. Only the header is read by NumPy, as its reader of arrays
would allocate memory before this check.
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
from contextlib import contextmanager, suppress
from io import BufferedReader, BytesIO, RawIOBase
from pathlib import Path
from typing import Any, BinaryIO, Literal

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from abfm.errors import brief, one_line

FILE_BYTES_MAX = 4 << 30  # size of the largest file that is read, in bytes
# Limits of decompressed data: this many bytes, or, if larger, this many times the compressed size.
_INFLATED_BYTES_MIN = 64 << 20
_INFLATION_MAX = 20
_NPY_HEADERS = {
    (1, 0): npy.read_array_header_1_0,
    (2, 0): npy.read_array_header_2_0,
    (3, 0): npy.read_array_header_2_0,  # version 3 differs only in names of fields
}
_FLAGS = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
_BLOCK_BYTES = 1 << 20
_LOCAL_HEADER_BYTES = 30  # header of a member of a zip, without its name and extra field
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # methods that can be read in bounded steps
# names of types of files other than regular files and folders
SPECIAL_FILES = {stat.S_IFIFO: "a pipe", stat.S_IFSOCK: "a socket"}
SPECIAL_FILES |= dict.fromkeys((stat.S_IFCHR, stat.S_IFBLK), "a device")


@contextmanager
def open_regular(
    path: str | os.PathLike[str], size_max: int = FILE_BYTES_MAX
) -> Iterator[BinaryIO]:
    """Open a regular file of at most ``size_max`` bytes for reading.

    Folders, pipes, sockets and devices are refused. They are detected before the file is opened, as
    opening alone may trigger a device, and again when it is open. The ``strerror`` of an OSError
    describes the problem.
    """
    try:
        _check(os.stat(path), size_max)
    except ValueError:  # the name has a zero byte
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT)) from None
    descriptor = os.open(path, _FLAGS)
    with os.fdopen(descriptor, "rb") as file:
        _check(os.fstat(descriptor), size_max)
        yield file


def read_bytes(path: str | os.PathLike[str], size_max: int = FILE_BYTES_MAX) -> bytes:
    """Read the contents that a regular file has when it is opened; see `open_regular`."""
    with open_regular(path, size_max) as file:
        size = os.fstat(file.fileno()).st_size
        try:
            return file.read(size)
        except MemoryError:
            raise OSError(errno.ENOMEM, f"the {size} bytes do not fit into memory") from None


def referenced_file(file: str | os.PathLike[str], name: str) -> Path:
    """Return the path of a file that another file refers to.

    For security, it must be in the folder of the referring file or below. A downloaded file must
    not choose which files of this computer are read. Symbolic links in the folder are followed.
    Raises ValueError if the name leads out of that folder.
    """
    folder = os.path.abspath(os.path.dirname(os.path.expanduser(os.fspath(file))))
    path = os.path.abspath(os.path.join(folder, name))
    if not path.startswith(os.path.join(folder, "")):
        raise ValueError(
            f"the file refers to {brief(name)}, but only files in the same folder or below are "
            "read. Move it there and correct the name"
        )
    return Path(path)


def inflated(data: bytes, size_max: int | None = None) -> bytes:
    """Decompress data of gzip or zlib.

    Raises ValueError if the data are damaged or cut off, or have more than ``size_max`` bytes, by
    default the `inflated_size_max` of the compressed size.
    """
    bound = inflated_size_max(len(data)) if size_max is None else size_max
    try:
        if data[:2] == b"\x1f\x8b":
            with gzip.GzipFile(fileobj=BytesIO(data)) as file:
                found = file.read(bound + 1)
        else:
            stream = zlib.decompressobj()
            found = stream.decompress(data, bound + 1)
            if len(found) <= bound and not stream.eof:
                raise EOFError("the compressed data are cut off")
    except (OSError, EOFError, zlib.error) as error:
        raise ValueError("the compressed data are damaged or cut off") from error
    if len(found) > bound:
        raise ValueError(
            f"{len(data)} bytes of compressed data become more than {bound} bytes, the largest "
            "size that is read"
        )
    return found


def inflated_size_max(size: int) -> int:
    """Return the largest accepted size of decompressed data for a file of this size, in bytes."""
    return max(_INFLATED_BYTES_MIN, _INFLATION_MAX * size)


def _check(status: os.stat_result, size_max: int) -> None:
    if stat.S_ISDIR(status.st_mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
    if not stat.S_ISREG(status.st_mode):
        kind = SPECIAL_FILES.get(stat.S_IFMT(status.st_mode), "something else")
        raise OSError(errno.EINVAL, f"this is {kind}; expected a regular file")
    if status.st_size > size_max:
        raise OSError(
            errno.EFBIG, f"the file has {status.st_size} bytes; expected at most {size_max}"
        )


def from_json(text: str | bytes) -> Any:
    """Return the value of a JSON text, or raise a ValueError with a readable message."""
    try:
        return json.loads(text)
    except RecursionError:
        raise ValueError("the JSON is nested too deeply") from None
    except json.JSONDecodeError as error:
        raise ValueError(f"the JSON is damaged in line {error.lineno}: {error.msg}") from None
    except UnicodeDecodeError:
        raise
    except ValueError:
        raise ValueError("the JSON has a number with too many digits") from None


def array_from(data: bytes) -> NDArray[Any]:
    """Return the numbers, booleans or texts of a .npy file; ValueError for other types or sizes."""
    start, shape, is_fortran, dtype = _header(data, len(data))
    array = np.frombuffer(data, dtype, math.prod(shape), start)
    if dtype.kind == "b" and (array.view(np.uint8) > 1).any():
        raise ValueError("a boolean value is neither 0 nor 1; the file is damaged")
    if dtype.kind == "U":
        letters = array.view(np.dtype("u4").newbyteorder(dtype.byteorder))
        if (letters > sys.maxunicode).any():
            raise ValueError("a text has a character outside Unicode; the file is damaged")
    return array.reshape(shape, order="F" if is_fortran else "C").copy(order="K")


def _header(data: bytes, total: int) -> tuple[int, tuple[int, ...], bool, np.dtype[Any]]:
    """Return the start of the data in a .npy file, and the shape, Fortran order and type.

    ``total`` is the size of the file, and ``data`` its beginning. Errors are those of `array_from`.
    """
    file = BytesIO(data)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # warnings about headers written by Python 2
            shape, is_fortran, dtype = _NPY_HEADERS[npy.read_magic(file)](file)
    except Exception as error:
        reason = one_line(error, 80)
        raise ValueError(
            f"the header is damaged, or is not that of a .npy file of version 1, 2 or 3 ({reason})"
        ) from error
    if dtype.kind not in "biufcSU" or dtype.itemsize == 0:
        raise ValueError(
            f"the type of the array is {one_line(dtype, 40)}; expected numbers, such as '<f8'"
        )
    start, size = file.tell(), math.prod(shape) * dtype.itemsize
    if min(shape, default=0) < 0 or start + size != total:
        raise ValueError(
            f"the size does not match the header: {total - start} bytes follow it, but an array of "
            f"{dtype} of shape {one_line(shape, 60)} has {size}"
        )
    return start, shape, is_fortran, dtype


class Archive(Mapping[str, NDArray[Any]]):
    """Arrays of a zip file that is open for reading, by name; their total size is limited."""

    def __init__(self, file: BinaryIO) -> None:
        self._file, self._zip = file, zipfile.ZipFile(file)
        size = file.seek(0, os.SEEK_END)
        self._budget, self._size_max = inflated_size_max(size), max(FILE_BYTES_MAX, size)
        names = self._zip.namelist()
        self._names = {name.removesuffix(".npy") for name in names if name.endswith(".npy")}
        self.packed = [member.filename for member in self._zip.infolist() if member.compress_type]
        # `open` compares the name with its copy; an optional array with a damaged name is not lost
        for member in self._zip.infolist():
            with suppress(NotImplementedError, RuntimeError):  # reading the member reports these
                self._zip.open(member).close()

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
        """Return a memory map of an array of numbers; the file must not change while it is used.

        The array is read into memory if it is compressed, and also on Windows, where a mapped file
        cannot be replaced.
        """
        self._check_name(name)
        member = self._zip.getinfo(f"{name}.npy")
        if sys.platform == "win32" or member.compress_type != zipfile.ZIP_STORED:
            return self[name]
        with self._zip.open(member) as content:
            begin = content.read(_BLOCK_BYTES)
            while content.read(_BLOCK_BYTES):  # zipfile compares the checksum at the end
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
            raise KeyError(f"the file has no array {name}")
        if (count := self._zip.namelist().count(f"{name}.npy")) > 1:
            raise ValueError(f"{count} arrays are named {brief(name)}. Rename all but one")

    def read(self, name: str, size_max: int | None = None) -> bytes:
        """Return the bytes of a member; a damaged zip raises any error of ``zipfile``."""
        member = self._member(name, self._size_max if size_max is None else size_max)
        with self._zip.open(member) as file:
            return file.read(member.file_size + 1)

    def part(self, name: str) -> BufferedReader:
        """Return an uncompressed member of the zip, such as another zip, as an open file."""
        member = self._member(name, self._size_max)
        if member.compress_type:
            raise ValueError(f"{name} is compressed; expected an uncompressed member")
        with self._zip.open(member):
            start = self._file.tell()
        return BufferedReader(_Part(self._file, name, start, member.file_size))

    def _member(self, name: str, size_max: int) -> zipfile.ZipInfo:
        """Return the entry of a member of the zip; check its size and compression first."""
        member = self._zip.getinfo(name)
        if member.file_size > size_max:
            raise ValueError(f"{name} has {member.file_size} bytes; expected at most {size_max}")
        self._budget -= member.file_size
        if self._budget < 0:
            raise ValueError(
                f"the members up to {name} are too large in total for a zip of this size"
            )
        if member.compress_type not in _METHODS:
            raise ValueError(f"{name} has an unsupported compression method; expected deflate")
        return member


class _Part(RawIOBase):
    """A part of an open file, as a file in which seeking is fast, unlike in that of ``zipfile``."""

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
