"""Replace a file completely or not at all; temporary files and folders.

Temporary files are removed after errors and signals. What a killed process leaves is removed by the
next one that writes in the same folder: each file is locked while it is in use, and the system
releases the lock when the process ends. Files of other machines are left alone, as their locks may
not be visible. Python's `tempfile` and libraries that write atomically leave such files for ever.
"""

import os
import platform
import secrets
import shutil
import stat
import sys
import time
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from abfm.errors import ResultError

if sys.platform != "win32":
    import fcntl

_PREFIX = f".abfm-{zlib.crc32(platform.node().encode()):08x}-"
# bytes; a longer one is nobody's format, and names must not get longer than systems take
_LONGEST_SUFFIX = 20
_DAY = 86400.0  # seconds; Windows cannot lock files that are to be renamed
_in_use: set[Path] = set()


@contextmanager
def write_atomically(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Give a temporary path in the same folder to write to; it takes the place of ``path`` when the
    block ends well.

    The data is on the disk before the old file goes, so a crash or a full disk leaves the old file
    whole. The temporary file is removed if the block fails. It ends as ``path`` does, for writers
    that go by the suffix. A replaced file keeps its permissions, and a symbolic link keeps pointing
    at the file that is replaced.

    Raises
    ------
    ResultError
        If the operating system refuses to write, or the path is that of a folder, a device or a
        pipe.
    """
    with _refused(path):
        target = _target(path)
        with temporary_file(target.parent, target.suffix) as temporary:
            yield temporary
            with temporary.open("rb+") as written:
                os.fsync(written.fileno())
            if target.exists():
                shutil.copymode(target, temporary)
            temporary.replace(target)
            if os.name == "posix":  # the rename outlives a power cut; Windows needs no such call
                descriptor = os.open(target.parent, os.O_RDONLY)
                try:
                    os.fsync(descriptor)
                finally:
                    os.close(descriptor)


def check_writable(path: str | os.PathLike[str]) -> None:
    """Refuse, before there is anything to write, a path that `write_atomically` would refuse.

    Raises
    ------
    ResultError
        As there, and if there is a file that may not be written.
    """
    with _refused(path):
        target = _target(path)
        with temporary_file(target.parent, target.suffix):
            pass
        if target.exists() and not os.access(target, os.W_OK):
            raise PermissionError(None, "no permission to replace it")


@contextmanager
def _refused(path: str | os.PathLike[str]) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        reason = f"{error.strerror or error}; choose a place that exists, is writable"
        raise ResultError(f"cannot write {path}: {reason} and has space left") from error


def _target(path: str | os.PathLike[str]) -> Path:
    """Return the file that a path means; OSError if it has no place for one."""
    # with NumPy, before which the command line needs the rest
    from abfm.reading.plain_files import SPECIAL

    try:
        target = Path(os.path.realpath(path))
        kind = stat.S_IFMT(target.stat().st_mode)
    except FileNotFoundError:
        return target
    except ValueError:
        raise OSError(None, "its name has a zero byte") from None
    no_files = SPECIAL | {stat.S_IFDIR: "a folder"}
    if kind in no_files:
        raise OSError(None, f"it is {no_files[kind]}, no place for a file")
    return target


@contextmanager
def temporary_file(folder: Path, suffix: str = "", is_folder: bool = False) -> Iterator[Path]:
    """Make a file with a name of its own; it is removed at the end, unless it was renamed."""
    _remove_abandoned(folder)
    end = suffix if len(os.fsencode(suffix)) <= _LONGEST_SUFFIX else ""
    path = folder / f"{_PREFIX}{secrets.token_hex(6)}{end}"
    _in_use.add(path)  # before it is there: a signal may come in between
    descriptor = -1
    try:
        descriptor = _made(path, is_folder)
        yield path
    finally:
        _remove(path)
        if descriptor >= 0:
            os.close(descriptor)
        _in_use.discard(path)


@contextmanager
def temporary_folder(folder: Path) -> Iterator[Path]:
    """Make a folder of the user's own in a folder, removed at the end with all that is in it;
    OSError if it cannot be made.
    """
    with temporary_file(folder, is_folder=True) as path:
        yield path


def remove_temporary() -> None:
    """Remove all that this process has in use: for one that ends at once."""
    for path in list(_in_use):
        _remove(path)


def _made(path: Path, is_folder: bool) -> int:
    """Make it and return it open and locked; -1 on Windows, which renames no open file."""
    while True:
        if is_folder:
            path.mkdir(0o700)
        if sys.platform == "win32":
            if not is_folder:
                path.touch(exist_ok=False)
            return -1
        new = os.O_RDONLY if is_folder else os.O_RDWR | os.O_CREAT | os.O_EXCL
        try:
            descriptor = os.open(path, new, 0o666)
        except FileNotFoundError:
            if is_folder:  # it was taken for abandoned, and removed, as soon as it was made
                continue
            raise
        with suppress(OSError):  # a file system without locks, where nobody gets one
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        if os.fstat(descriptor).st_nlink:
            return descriptor
        os.close(descriptor)  # it was taken for abandoned, and removed, just before it was locked


def _remove(path: Path) -> None:
    """Remove it if that can be: what goes wrong here must not hide what did before."""
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
    mode = os.O_RDONLY if stat.S_ISDIR(os.lstat(path).st_mode) else os.O_RDWR
    descriptor = os.open(path, mode | os.O_NOFOLLOW | os.O_NONBLOCK)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if os.path.samestat(os.fstat(descriptor), os.lstat(path)):
            _remove(path)
    finally:
        os.close(descriptor)
