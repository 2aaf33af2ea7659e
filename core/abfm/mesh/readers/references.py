"""Files that a mesh file refers to: materials, images and buffers."""

import os
from pathlib import Path

from abfm.errors import brief
from abfm.reading import read_bytes, referenced_file

BYTES_MAX = 1 << 28  # total size of the files that a file refers to


class References:
    """Reader of the files that a mesh file refers to; their total size is limited.

    They must be in the folder of the mesh file or below it. A path from another computer often
    leads elsewhere or to no file. In this case a file of the same name in the folder is read,
    regardless of upper and lower case.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._budget, self.size = path, BYTES_MAX, 0
        self._found: dict[str, Path] = {}
        self._contents: dict[Path, bytes] = {}
        self._names_in_folder: dict[str, str] | None = None

    def read(self, name: str) -> bytes:
        """Return the bytes of a file, read once; OSError if unreadable, ValueError if refused."""
        path = self.find(name)
        if path not in self._contents:
            content = read_bytes(path, self._budget)
            self.spend(len(content), name)
            self._contents[path] = content
            self.size += len(content)
        return self._contents[path]

    def spend(self, count: int, what: str) -> None:
        """Subtract bytes of ``what`` from those still allowed; ValueError if too few remain."""
        self._budget -= count
        if self._budget < 0:
            raise ValueError(
                f"{brief(what)} and the other files that the file refers to have too many "
                f"bytes in total; expected at most {BYTES_MAX}"
            )

    def find(self, name: str) -> Path:
        if name not in self._found:
            self._found[name] = self._find(name)
        return self._found[name]

    def _find(self, name: str) -> Path:
        plain = name.strip().strip('"')
        slashed = plain.replace("\\", "/")
        error = None
        for candidate in dict.fromkeys((plain, slashed)):
            try:
                path = referenced_file(self._path, candidate)
            except ValueError as outside:
                error = outside
                continue
            if path.exists():
                return path
        base = slashed.rpartition("/")[2].lower()
        if self._names_in_folder is None:
            folder = os.path.dirname(self._path) or "."
            self._names_in_folder = {each.lower(): each for each in sorted(os.listdir(folder))}
        if base in self._names_in_folder:
            return self._path.parent / self._names_in_folder[base]
        if error is not None:
            raise error
        return referenced_file(self._path, slashed)
