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
_SUFFIX_LENGTH_MAX = 20  # a longer one is nobody's format, and systems bound the length of names
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


def write_whole(path: str | os.PathLike[str], content: bytes | str) -> None:
    """Write a file of bytes, or of text in UTF-8, by `write_atomically`."""
    with write_atomically(path) as temporary:
        temporary.write_bytes(content.encode() if isinstance(content, str) else content)


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
def writing_in(folder: str | os.PathLike[str]) -> Iterator[None]:
    """Raise a ResultError where the operating system refuses to write in a folder."""
    try:
        yield
    except OSError as error:
        raise ResultError(
            f"cannot write in {one_line(folder)}: {one_line(error)}; choose a folder that is "
            "writable and has space left"
        ) from error


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
    from abfm.reading.regular_files import SPECIAL_FILES

    try:
        target = Path(os.path.realpath(path))
        kind = stat.S_IFMT(target.stat().st_mode)
    except FileNotFoundError:
        return target
    except ValueError:
        raise OSError(None, "its name has a zero byte") from None
    no_files = SPECIAL_FILES | {stat.S_IFDIR: "a folder"}
    if kind in no_files:
        raise OSError(None, f"it is {no_files[kind]}, no place for a file")
    return target


@contextmanager
def temporary_file(folder: Path, suffix: str = "", is_folder: bool = False) -> Iterator[Path]:
    """Make a file with a name of its own; it is removed at the end, unless it was renamed."""
    remove_abandoned(folder)
    path = folder / f"{_PREFIX}{secrets.token_hex(6)}{suffix[:_SUFFIX_LENGTH_MAX]}"
    _in_use.add(path)  # before it is there: a signal may come in between
    descriptor = None
    try:
        descriptor = _made(path, is_folder)
        yield path
    finally:
        _remove(path)
        if descriptor is not None:
            os.close(descriptor)
        _in_use.discard(path)


@contextmanager
def temporary_folder(folder: Path | None = None) -> Iterator[Path]:
    """Make a folder of the user's own in a folder, by default the system's for such ones; it is
    removed at the end with all that is in it. OSError if it cannot be made.
    """
    with temporary_file(folder or Path(tempfile.gettempdir()), is_folder=True) as path:
        yield path


def remove_temporary() -> None:
    """Remove all that this process has in use: for one that ends at once."""
    for path in list(_in_use):
        _remove(path)


def _made(path: Path, is_folder: bool) -> int | None:
    """Make it and return it open and locked; None where files cannot be locked."""
    while True:
        if is_folder:
            path.mkdir(0o700)
        else:
            path.touch(exist_ok=False)
        try:
            descriptor = _locked(path)
        except FileNotFoundError:  # it was taken for abandoned, and removed, before it was locked
            continue
        except OSError:  # a file system without locks, or Windows
            return None
        if os.fstat(descriptor).st_nlink:
            return descriptor
        os.close(descriptor)  # as above, before it was locked, but after it was opened


def _locked(path: Path, how: int = 0) -> int:
    """Open a file or folder, and lock it when nobody else does; OSError if that cannot be."""
    if sys.platform == "win32":  # which renames and removes no file that is open
        raise OSError("Windows has other locks")
    mode = os.O_RDONLY if path.is_dir() else os.O_RDWR
    descriptor = os.open(path, mode | os.O_NOFOLLOW | os.O_NONBLOCK)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | how)
    except OSError:
        os.close(descriptor)
        raise
    return descriptor


def _remove(path: Path) -> None:
    """Remove it if that can be: what goes wrong here must not hide what did before."""
    try:
        path.unlink()
    except OSError:
        shutil.rmtree(path, ignore_errors=True)


def remove_abandoned(folder: Path) -> None:
    """Remove files that ended processes have left in a folder, as far as that can be known."""
    with suppress(OSError):
        for path in list(folder.glob(f"{_PREFIX}*")):
            with suppress(OSError):  # another process has it, or has removed it
                if sys.platform != "win32":
                    descriptor = _locked(path, fcntl.LOCK_NB)
                    _remove(
                        path
                    )  # while it is locked: a maker that waits for the lock makes it again
                    os.close(descriptor)
                elif time.time() - path.stat().st_mtime > _DAY:
                    _remove(path)
