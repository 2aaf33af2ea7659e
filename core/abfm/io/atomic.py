"""Replace a file as a whole or not at all."""

import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from abfm.errors import ResultError


@contextmanager
def write_atomically(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Give a temporary path in the same folder to write to; it takes the place of ``path`` when the block ends well.

    The data is on the disk before the old file goes, so a crash or a full disk leaves the old file whole. The
    temporary file is removed if the block fails. It ends as ``path`` does, for writers that go by the suffix. A
    replaced file keeps its permissions, and a symbolic link keeps pointing at the file that is replaced.

    Raises
    ------
    ResultError
        If the operating system refuses to write.
    """
    target = Path(os.path.realpath(path))
    temporary = target.with_name(f".{target.stem}-{secrets.token_hex(6)}{target.suffix}")
    try:
        if target.is_dir():
            raise IsADirectoryError(None, "it is a folder")
        temporary.touch(exist_ok=False)
        yield temporary
        with temporary.open("rb+") as written:
            os.fsync(written.fileno())
        if target.exists():
            shutil.copymode(target, temporary)
        temporary.replace(target)
        _flush_folder(target.parent)
    except OSError as error:
        reason = error.strerror or str(error)
        raise ResultError(
            f"cannot write {path}: {reason}; choose a place that exists, is writable and has space left"
        ) from error
    finally:
        temporary.unlink(missing_ok=True)


def _flush_folder(folder: Path) -> None:
    """Make a rename in the folder outlive a power cut; Windows has no such call and needs none."""
    if os.name == "posix":
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
