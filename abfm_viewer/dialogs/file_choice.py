"""A choice of a file, without the drawing: the folder, what is selected, what a name means."""

from pathlib import Path

from abfm_viewer.computing.background import Latest
from abfm_viewer.dialogs.folder import Entry, Listing, has_suffix, read_folder


class FileChoice:
    """A folder, its entries, of which one is `selected`, and why the last step was refused.

    A file for `saving` need not exist: its `name` is typed, and gets the first of the suffixes if
    it has none of them.
    """

    def __init__(
        self, folder: Path, suffixes: tuple[str, ...], saving: bool = False, name: str = ""
    ) -> None:
        self.folder = folder
        self.suffixes = suffixes
        self.saving = saving
        self.selected = ""
        self.name = name
        self.error = ""
        self._reads = 0
        self._listing: Latest[Listing] = Latest()

    def listing(self) -> Listing | None:
        """Return the folder's entries; None while they are read, which may take long."""
        folder, suffixes = self.folder, self.suffixes
        return self._listing.ask((self._reads, folder), lambda: read_folder(folder, suffixes))

    def go(self, folder: Path) -> None:
        """Show another folder, or the same one anew."""
        self.folder, self.selected, self.error = folder, "", ""
        self._reads += 1

    def go_up(self) -> None:
        """Show the folder that this one is in, with this one marked."""
        below = self.folder.name
        self.go(self.folder.parent)
        self.selected = below

    def select(self, entry: Entry) -> None:
        """Mark an entry; a file to save over gives its name."""
        self.selected, self.error = entry.name, ""
        if self.saving and not entry.is_folder:
            self.name = entry.name

    def move_selection(self, step: int) -> None:
        """Mark the entry before or after the marked one; the first one if none is."""
        if (listing := self.listing()) is not None and listing.entries:
            names = [entry.name for entry in listing.entries]
            place = names.index(self.selected) + step if self.selected in names else 0
            self.select(listing.entries[min(max(place, 0), len(names) - 1)])

    def go_or_take(self, typed: str) -> Path | None:
        """Follow a path from the shown folder: go to a folder, take a file, or refuse."""
        try:
            path = (self.folder / Path(typed.strip()).expanduser()).resolve()
            if path.is_dir():
                self.go(path)
            elif self.saving and path.parent.is_dir():
                self.go(path.parent)
                self.name = path.name
            else:
                return self._taken(path)
        except (OSError, RuntimeError, ValueError) as error:
            self.error = f"{typed}: {_reason(error)}"
        return None

    def confirm(self) -> Path | None:
        """Take the typed or marked file, or go to the marked folder."""
        if self.saving and self.name.strip():
            return self._named()
        return self.go_or_take(self.selected) if self.selected else None

    @property
    def ready(self) -> bool:
        return bool(self.selected or (self.saving and self.name.strip()))

    @property
    def final_name(self) -> str:
        """The typed name with its suffix."""
        name = self.name.strip()
        return name if not name or has_suffix(name, self.suffixes) else name + self.suffixes[0]

    def close(self) -> None:
        self._listing.close()

    def _taken(self, path: Path) -> Path | None:
        if not path.exists():
            listed = self._listing.value
            names = [entry.name for entry in listed.entries] if listed else []
            vanished = path.name in names
            self.go(self.folder)
            self.error = f"{path.name} is no longer there" if vanished else f"there is no {path}"
        elif not has_suffix(path.name, self.suffixes):
            self.error = f"{path.name}: expected a file that ends in {', '.join(self.suffixes)}"
        else:
            return path
        return None

    def _named(self) -> Path | None:
        try:
            path = self.folder / Path(self.final_name).expanduser()
            if path.name.startswith("."):
                name = self.name.strip()
                self.error = f"{name}: begin the name with no dot, which hides files"
            elif path.is_dir():
                self.error = f"{path.name} is a folder: choose another name"
            elif not path.parent.is_dir():
                self.error = f"there is no folder {path.parent}"
            else:
                return path
        except (OSError, RuntimeError, ValueError) as error:
            self.error = f"{self.name}: {_reason(error)}"
        return None


def _reason(error: Exception) -> str:
    return (error.strerror if isinstance(error, OSError) else None) or str(error)
