"""The file dialog: a path, a list of files with a search, a file name, and a preview."""

import os
import re
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_args

import polyscope.imgui as imgui
from rich.filesize import decimal

from abfm_viewer.computing.background import Latest, Memo
from abfm_viewer.widgets.containers import child, dialog, is_popup_open
from abfm_viewer.widgets.toolkit import Pushed, Ui

ENTRIES_MAX = 10_000  # largest number of entries that are listed
_ENDING = re.compile(r"\.[A-Za-z][A-Za-z0-9]{0,4}")  # ending of any file name
_WIDTH = 860
_HEIGHT = 560
_PREVIEW_WIDTH = 240
_LIST_WIDTH_MIN = 300  # with a preview next to the list
_DATE_LIST_WIDTH_MIN = 380  # with a column for dates
_SEARCH_WIDTH = 190
_MARGIN_ROWS = 200  # number of rows drawn above and below the visible rows
_PAGE_ROWS = 10
_RECENT_LABEL = "Recent folders"
Column = Literal["name", "size", "date"]


class Preview(NamedTuple):
    """Picture of a file as a texture of ImGui, None without one, and lines of text below it."""

    texture: Any
    size: tuple[int, int]  # of the picture, in pixels
    lines: tuple[str, ...]


class Details(NamedTuple):
    size: int  # in bytes
    date: float  # of the last change, in seconds since the epoch


@dataclass(frozen=True)
class FolderEntry:
    name: str
    is_folder: bool

    @property
    def label(self) -> str:
        """Displayed name; names of folders end in a slash."""
        return shown(self.name) + "/" * self.is_folder


@dataclass(frozen=True, eq=False)
class Listing:
    """Entries of a folder, folders first."""

    entries: Sequence[FolderEntry] = ()
    note: str = ""  # if the list is incomplete
    error: str = ""  # if the folder cannot be read


def read_folder(folder: Path, suffixes: tuple[str, ...], hidden: bool = False) -> Listing:
    """Return the entries of a folder, or the reason if it cannot be read."""
    found = []
    try:
        with os.scandir(folder) as entries:
            for entry in entries:
                is_folder = _is_folder(entry)
                is_shown = is_folder or has_suffix(entry.name, suffixes)
                if is_shown and (hidden or not entry.name.startswith(".")):
                    found.append(FolderEntry(entry.name, is_folder))
    except OSError as error:
        return Listing(error=f"{folder} cannot be read: {error.strerror or error}")
    found.sort(key=lambda entry: (not entry.is_folder, entry.name.casefold(), entry.name))
    note = (
        f"the list has the first {ENTRIES_MAX:,} of {len(found):,} names; type the name of any "
        "other file"
    )
    return Listing(tuple(found[:ENTRIES_MAX]), note if len(found) > ENTRIES_MAX else "")


def read_details(folder: Path, entries: Sequence[FolderEntry]) -> dict[str, Details]:
    """Return sizes and dates of entries by their names, without those that cannot be read."""
    found = {}
    for entry in entries:
        try:
            state = (folder / entry.name).stat()
        except (OSError, ValueError):
            continue
        found[entry.name] = Details(state.st_size, state.st_mtime)
    return found


def date_text(modified: float) -> str:
    try:
        return time.strftime("%Y-%m-%d %H:%M", time.localtime(modified))
    except (OverflowError, OSError, ValueError):
        return ""


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
    """State of a file dialog.

    When a file is opened, the name is that of the selected entry, or typed. When a file is written,
    it need not exist, and a name without an ending gets the first suffix.
    """

    folder: Path
    suffixes: tuple[str, ...]  # allowed ones
    saving: bool = False  # whether a file to write is chosen
    name: str = ""
    search: str = ""  # only entries that contain this text are listed
    hidden: bool = False  # whether hidden files are listed
    selected: str = field(default="", init=False)  # name of an entry
    error: str = field(default="", init=False)  # why the last action was refused
    order: tuple[Column, bool] = field(default=("name", False), init=False)  # and if descending
    is_typed: bool = field(default=False, init=False)  # whether the user typed the name
    _enters: bool = field(default=False, init=False)  # whether the user selected a folder
    _reads: int = field(default=0, init=False)
    _listing: Latest[Listing] = field(default_factory=Latest, init=False)
    _details: Latest[dict[str, Details]] = field(default_factory=Latest, init=False)
    _entries: Memo[Sequence[FolderEntry]] = field(default_factory=Memo, init=False)

    def listing(self) -> Listing | None:
        """Return the entries of the folder; None while they are read."""
        inputs = self.folder, self.suffixes, self.hidden
        return self._listing.request((self._reads, inputs), partial(read_folder, *inputs))

    def details(self) -> Mapping[str, Details]:
        """Return sizes and dates by the names of entries; empty until they are read."""
        if (listing := self.listing()) is None:
            return {}
        read = partial(read_details, self.folder, listing.entries)
        return self._details.request((self._listing.key, listing), read) or {}

    def entries(self) -> Sequence[FolderEntry]:
        """Return the entries that match the search, in the chosen order.

        The result is empty while they are read. Folders are first in every order.
        """
        if (listing := self.listing()) is None:
            return ()
        details = self.details() if self.order[0] != "name" else {}
        inputs = listing, self.search, self.order, details
        return self._entries.get(inputs, lambda: self._ordered(listing, details))

    def _ordered(self, listing: Listing, details: Mapping[str, Details]) -> Sequence[FolderEntry]:
        (column, descending), found = self.order, listing.entries
        if wanted := self.search.strip().casefold():
            found = [entry for entry in found if wanted in entry.name.casefold()]
        if column == "name" and not descending:
            return found

        def key(entry: FolderEntry) -> Any:
            known = details.get(entry.name, Details(0, 0.0))
            return entry.name.casefold() if column == "name" else getattr(known, column)

        found = sorted(found, key=key, reverse=descending)
        return sorted(found, key=lambda entry: not entry.is_folder)

    def order_by(self, column: Column) -> None:
        """Sort by a column; a second call reverses the order. Largest and newest come first."""
        is_same = self.order[0] == column
        self.order = column, not self.order[1] if is_same else column != "name"

    def look_for(self, text: str) -> None:
        """Set the search, and select the first entry that matches it."""
        self.search, self.selected = text, ""
        if text.strip() and (entries := self.entries()):
            self.select(next((one for one in entries if not one.is_folder), entries[0]))

    def type_name(self, name: str) -> None:
        """Set the name, and select the entry that it names or, for a file to open, begins."""
        self.name, self.error, self.is_typed = name, "", True
        self.selected, self._enters = "", False
        start = name.strip().casefold()
        if start and not self.saving:
            match = (one for one in self.entries() if one.name.casefold().startswith(start))
            self.selected = next((one.name for one in match), "")

    def go(self, folder: Path) -> None:
        """Show a folder; if it is shown already, read it again."""
        self.folder, self.selected, self.error, self.search = folder, "", "", ""
        self._enters = False
        if not self.saving:
            self.name, self.is_typed = "", False
        self._reads += 1

    def go_up(self) -> None:
        child_folder = self.folder
        self.go(child_folder.parent)
        self.selected = child_folder.name

    def select(self, entry: FolderEntry) -> None:
        """Select an entry; unless it is a folder in a dialog for saving, it also sets the name."""
        self.selected, self.error, self._enters = entry.name, "", entry.is_folder
        if not (self.saving and entry.is_folder):
            self.name, self.is_typed = shown(entry.name), False

    def move_selection(self, step: int) -> None:
        """Select the entry ``step`` entries further, or the first one if none is selected."""
        if entries := self.entries():
            names = [entry.name for entry in entries]
            place = names.index(self.selected) + step if self.selected in names else 0
            self.select(entries[min(max(place, 0), len(names) - 1)])

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
        """Return the file of the name or the selection; show it instead if it is a folder."""
        name = self.name.strip()
        if self.saving:
            if self._enters:
                return self.go_or_take(self.selected)
            return self._named() if name else None
        is_start = self.selected and not os.path.exists(self.folder / os.path.expanduser(name))
        if name and self.is_typed and not is_start:
            return self.go_or_take(name)
        return self.go_or_take(self.selected) if self.selected else None

    @property
    def final_name(self) -> str:
        name = self.name.strip()
        is_complete = not name or has_suffix(name, self.suffixes) or self.has_other_ending
        return name if is_complete else name + self.suffixes[0]

    @property
    def has_other_ending(self) -> bool:
        """Whether the name of a file to save has an ending that is not allowed."""
        name = self.name.strip()
        has_ending = _ENDING.fullmatch(Path(name).suffix) is not None
        return has_ending and not has_suffix(name, self.suffixes)

    def close(self) -> None:
        self._listing.close()
        self._details.close()

    def _taken(self, path: Path) -> Path | None:
        if not path.exists():
            listed = self._listing.value
            names = [] if listed is None else [entry.name for entry in listed.entries]
            vanished = path.name in names
            self.selected = ""
            self._reads += 1
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


@dataclass(eq=False)
class FileDialog:
    """A file dialog with keys: arrows, Enter, Backspace and Alt+Up for the parent, Esc, names."""

    title: str
    choice: FileChoice
    recent: Sequence[Path] = ()  # folders that were used for this kind of file
    preview: Callable[[Path], Preview | None] = lambda path: None
    _scroll_to: str = field(default="", init=False)
    _focuses: bool = field(default=True, init=False)  # whether the name gets the keyboard focus
    _double_clicked: bool = field(default=False, init=False)
    _changes: int = field(default=0, init=False)  # of the name, other than by typing

    def draw(self, ui: Ui) -> tuple[Path | None] | None:
        """Draw the dialog; return (file,) if chosen, (None,) if cancelled, and otherwise None."""
        choice, before = self.choice, (self.choice.folder, self.choice.selected)
        with dialog(ui, self.title, _WIDTH, _HEIGHT):
            taken, typing = self._draw_path(ui)
            is_searching = self._draw_search(ui)
            self._draw_files_and_preview(ui)
            if self._double_clicked:
                taken = choice.confirm() or taken
            note, is_error = self._note()
            ui.note(note, "failure" if is_error else "muted")
            self._draw_name(ui)
            word = "Save" if choice.saving else "Open"
            is_ready = bool(choice.selected or choice.name.strip())
            pressed = ui.button(word, enabled=is_ready, primary=True, width=ui.px(110))
            ui.same_line()
            cancelled = ui.button("Cancel", "Esc", width=ui.px(110))
            if not (typing or is_popup_open()):
                escaped = imgui.IsKeyPressed(imgui.ImGuiKey_Escape, False)
                if escaped and choice.search:
                    choice.look_for("")
                else:
                    cancelled = cancelled or escaped
                keys = (imgui.ImGuiKey_Enter, imgui.ImGuiKey_KeypadEnter)
                entered = any(imgui.IsKeyPressed(key, False) for key in keys)
                self._focuses = self._focuses or entered
                pressed = pressed or entered
                self._move_by_keys(is_searching)
            if cancelled:
                return (None,)
            if pressed and taken is None:
                taken = choice.confirm()
        if (choice.folder, choice.selected) != before and not (choice.is_typed or is_searching):
            self._refresh_name()
        return None if taken is None else (taken,)

    def close(self) -> None:
        self.choice.close()

    def _refresh_name(self) -> None:
        """Show a name that the user did not type; ImGui keeps the text of a box in use."""
        self._changes += 1
        self._focuses = True

    def _draw_path(self, ui: Ui) -> tuple[Path | None, bool]:
        """Draw the path, Up, Home and recent folders.

        Return the file whose path the user typed, or None, and whether the user is typing.
        """
        with ui.disabled(self.choice.folder == self.choice.folder.parent):
            if ui.button("Up", "Show the parent folder (Backspace or Alt+Up)."):
                self._go_up()
        ui.same_line()
        if ui.button("Home", "Show your home folder."):
            self.choice.go(Path.home())
        if self.recent:
            ui.same_line()
            names = {shown(path): path for path in self.recent}
            width = ui.text_width(_RECENT_LABEL) + ui.px(44)
            chosen = ui.combo(f"##{_RECENT_LABEL}", _RECENT_LABEL, tuple(names), width=width)
            if chosen in names:
                self.choice.go(names[chosen])
        ui.same_line()
        tip = "Type a folder or a file; ~ is your home folder."
        typed = ui.text("folder", shown(self.choice.folder), tip)
        return (None if typed is None else self.choice.go_or_take(typed)), ui.typing

    def _draw_search(self, ui: Ui) -> bool:
        """Draw the search and the switch for hidden files; return whether the user searches."""
        choice, width = self.choice, ui.px(_SEARCH_WIDTH)
        found = ui.live_text("search", choice.search, "part of a name", width=width)
        is_searching = ui.typing
        if found != choice.search:
            choice.look_for(found)
        ui.same_line(ui.px(16))
        tip = "Also list names that begin with a dot."
        choice.hidden = ui.checkbox("hidden files", choice.hidden, tip)
        return is_searching

    def _draw_files_and_preview(self, ui: Ui) -> None:
        self._double_clicked = False
        room = float(imgui.GetContentRegionAvail()[0])
        below = 2 * imgui.GetFrameHeightWithSpacing() + imgui.GetStyle().ItemSpacing[1]
        below += imgui.CalcTextSize(self._note()[0], wrap_width=room)[1]
        pane = ui.px(_PREVIEW_WIDTH)
        has_preview = room - pane >= ui.px(_LIST_WIDTH_MIN)
        width = room - pane - imgui.GetStyle().ItemSpacing[0] if has_preview else room
        with child(ui, "list", (width, -below), border=False):
            inner = float(imgui.GetContentRegionAvail()[0])
            columns = self._columns(ui, inner)
            self._draw_heads(ui, columns)
            with child(ui, "files", 0):
                self._draw_list(ui, columns)
        if has_preview:
            ui.same_line()
            with child(ui, "preview", -below):
                self._draw_preview(ui)

    def _columns(self, ui: Ui, room: float) -> dict[Column, float]:
        """Return the left sides of the columns that fit, relative to the list."""
        scroll_bar = imgui.GetStyle().ScrollbarSize + ui.px(20)
        date = room - scroll_bar - ui.text_width("0000-00-00 00:00")
        columns: dict[Column, float] = {"name": 0.0}
        if room < ui.px(_DATE_LIST_WIDTH_MIN):
            return columns | {"size": room - scroll_bar - ui.text_width("999.9 MB")}
        return columns | {"size": date - ui.px(16) - ui.text_width("999.9 MB"), "date": date}

    def _draw_heads(self, ui: Ui, columns: Mapping[Column, float]) -> None:
        clear = dict.fromkeys((imgui.ImGuiCol_Button,), (0.0, 0.0, 0.0, 0.0))
        left = imgui.GetCursorPosX()
        for column in get_args(Column):
            if column not in columns:
                continue
            if columns[column]:
                imgui.SameLine(left + columns[column] - ui.px(6))
            with Pushed({**clear, imgui.ImGuiCol_Text: ui.colors.muted}):
                tip = f"Sort by {column}; click again for the opposite order."
                if ui.button(column, tip, width=ui.text_width(column) + ui.px(32)):
                    self.choice.order_by(column)
            if self.choice.order[0] == column:
                ui.sort_arrow(self.choice.order[1])

    def _draw_list(self, ui: Ui, columns: Mapping[Column, float]) -> None:
        choice = self.choice
        listing = choice.listing()
        if listing is None:
            ui.note("reading ...")
        elif choice.entries():
            self._draw_entries(ui, columns)
        elif listing.entries:
            ui.note(f"no names contain {choice.search.strip()!r}")
        else:
            nothing = f"no folders and no files of these types: {_types_text(choice.suffixes)}"
            ui.note(listing.error or nothing, "failure" if listing.error else "muted")

    def _draw_entries(self, ui: Ui, columns: Mapping[Column, float]) -> None:
        """Draw the visible rows and some around them, as drawing all rows would be slow."""
        row, choice = imgui.GetTextLineHeightWithSpacing(), self.choice
        entries, details = choice.entries(), choice.details()
        self._scroll(entries, row)
        first = max(0, int(imgui.GetScrollY() / row) - _MARGIN_ROWS)
        last = first + int(imgui.GetWindowHeight() / row) + 2 * _MARGIN_ROWS
        top = imgui.GetCursorPosY()
        imgui.SetCursorPosY(top + first * row)
        room = columns["size"] - ui.px(12)
        marked = dict.fromkeys(
            (imgui.ImGuiCol_Header, imgui.ImGuiCol_HeaderHovered), (*ui.colors.accent[:3], 0.3)
        )
        for entry in entries[first:last]:
            is_selected = choice.selected == entry.name
            with Pushed(marked if is_selected else {}):
                pressed, twice = ui.row(entry.label, is_selected, room)
            if entry.name in details:
                self._draw_details(ui, columns, details[entry.name], entry.is_folder)
            if pressed:
                choice.select(entry)
            self._double_clicked = self._double_clicked or twice
        imgui.SetCursorPosY(top + len(entries) * row)
        imgui.Dummy((1, 1))

    def _draw_details(
        self, ui: Ui, columns: Mapping[Column, float], details: Details, is_folder: bool
    ) -> None:
        (left, top), color = imgui.GetItemRectMin(), imgui.GetColorU32(ui.colors.muted)
        top += imgui.GetStyle().ItemSpacing[1] / 2
        texts: dict[Column, str] = {"size": "" if is_folder else decimal(details.size)}
        texts["date"] = date_text(details.date)
        for column, text in texts.items():
            if column in columns:
                place = left + columns[column], top
                imgui.GetWindowDrawList().AddText(place, color, text)

    def _draw_preview(self, ui: Ui) -> None:
        choice = self.choice
        found = self.preview(choice.folder / choice.selected) if choice.selected else None
        if found is None:
            ui.note("Select a file to preview it.")
            return
        if found.texture is not None:
            room, height = imgui.GetContentRegionAvail()
            height -= len(found.lines) * imgui.GetTextLineHeightWithSpacing() + ui.px(8)
            width, full = found.size
            scale = max(min(room / width, height / full, 1.6 * ui.scale), 0.1)
            imgui.Image(found.texture, (scale * found.size[0], scale * found.size[1]))
        for line in found.lines:
            ui.note(line)

    def _draw_name(self, ui: Ui) -> None:
        choice = self.choice
        hint = "name of the file to write" if choice.saving else "a name, the start of one, a path"
        imgui.PushID(self._changes)
        try:
            typed = ui.live_text("file name", choice.name, hint, focus=self._focuses)
        finally:
            imgui.PopID()
        self._focuses = False
        if typed != choice.name:
            choice.type_name(typed)
            self._scroll_to = choice.selected

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

    def _move_by_keys(self, is_searching: bool) -> None:
        choice = self.choice
        steps = {
            imgui.ImGuiKey_UpArrow: -1,
            imgui.ImGuiKey_DownArrow: 1,
            imgui.ImGuiKey_PageUp: -_PAGE_ROWS,
            imgui.ImGuiKey_PageDown: _PAGE_ROWS,
        }
        step = sum(count for key, count in steps.items() if imgui.IsKeyPressed(key))
        is_free = not (choice.name and (choice.saving or choice.is_typed)) and not is_searching
        goes_up = step == -1 and imgui.GetIO().KeyAlt
        if goes_up or (is_free and imgui.IsKeyPressed(imgui.ImGuiKey_Backspace, False)):
            self._go_up()
        elif step:
            choice.move_selection(step)
            self._scroll_to = choice.selected
            self._refresh_name()

    def _go_up(self) -> None:
        self.choice.go_up()
        self._scroll_to = self.choice.selected

    def _scroll(self, entries: Sequence[FolderEntry], row: float) -> None:
        names = [entry.name for entry in entries] if self._scroll_to else []
        if self._scroll_to in names:
            top, first = names.index(self._scroll_to) * row, imgui.GetScrollY()
            height = imgui.GetWindowHeight()
            if not first <= top <= first + height - 2 * row:
                imgui.SetScrollY(max(top - height / 2, 0))
        self._scroll_to = ""
