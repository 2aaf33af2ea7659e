"""Files that a mesh file refers to: materials, images, buffers."""

import os
from pathlib import Path

from abfm.errors import brief
from abfm.reading import read_bytes, referenced_file

BYTES_MAX = 1 << 28
"""Of everything that a file refers to."""


class References:
    """Reads the files that a file names, each once, and all of them within one budget of bytes.

    They are in its folder or below. A name that leads elsewhere, or to no file, as those of other
    machines do, stands for a file of that name next to it, in capitals or not, if there is one.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._left, self.size = path, BYTES_MAX, 0
        self._found: dict[str, Path] = {}
        self._contents: dict[Path, bytes] = {}
        self._beside: dict[str, str] | None = None

    def read(self, name: str) -> bytes:
        """Return the bytes of a file.

        An OSError reports that it cannot be read, a ValueError that it is outside the folder, or
        that the budget is spent.
        """
        path = self.find(name)
        if path not in self._contents:
            content = read_bytes(path, self._left)
            self.spend(len(content), name)
            self._contents[path] = content
            self.size += len(content)
        return self._contents[path]

    def spend(self, count: int, what: str) -> None:
        """Take bytes from the budget."""
        self._left -= count
        if self._left < 0:
            raise ValueError(
                f"{brief(what)} and what it refers to besides have more than {BYTES_MAX} bytes"
            )

    def find(self, name: str) -> Path:
        """Return the path of a file that is named."""
        if name not in self._found:
            self._found[name] = self._find(name)
        return self._found[name]

    def _find(self, name: str) -> Path:
        plain = name.strip().strip('"')
        slashed = plain.replace("\\", "/")
        error = None
        for given in dict.fromkeys((plain, slashed)):
            try:
                path = referenced_file(self._path, given)
            except ValueError as outside:
                error = outside
                continue
            if path.exists():
                return path
        base = slashed.rpartition("/")[2].lower()
        if self._beside is None:
            folder = os.path.dirname(self._path) or "."
            self._beside = {each.lower(): each for each in sorted(os.listdir(folder))}
        if base in self._beside:
            return self._path.parent / self._beside[base]
        if error is not None:
            raise error
        return referenced_file(self._path, slashed)
