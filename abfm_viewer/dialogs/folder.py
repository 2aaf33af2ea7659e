"""What a file dialog lists: the folders of a folder, and its files with certain suffixes."""

import os
from dataclasses import dataclass
from pathlib import Path

MOST = 10_000
"""Entries of a folder that are listed."""


@dataclass(frozen=True)
class Entry:
    """A folder or file."""

    name: str
    is_folder: bool

    @property
    def label(self) -> str:
        """The name as it is shown; a folder's ends in a slash."""
        return shown(self.name) + "/" * self.is_folder


@dataclass(frozen=True)
class Listing:
    """A folder's entries, folders first; and why that is not everything, or nothing."""

    entries: tuple[Entry, ...] = ()
    note: str = ""
    error: str = ""


def read_folder(folder: Path, suffixes: tuple[str, ...]) -> Listing:
    """List a folder without hidden files; the reason instead if it cannot be read."""
    found = []
    try:
        with os.scandir(folder) as entries:
            for entry in entries:
                is_folder = _is_folder(entry)
                is_shown = is_folder or has_suffix(entry.name, suffixes)
                if is_shown and not entry.name.startswith("."):
                    found.append(Entry(entry.name, is_folder))
    except OSError as error:
        return Listing(error=f"{folder} cannot be read: {error.strerror or error}")
    found.sort(key=lambda entry: (not entry.is_folder, entry.name.casefold(), entry.name))
    note = ""
    if len(found) > MOST:
        note = f"the first {MOST:,} of {len(found):,}: type the name of another one"
    return Listing(tuple(found[:MOST]), note)


def has_suffix(name: str, suffixes: tuple[str, ...]) -> bool:
    """Return whether a file's name ends in one of the suffixes, in capitals or not."""
    return name.lower().endswith(suffixes) if suffixes else True


def shown(path: str | Path) -> str:
    """Return a path that can be drawn: bytes that are no text become question marks."""
    return os.fsencode(path).decode("utf-8", "replace")


def _is_folder(entry: os.DirEntry[str]) -> bool:
    try:
        return entry.is_dir()
    except OSError:
        return False
