"""Folder in which the app stores recent files, preferences and autosaved copies."""

import json
import os
from contextlib import suppress
from pathlib import Path
from typing import Any

from abfm import AbfmError
from abfm.io import write_atomically
from abfm.reading import read_bytes

_RECENT_FILES_MAX = 10
_FILE_BYTES_MAX = 1 << 20
STATE_VARIABLE = "ABFM_STATE_FOLDER"


class StateFolder:
    """Folder that stores the state of the app between launches.

    By default it is the folder in the environment variable ABFM_STATE_FOLDER, or else the system's
    folder for state. If the folder cannot be read or written, nothing is stored.
    """

    def __init__(self, path: Path | None = None) -> None:
        if path is None and (named := os.environ.get(STATE_VARIABLE)):
            path = Path(named)
        elif path is None:
            import platformdirs  # the library must not depend on it

            path = Path(platformdirs.user_state_dir("abfm", appauthor=False))
        self.path = path

    def recent(self) -> list[tuple[Path, ...]]:
        """Return recently opened files and results folders that still exist, the latest first.

        An entry of two files is a mesh with a second mesh or with frames.
        """
        found = []
        for names in self.read("recent.json", list):
            with suppress(OSError, ValueError, TypeError):
                paths = tuple(map(Path, names if isinstance(names, list) else [names]))
                if paths and all(path.is_file() or (path / "ledger").is_dir() for path in paths):
                    found.append(paths[:2])
        return found[:_RECENT_FILES_MAX]

    def add_recent(self, *paths: Path) -> None:
        """Add a file, or two that were opened together, in place of an entry of the first alone."""
        new = tuple(Path(os.path.abspath(path)) for path in paths)
        entries = [new, *(known for known in self.recent() if known not in (new, new[:1]))]
        names = [[*map(str, entry)] for entry in entries[:_RECENT_FILES_MAX]]
        self.write("recent.json", [name[0] if len(name) == 1 else name for name in names])

    def clear_recent(self) -> None:
        self.write("recent.json", [])

    def read(self, name: str, kind: type[Any]) -> Any:
        """Return the contents of a JSON file; empty if they are not of type ``kind``."""
        with suppress(OSError, ValueError, RecursionError, MemoryError):
            found = json.loads(read_bytes(self.path / name, size_max=_FILE_BYTES_MAX))
            if isinstance(found, kind):
                return found
        return kind()

    def write(self, name: str, value: Any) -> None:
        """Write a JSON file, completely or not at all; do nothing if that is impossible."""
        with suppress(OSError, AbfmError):
            self.path.mkdir(parents=True, exist_ok=True)
            with write_atomically(self.path / name) as temporary:
                temporary.write_text(json.dumps(value, indent=1), encoding="utf-8")
