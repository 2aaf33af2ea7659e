"""Replace a file as a whole or not at all."""

import os
import shutil
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from abfm.errors import ResultError
from abfm.io.temporary import temporary_file
from abfm.reading.door import SPECIAL

_NO_FILES = SPECIAL | {stat.S_IFDIR: "a folder"}


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
    try:
        target = _target(path)
        with temporary_file(target.parent, target.suffix) as temporary:
            yield temporary
            with temporary.open("rb+") as written:
                os.fsync(written.fileno())
            if target.exists():
                shutil.copymode(target, temporary)
            temporary.replace(target)
            _flush_folder(target.parent)
    except OSError as error:
        raise _refusal(path, error) from error


def check_writable(path: str | os.PathLike[str]) -> None:
    """Refuse, before there is anything to write, a path that `write_atomically` would refuse.

    Raises
    ------
    ResultError
        As there, and if there is a file that may not be written.
    """
    try:
        target = _target(path)
        with temporary_file(target.parent, target.suffix):
            pass
        if target.exists() and not os.access(target, os.W_OK):
            raise PermissionError(None, "no permission to replace it")
    except OSError as error:
        raise _refusal(path, error) from error


def _target(path: str | os.PathLike[str]) -> Path:
    """Return the file that a path means; OSError if it has no place for one."""
    try:
        target = Path(os.path.realpath(path))
        kind = stat.S_IFMT(target.stat().st_mode)
    except FileNotFoundError:
        return target
    except ValueError:
        raise OSError(None, "its name has a zero byte") from None
    if kind in _NO_FILES:
        raise OSError(None, f"it is {_NO_FILES[kind]}, no place for a file")
    return target


def _refusal(path: str | os.PathLike[str], error: OSError) -> ResultError:
    reason = error.strerror or str(error)
    return ResultError(
        f"cannot write {path}: {reason}; choose a place that exists, is writable and has space left"
    )


def _flush_folder(folder: Path) -> None:
    """Make a rename in the folder outlive a power cut; Windows has no such call and needs none."""
    if os.name == "posix":
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
