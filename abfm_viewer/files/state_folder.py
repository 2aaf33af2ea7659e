"""Where the app keeps things between launches: recent files, preferences, autosaves."""

import json
import os
from contextlib import suppress
from pathlib import Path
from typing import Any

import platformdirs

from abfm import AbfmError
from abfm.io import write_atomically
from abfm.reading import read_bytes

_MOST_RECENT = 10
_LARGEST = 1 << 20  # bytes of a file of the folder
VARIABLE = "ABFM_STATE_FOLDER"


class StateFolder:
    """A folder of the user's; where it cannot be read or written, the app starts afresh every time.

    It is by default what the environment variable ABFM_STATE_FOLDER says, or the system's place for
    such things.
    """

    def __init__(self, path: Path | None = None) -> None:
        self.path = path or Path(
            os.environ.get(VARIABLE) or platformdirs.user_state_dir("abfm", appauthor=False)
        )

    def recent(self) -> list[Path]:
        """Files that were opened or saved and still exist, the latest first."""
        names = self._read("recent.json", [])
        found = []
        for name in names if isinstance(names, list) else []:
            with suppress(OSError, ValueError, TypeError):
                if (path := Path(name)).is_file():
                    found.append(path)
        return found[:_MOST_RECENT]

    def add_recent(self, path: Path) -> None:
        """Put a file first."""
        path = Path(os.path.abspath(path))
        kept = [path, *(known for known in self.recent() if known != path)]
        self._write("recent.json", [str(known) for known in kept[:_MOST_RECENT]])

    def clear_recent(self) -> None:
        """Forget all of them."""
        self._write("recent.json", [])

    def preferences(self) -> dict[str, Any]:
        """Return what the user set for all projects, by name."""
        found = self._read("preferences.json", {})
        return found if isinstance(found, dict) else {}

    def set_preference(self, name: str, value: Any) -> None:
        """Remember a value (JSON) for the next launch."""
        known = self.preferences()
        if name not in known or known[name] != value:
            self._write("preferences.json", known | {name: value})

    def _read(self, name: str, default: Any) -> Any:
        try:
            return json.loads(read_bytes(self.path / name, most=_LARGEST))
        except (OSError, ValueError, RecursionError, MemoryError):
            return default

    def _write(self, name: str, value: Any) -> None:
        with suppress(OSError, AbfmError):
            self.path.mkdir(parents=True, exist_ok=True)
            with write_atomically(self.path / name) as temporary:
                temporary.write_text(json.dumps(value, indent=1), encoding="utf-8")
