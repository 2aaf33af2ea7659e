"""Atomic replacement of files; temporary files and folders.

Temporary files are removed after errors and signals. Files of a killed process are removed by the
next process that writes in the same folder. Each file is locked while it is in use, and the system
releases the lock when the process ends. On Windows and on SMB shares, a lock would also block the
process that writes the file. Files are not locked there, and are removed a week after their last
change. Files of other computers are not touched, as their locks may not be visible. Python's
`tempfile` and other libraries never remove files of killed processes.
"""

import os
import platform
import secrets
import shutil
import stat
import sys
import tempfile
import time
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from abfm.errors import ResultError, one_line

if sys.platform != "win32":
    import fcntl

_PREFIX = f".abfm-{zlib.crc32(platform.node().encode()):08x}-"
_SUFFIX_LENGTH_MAX = 20  # no format has a longer suffix, and systems limit the length of names
_ABANDONED_AGE = 7 * 86400.0  # seconds; used where files cannot be locked while they are written
# waits on Windows between attempts to replace a file that another process has open
_RETRY_SECONDS = (0.01, 0.03, 0.1, 0.3, 1.0)
_in_use: set[Path] = set()


@contextmanager
def write_atomically(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary path in the same folder, which replaces ``path`` after the block succeeds.

    The data are on the disk before the old file is replaced, so a crash or a full disk does not
    damage the old file. If the block fails, the temporary file is removed. It has the same suffix
    as ``path``, for writers that depend on it. The permissions of a replaced file are preserved. If
    ``path`` is a symbolic link, the file that it points to is replaced.

    Raises
    ------
    ResultError
        If the operating system refuses to write, or the path is a folder, a device or a pipe.
    """
    with _refused(path):
        target = _target(path)
        with temporary_file(target.parent, target.suffix) as temporary:
            yield temporary
            with temporary.open("rb+") as written:
                os.fsync(written.fileno())
            # Windows has only a read-only flag, and refuses to replace a file that has it
            if sys.platform != "win32" and target.exists():
                shutil.copymode(target, temporary)
            _replace(temporary, target)
            if sys.platform != "win32":
                with suppress(OSError):  # some shares cannot flush a folder
                    _flush_folder(target.parent)


def _replace(temporary: Path, target: Path) -> None:
    """Rename ``temporary`` to ``target``; on Windows, wait while a process has ``target`` open."""
    waits: tuple[float, ...] = _RETRY_SECONDS if sys.platform == "win32" else ()
    for seconds in waits:
        try:
            temporary.replace(target)
            return
        except PermissionError:
            time.sleep(seconds)
    temporary.replace(target)


def _flush_folder(folder: Path) -> None:
    """Write the entries of a folder to the disk, so that a rename survives a power cut."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def write_file(path: str | os.PathLike[str], content: bytes | str) -> None:
    """Write bytes, or text in UTF-8, to a file by `write_atomically`."""
    with write_atomically(path) as temporary:
        temporary.write_bytes(content.encode() if isinstance(content, str) else content)


def check_writable(path: str | os.PathLike[str]) -> None:
    """Check that `write_atomically` could write a file, without writing it.

    Raises
    ------
    ResultError
        If `write_atomically` would raise it, or if the file exists and may not be replaced.
    """
    with _refused(path):
        target = _target(path)
        with temporary_file(target.parent, target.suffix):
            pass
        if target.exists() and not os.access(target, os.W_OK):
            raise PermissionError(None, "no permission to replace the file")


@contextmanager
def writing_in(folder: str | os.PathLike[str]) -> Iterator[None]:
    """Convert errors of the operating system while writing in a folder to a ResultError."""
    try:
        yield
    except OSError as error:
        raise ResultError(
            f"cannot write in {one_line(folder)}: {one_line(error)}. Choose a folder that is "
            "writable and has free space"
        ) from error


@contextmanager
def _refused(path: str | os.PathLike[str]) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        reason = error.strerror or error
        raise ResultError(
            f"cannot write {path}: {reason}. Choose a folder that exists, is writable and has free "
            "space"
        ) from error


def _target(path: str | os.PathLike[str]) -> Path:
    """Return the file that a path refers to, or raise an OSError if it cannot be a file."""
    # imported here because it loads NumPy, and the command line needs other functions before that
    from abfm.reading.regular_files import SPECIAL_FILES

    try:
        target = Path(os.path.realpath(path))
        kind = stat.S_IFMT(target.stat().st_mode)
    except FileNotFoundError:
        return target
    except ValueError:
        raise OSError(None, "the name has a zero byte") from None
    other_kinds = SPECIAL_FILES | {stat.S_IFDIR: "a folder"}
    if kind in other_kinds:
        raise OSError(None, f"the path is {other_kinds[kind]}, not a file")
    return target


@contextmanager
def temporary_file(folder: Path, suffix: str = "", is_folder: bool = False) -> Iterator[Path]:
    """Yield a new file or folder with a unique name; remove it at the end unless it was renamed."""
    remove_abandoned(folder)
    path = folder / f"{_PREFIX}{secrets.token_hex(6)}{suffix[:_SUFFIX_LENGTH_MAX]}"
    _in_use.add(path)  # before the file exists, as a signal may arrive in between
    descriptor = None
    try:
        descriptor = _created(path, is_folder)
        yield path
    finally:
        _remove(path)
        if descriptor is not None:
            os.close(descriptor)
        _in_use.discard(path)


@contextmanager
def temporary_folder(folder: Path | None = None) -> Iterator[Path]:
    """Yield a new private folder inside ``folder``; remove it at the end with all its contents.

    By default it is in the folder of the system for temporary files. Raises OSError if it cannot be
    created.
    """
    with temporary_file(folder or Path(tempfile.gettempdir()), is_folder=True) as path:
        yield path


def remove_temporary() -> None:
    """Remove all temporary files of this process, for use before it ends without cleaning up."""
    for path in list(_in_use):
        _remove(path)


def _created(path: Path, is_folder: bool) -> int | None:
    """Create a file or folder; return its locked descriptor, or None if locks are unsupported."""
    while True:
        if is_folder:
            path.mkdir(0o700)
        else:
            path.touch(exist_ok=False)
        try:
            descriptor = _locked(path)
        except FileNotFoundError:  # another process removed it as abandoned, before it was locked
            continue
        except OSError:  # a file system without locks, or Windows
            return None
        # the file may be removed after it was opened, but before it was locked
        is_removed = os.fstat(descriptor).st_nlink == 0
        if not is_removed and _is_readable(path):
            return descriptor
        os.close(descriptor)
        if not is_removed:
            return None


def _locked(path: Path, flags: int = 0) -> int:
    """Open a file or folder and lock it, or raise an OSError.

    Wait for the lock of another process, unless ``flags`` has ``LOCK_NB``.
    """
    if sys.platform == "win32":  # Windows cannot rename or remove an open file
        raise OSError("file locks are not supported on Windows")
    mode = os.O_RDONLY if path.is_dir() else os.O_RDWR
    descriptor = os.open(path, mode | os.O_NOFOLLOW | os.O_NONBLOCK)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | flags)
    except OSError:
        os.close(descriptor)
        raise
    return descriptor


def _is_readable(path: Path) -> bool:
    """Return whether a locked file can be read.

    On an SMB share, a lock refuses other descriptors of the file, even in the same process. See
    "CIFS details" in the Linux manual of flock(2).
    """
    try:
        if not path.is_dir():
            with path.open("rb") as file:
                file.read(1)
    except OSError:
        return False
    return True


def _is_old(path: Path) -> bool:
    return time.time() - path.stat().st_mtime > _ABANDONED_AGE


def _remove(path: Path) -> None:
    """Remove a file or folder if possible; an error here must not hide an earlier one."""
    try:
        path.unlink()
    except OSError:
        shutil.rmtree(path, ignore_errors=True)


def remove_abandoned(folder: Path) -> None:
    """Remove temporary files of ended processes from a folder.

    No process locks these files. Where files cannot be locked, they are unchanged for a week.
    """
    with suppress(OSError):
        for path in list(folder.glob(f"{_PREFIX}*")):
            with suppress(OSError):  # another process uses it, or has removed it
                if sys.platform != "win32":
                    descriptor = _locked(path, fcntl.LOCK_NB)
                    # The file is removed while it is locked: a process that waits for the lock
                    # creates it again. A file without links was removed before, so its name may
                    # belong to a new file.
                    try:
                        is_there = os.fstat(descriptor).st_nlink > 0
                        if is_there and (_is_readable(path) or _is_old(path)):
                            _remove(path)
                    finally:
                        os.close(descriptor)
                elif _is_old(path):
                    _remove(path)
