"""The one door by which files come in: what is behind a name, and how much of it, is known
before anything is read.
"""

import errno
import gzip
import os
import stat
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from typing import BinaryIO

LARGEST = 4 << 30
"""Bytes of the largest file that is read."""
# inflated data may have so many bytes, or so many times those of its file
_SMALL, _MOST_TIMES = 64 << 20, 20
_FLAGS = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
SPECIAL = {
    stat.S_IFIFO: "a pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}
"""What is no plain file and no folder, by its mode's format."""


@contextmanager
def open_plain(path: str | os.PathLike[str], most: int = LARGEST) -> Iterator[BinaryIO]:
    """Open a plain file for reading: no folder, pipe, socket or device, and with at most so many
    bytes.

    It is looked at before it is opened, as opening alone makes some devices act, and again when it
    is open.

    Raises
    ------
    OSError
        If it is something else, too large, or cannot be opened; ``strerror`` says why.
    """
    _check(_status(path), most)
    descriptor = os.open(path, _FLAGS)
    with os.fdopen(descriptor, "rb") as file:
        _check(os.fstat(descriptor), most)
        yield file


def read_bytes(path: str | os.PathLike[str], most: int = LARGEST) -> bytes:
    """Read all of a plain file that there is when it is opened; see `open_plain`.

    Raises
    ------
    OSError
        If it cannot be read, is no plain file, or has more bytes than memory or than ``most``.
    """
    with open_plain(path, most) as file:
        size = os.fstat(file.fileno()).st_size
        try:
            return file.read(size)
        except MemoryError:
            raise OSError(errno.ENOMEM, f"its {size} bytes do not fit into memory") from None


def inflated(data: bytes, most: int | None = None) -> bytes:
    """Decompress what a gzip file, or zlib's compressed data, holds.

    Parameters
    ----------
    most : int, optional
        Bytes that it may have, unless 64 MiB or, if that is more, 20 times those of the data.

    Raises
    ------
    ValueError
        If it is damaged, cut short, or has more.
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
    return max(_SMALL, _MOST_TIMES * size)


def _status(path: str | os.PathLike[str]) -> os.stat_result:
    try:
        return os.stat(path)
    except ValueError:  # a name with a zero in it
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT)) from None


def _check(status: os.stat_result, most: int) -> None:
    if stat.S_ISDIR(status.st_mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
    if not stat.S_ISREG(status.st_mode):
        kind = SPECIAL.get(stat.S_IFMT(status.st_mode), "something else")
        raise OSError(errno.EINVAL, f"it is {kind}, not a file as is expected")
    if status.st_size > most:
        raise OSError(errno.EFBIG, f"it has {status.st_size} bytes, and at most {most} are read")
