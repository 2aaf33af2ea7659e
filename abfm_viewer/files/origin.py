"""The project file that a document belongs to, and whether somebody else has written it since."""

from __future__ import annotations

import json
import os
from dataclasses import asdict, dataclass
from pathlib import Path

from abfm import ResultError
from abfm.io.results import open_archive

MEMBER = "origin.json"
"""Where a copy of unsaved work says what it is a copy of."""


@dataclass(frozen=True)
class Origin:
    """A project file, and when (ns) it was modified, and its bytes, when last read or written."""

    path: Path
    modified: int
    size: int

    @classmethod
    def of(cls, path: Path) -> Origin:
        """The file as it is now; with a negative size if there is none."""
        return cls(path, *_state(path))

    @property
    def exists(self) -> bool:
        return _state(self.path)[1] >= 0

    @property
    def changed(self) -> bool:
        """Return whether there is such a file now, and not as it was."""
        return self.exists and _state(self.path) != (self.modified, self.size)

    def to_json(self) -> str:
        return json.dumps(asdict(self), default=str)


def load_origin(copy: str | os.PathLike[str]) -> Origin | None:
    """Read what a copy of unsaved work is a copy of; None if of no file that is still there."""
    try:
        with open_archive(copy, "project", "") as archive:
            plain = json.loads(archive.read(MEMBER))
            origin = Origin(Path(plain["path"]), int(plain["modified"]), int(plain["size"]))
    except ResultError:
        return None
    return origin if origin.exists else None


def _state(path: Path) -> tuple[int, int]:
    try:
        found = path.stat()
    except (OSError, ValueError):
        return 0, -1
    return found.st_mtime_ns, found.st_size
