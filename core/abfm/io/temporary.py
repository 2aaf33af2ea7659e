"""Temporary files and folders that do not stay: not after an error, nor a signal, nor for long
after a kill.

Each is locked while it is in use, and the system takes the lock back when a process ends, however
that happens. So one that is not locked is surely abandoned, and the next to write in the same
folder removes it, if it is of the same machine: locks of other machines may not be seen. Python's
own `tempfile` leaves what a killed process had for ever, and libraries that write atomically do.
"""

import os
import platform
import secrets
import shutil
import stat
import sys
import time
import zlib
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path

if sys.platform != "win32":
    import fcntl

_PREFIX = f".abfm-{zlib.crc32(platform.node().encode()):08x}-"
# bytes; a longer one is nobody's format, and names must not get longer than systems take
_LONGEST_SUFFIX = 20
_DAY = 86400.0  # seconds
_in_use: set[Path] = set()


def temporary_file(folder: Path, suffix: str = "") -> AbstractContextManager[Path]:
    """Make an empty file with a name of its own in a folder; it is removed at the end, unless it
    was renamed.

    Raises
    ------
    OSError
        If it cannot be made.
    """
    end = suffix if len(os.fsencode(suffix)) <= _LONGEST_SUFFIX else ""
    return _temporary(folder, end, _new_file)


def temporary_folder(folder: Path) -> AbstractContextManager[Path]:
    """Make a folder of the user's own in a folder; it is removed at the end with all that is in it.

    Raises
    ------
    OSError
        If it cannot be made.
    """
    return _temporary(folder, "", _new_folder)


@contextmanager
def _temporary(folder: Path, end: str, make: Callable[[Path], int]) -> Iterator[Path]:
    _remove_abandoned(folder)
    path = folder / f"{_PREFIX}{secrets.token_hex(6)}{end}"
    _in_use.add(path)  # before it is there: a signal may come in between
    descriptor = -1
    try:
        descriptor = _locked(path, make)
        yield path
    finally:
        _remove(path)
        if descriptor >= 0:
            os.close(descriptor)
        _in_use.discard(path)


def remove_temporary() -> None:
    """Remove all that this process has in use: for one that ends at once."""
    for path in list(_in_use):
        _remove(path)


def _new_file(path: Path) -> int:
    return os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666)


def _new_folder(path: Path) -> int:
    path.mkdir(0o700)
    return -1 if sys.platform == "win32" else os.open(path, os.O_RDONLY)


def _locked(path: Path, make: Callable[[Path], int]) -> int:
    """Make what is wanted and return it open, with a lock on it; -1 on Windows, which renames no
    file that is open.
    """
    while True:
        descriptor = make(path)
        if sys.platform == "win32":
            if descriptor >= 0:
                os.close(descriptor)
            return -1
        with suppress(OSError):  # a file system without locks, where nobody gets one
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        if os.fstat(descriptor).st_nlink:
            return descriptor
        os.close(descriptor)  # it was taken for abandoned, and removed, just before it was locked


def _remove(path: Path) -> None:
    """Remove a file or a folder if that can be; errors on the way must not hide what went wrong
    before.
    """
    with suppress(OSError):
        if stat.S_ISDIR(os.lstat(path).st_mode):
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink()


def _remove_abandoned(folder: Path) -> None:
    with suppress(OSError), os.scandir(folder) as entries:
        for name in [entry.name for entry in entries if entry.name.startswith(_PREFIX)]:
            with suppress(OSError):
                _remove_if_abandoned(folder / name)


def _remove_if_abandoned(path: Path) -> None:
    if sys.platform == "win32":  # which removes no file that is open
        if time.time() - path.stat().st_mtime > _DAY:
            _remove(path)
        return
    is_folder = stat.S_ISDIR(os.lstat(path).st_mode)
    descriptor = os.open(
        path, (os.O_RDONLY if is_folder else os.O_RDWR) | os.O_NOFOLLOW | os.O_NONBLOCK
    )
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if os.path.samestat(os.fstat(descriptor), os.lstat(path)):
            _remove(path)
    finally:
        os.close(descriptor)
