"""The file dialog: a path, a list of files, and a name for files to save."""

import os
import re
from dataclasses import dataclass, field
from pathlib import Path

import polyscope.imgui as imgui

from abfm_viewer.computing.background import Latest
from abfm_viewer.widgets.containers import child, dialog
from abfm_viewer.widgets.toolkit import Ui

ENTRIES_MAX = 10_000  # largest number of entries that are listed
_ENDING = re.compile(r"\.[A-Za-z][A-Za-z0-9]{0,4}")  # ending of any file name
_NOT_IN_NAMES = re.compile(r'[<>:"/\\|?*\x00-\x1f]')  # characters that Windows refuses
_WIDTH = 640
_HEIGHT = 480
_MARGIN_ROWS = 200  # number of rows drawn above and below the visible rows


@dataclass(frozen=True)
class FolderEntry:
    name: str
    is_folder: bool

    @property
    def label(self) -> str:
        """Displayed name; names of folders end in a slash."""
        return shown(self.name) + "/" * self.is_folder


@dataclass(frozen=True)
class Listing:
    """Entries of a folder, folders first."""

    entries: tuple[FolderEntry, ...] = ()
    note: str = ""  # if the list is incomplete
    error: str = ""  # if the folder cannot be read

    @property
    def names(self) -> list[str]:
        return [entry.name for entry in self.entries]


def read_folder(folder: Path, suffixes: tuple[str, ...]) -> Listing:
    """Return the entries of a folder without hidden files, or the reason if it cannot be read."""
    found = []
    try:
        with os.scandir(folder) as entries:
            for entry in entries:
                is_folder = _is_folder(entry)
                is_shown = is_folder or has_suffix(entry.name, suffixes)
                if is_shown and not entry.name.startswith("."):
                    found.append(FolderEntry(entry.name, is_folder))
    except OSError as error:
        return Listing(error=f"{folder} cannot be read: {error.strerror or error}")
    found.sort(key=lambda entry: (not entry.is_folder, entry.name.casefold(), entry.name))
    note = (
        f"the list has the first {ENTRIES_MAX:,} of {len(found):,} names; type the name of any "
        "other file"
    )
    return Listing(tuple(found[:ENTRIES_MAX]), note if len(found) > ENTRIES_MAX else "")


def valid_name(text: str) -> str:
    """Return a file name that is valid on Linux, macOS and Windows.

    Other characters are replaced by underscores.
    """
    return _NOT_IN_NAMES.sub("_", text)


def has_suffix(name: str, suffixes: tuple[str, ...]) -> bool:
    """Return whether a file name ends in one of the suffixes, ignoring case."""
    return not suffixes or name.lower().endswith(suffixes)


def _types_text(suffixes: tuple[str, ...]) -> str:
    """Return the suffixes without dots, because ImGui breaks lines at dots."""
    compressed = {f"{each}.gz" for each in suffixes}
    plain = [each for each in suffixes if each not in compressed]
    note = "; also compressed (gz)" if len(plain) < len(suffixes) else ""
    return ", ".join(each.removeprefix(".") for each in plain) + note


def shown(path: str | Path) -> str:
    """Return a path that can be drawn; invalid UTF-8 is replaced by question marks."""
    return os.fsencode(path).decode("utf-8", "replace")


def _is_folder(entry: os.DirEntry[str]) -> bool:
    try:
        return entry.is_dir()
    except OSError:
        return False


@dataclass(eq=False)
class FileChoice:
    """State of a file dialog."""

    folder: Path
    suffixes: tuple[str, ...]  # allowed ones
    saving: bool = False  # whether a file to write is chosen, which need not exist
    name: str = ""  # typed name of a file to write; without an ending it gets the first suffix
    selected: str = field(default="", init=False)  # name of an entry
    error: str = field(default="", init=False)  # why the last action was refused
    _reads: int = field(default=0, init=False)
    _listing: Latest[Listing] = field(default_factory=Latest, init=False)

    def listing(self) -> Listing | None:
        """Return the entries of the folder; None while they are read."""
        folder, suffixes = self.folder, self.suffixes
        return self._listing.request((self._reads, folder), lambda: read_folder(folder, suffixes))

    def go(self, folder: Path) -> None:
        """Show a folder; if it is shown already, read it again."""
        self.folder, self.selected, self.error = folder, "", ""
        self._reads += 1

    def go_up(self) -> None:
        child_folder = self.folder
        self.go(child_folder.parent)
        self.selected = child_folder.name

    def select(self, entry: FolderEntry) -> None:
        """Select an entry; in a dialog for saving, a selected file also sets the name."""
        self.selected, self.error = entry.name, ""
        if self.saving and not entry.is_folder:
            self.name = entry.name

    def move_selection(self, step: int) -> None:
        """Select the entry ``step`` entries further, or the first one if none is selected."""
        if (listing := self.listing()) is not None and (names := listing.names):
            place = names.index(self.selected) + step if self.selected in names else 0
            self.select(listing.entries[min(max(place, 0), len(names) - 1)])

    def go_or_take(self, typed: str) -> Path | None:
        """Return a typed file, or show a typed folder and return None.

        In a dialog for saving, a typed file is not returned. Its folder is shown and its name
        becomes the name to save. If the path is neither, `error` is set.
        """
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
        if self.saving and self.name.strip():
            return self._named()
        return self.go_or_take(self.selected) if self.selected else None

    @property
    def ready(self) -> bool:
        return bool(self.selected or (self.saving and self.name.strip()))

    @property
    def final_name(self) -> str:
        name = self.name.strip()
        is_complete = not name or has_suffix(name, self.suffixes) or self.has_other_ending
        return name if is_complete else name + self.suffixes[0]

    @property
    def has_other_ending(self) -> bool:
        """Whether the name of a file to save has an ending that is not allowed."""
        name = self.name.strip()
        is_known = not self.suffixes or has_suffix(name, self.suffixes)
        return not is_known and _ENDING.fullmatch(Path(name).suffix) is not None

    def close(self) -> None:
        self._listing.close()

    def _taken(self, path: Path) -> Path | None:
        if not path.exists():
            listed = self._listing.value
            vanished = listed is not None and path.name in listed.names
            self.go(self.folder)
            self.error = f"{path.name} no longer exists" if vanished else f"{path} does not exist"
        elif not has_suffix(path.name, self.suffixes):
            self.error = f"{path.name}: expected a file that ends in {', '.join(self.suffixes)}"
        else:
            return path
        return None

    def _named(self) -> Path | None:
        try:
            path = self.folder / Path(self.final_name).expanduser()
            if self.has_other_ending:
                known = ", ".join(self.suffixes)
                self.error = f"{path.name}: expected a name that ends in {known}, or has no ending"
            elif path.name.startswith("."):
                name = self.name.strip()
                self.error = f"{name} starts with a dot and would be hidden; choose another name"
            elif path.is_dir():
                self.error = f"{path.name} is a folder; choose another name"
            elif not path.parent.is_dir():
                self.error = f"the folder {path.parent} does not exist"
            else:
                return path
        except (OSError, RuntimeError, ValueError) as error:
            self.error = f"{self.name}: {_reason(error)}"
        return None


def _reason(error: Exception) -> str:
    return (error.strerror if isinstance(error, OSError) else None) or str(error)


@dataclass
class FileDialog:
    title: str
    choice: FileChoice
    _scroll_to: str = field(default="", init=False)
    _is_new: bool = field(default=True, init=False)

    def draw(self, ui: Ui) -> tuple[Path | None] | None:
        """Draw the dialog; return (file,) if chosen, (None,) if cancelled, and otherwise None."""
        with dialog(ui, self.title, _WIDTH, _HEIGHT):
            taken, typing = self._draw_path(ui)
            below = 2 if self.choice.saving else 1
            line = imgui.GetFrameHeightWithSpacing()
            with child(ui, "files", -(below * line + self._note_height(ui))):
                taken = self._draw_list(ui) or taken
            note, is_error = self._note()
            ui.note(note, "failure" if is_error else "muted")
            if self.choice.saving:
                self._draw_name(ui)
            word = "Save" if self.choice.saving else "Open"
            pressed = ui.button(word, enabled=self.choice.ready, primary=True, width=ui.px(110))
            ui.same_line()
            cancelled = ui.button("Cancel", "Esc", width=ui.px(110))
            if not typing:
                cancelled = cancelled or imgui.IsKeyPressed(imgui.ImGuiKey_Escape, False)
                keys = (imgui.ImGuiKey_Enter, imgui.ImGuiKey_KeypadEnter)
                pressed = pressed or any(imgui.IsKeyPressed(key, False) for key in keys)
            if not imgui.GetIO().WantTextInput:
                self._move_by_keys()
            if cancelled:
                return (None,)
            if pressed and taken is None:
                taken = self.choice.confirm()
        return None if taken is None else (taken,)

    def _draw_path(self, ui: Ui) -> tuple[Path | None, bool]:
        """Draw the path, Up and Home.

        Return the file whose path the user typed, or None, and whether the user is typing.
        """
        with ui.disabled(self.choice.folder == self.choice.folder.parent):
            if ui.button("Up", "Show the parent folder (Alt+Up)."):
                self._go_up()
        ui.same_line()
        if ui.button("Home", "Show your home folder."):
            self.choice.go(Path.home())
        ui.same_line()
        tip = "Type a folder or a file; ~ is your home folder."
        typed = ui.text("folder", shown(self.choice.folder), tip)
        return (None if typed is None else self.choice.go_or_take(typed)), ui.typing

    def _draw_list(self, ui: Ui) -> Path | None:
        listing = self.choice.listing()
        if listing is None:
            ui.note("reading ...")
            return None
        if listing.entries:
            return self._draw_entries(ui, listing)
        nothing = f"no folders and no files of these types: {_types_text(self.choice.suffixes)}"
        ui.note(listing.error or nothing, "failure" if listing.error else "muted")
        return None

    def _draw_entries(self, ui: Ui, listing: Listing) -> Path | None:
        """Draw the visible rows and some around them, as drawing all rows would be slow."""
        row = imgui.GetTextLineHeightWithSpacing()
        entries = listing.entries
        self._scroll(listing, row)
        first = max(0, int(imgui.GetScrollY() / row) - _MARGIN_ROWS)
        last = first + int(imgui.GetWindowHeight() / row) + 2 * _MARGIN_ROWS
        top = imgui.GetCursorPosY()
        imgui.SetCursorPosY(top + first * row)
        taken = None
        for entry in entries[first:last]:
            pressed, twice = ui.row(entry.label, self.choice.selected == entry.name)
            if pressed:
                self.choice.select(entry)
            if twice and entry.is_folder:
                self.choice.go_or_take(entry.name)
            elif twice:
                taken = self.choice.confirm() or taken
        imgui.SetCursorPosY(top + len(entries) * row)
        imgui.Dummy((1, 1))
        return taken

    def _draw_name(self, ui: Ui) -> None:
        hint = "name of the file to write"
        typed = ui.live_text("file name", self.choice.name, hint, focus=self._is_new)
        self._is_new = False
        if typed != self.choice.name:
            self.choice.name, self.choice.error = typed, ""

    def _note_height(self, ui: Ui) -> float:
        width = imgui.GetContentRegionAvail()[0]
        height = imgui.CalcTextSize(self._note()[0], wrap_width=width)[1]
        return float(height + imgui.GetStyle().ItemSpacing[1])

    def _note(self) -> tuple[str, bool]:
        """Return the text below the list, and whether it is an error."""
        choice = self.choice
        listing = choice.listing()
        if choice.error:
            return choice.error, True
        if listing is not None and listing.note:
            return listing.note, False
        if choice.saving and choice.final_name != choice.name.strip():
            return f"will be saved as {choice.final_name}", False
        return f"file types: {_types_text(choice.suffixes)}", False

    def _move_by_keys(self) -> None:
        up = imgui.IsKeyPressed(imgui.ImGuiKey_UpArrow)
        down = imgui.IsKeyPressed(imgui.ImGuiKey_DownArrow)
        if up and imgui.GetIO().KeyAlt:
            self._go_up()
        elif up or down:
            self.choice.move_selection(-1 if up else 1)
            self._scroll_to = self.choice.selected

    def _go_up(self) -> None:
        self.choice.go_up()
        self._scroll_to = self.choice.selected

    def _scroll(self, listing: Listing, row: float) -> None:
        """Scroll to the entry that was selected by the keyboard."""
        names = listing.names if self._scroll_to else []
        if self._scroll_to in names:
            top, first = names.index(self._scroll_to) * row, imgui.GetScrollY()
            height = imgui.GetWindowHeight()
            if not first <= top <= first + height - 2 * row:
                imgui.SetScrollY(max(top - height / 2, 0))
        self._scroll_to = ""
