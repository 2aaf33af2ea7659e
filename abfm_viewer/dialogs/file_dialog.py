"""The file dialog: a path to type, a list to click, and a name when saving."""

from dataclasses import dataclass, field
from pathlib import Path

import polyscope.imgui as imgui

from abfm_viewer.dialogs.file_choice import FileChoice
from abfm_viewer.dialogs.folder import Entry, Listing, shown
from abfm_viewer.widgets.containers import child, dialog
from abfm_viewer.widgets.toolkit import Ui

_WIDTH, _HEIGHT = 640, 480
_ROWS_AROUND = 200  # rows above and below the visible ones that are drawn too


@dataclass
class Answer:
    """The file that was chosen; None if the dialog was given up."""

    path: Path | None


@dataclass
class FileDialog:
    """Draws a choice of a file."""

    title: str
    choice: FileChoice
    _scroll_to: str = field(default="", init=False)
    _is_new: bool = field(default=True, init=False)

    def draw(self, ui: Ui) -> Answer | None:
        """Draw the dialog; its answer when it was answered in this frame."""
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
            ui.beside()
            given_up = ui.button("Cancel", "Esc", width=ui.px(110))
            if not typing:
                given_up = given_up or imgui.IsKeyPressed(imgui.ImGuiKey_Escape, False)
                pressed = pressed or _enter_pressed()
            if not imgui.GetIO().WantTextInput:
                self._move_by_keys()
            if given_up:
                return Answer(None)
            if pressed and taken is None:
                taken = self.choice.confirm()
        return None if taken is None else Answer(taken)

    def _draw_path(self, ui: Ui) -> tuple[Path | None, bool]:
        """Draw the path box and the ways up and home; a typed file, and whether someone types."""
        with ui.disabled(self.choice.folder == self.choice.folder.parent):
            if ui.button("Up", "The folder that this one is in (Alt+Up)."):
                self._go_up()
        ui.beside()
        if ui.button("Home", "Your own folder."):
            self.choice.go(Path.home())
        ui.beside()
        tip = "A folder to go to, or a file; ~ is your own folder."
        typed = ui.text("folder", shown(self.choice.folder), tip)
        return (None if typed is None else self.choice.go_or_take(typed)), ui.typing

    def _draw_list(self, ui: Ui) -> Path | None:
        listing = self.choice.listing()
        if listing is None:
            ui.note("reading ...")
            return None
        if listing.entries:
            return self._draw_entries(ui, listing)
        nothing = f"no folders, and no files that end in {', '.join(self.choice.suffixes)}"
        ui.note(listing.error or nothing, "failure" if listing.error else "muted")
        return None

    def _draw_entries(self, ui: Ui, listing: Listing) -> Path | None:
        """Draw the rows in sight and some around them; each one costs time."""
        row = imgui.GetTextLineHeightWithSpacing()
        entries = listing.entries
        self._scroll(listing, row)
        first = max(0, int(imgui.GetScrollY() / row) - _ROWS_AROUND)
        last = min(len(entries), first + int(imgui.GetWindowHeight() / row) + 2 * _ROWS_AROUND)
        top = imgui.GetCursorPosY()
        imgui.SetCursorPosY(top + first * row)
        taken = None
        for entry in entries[first:last]:
            taken = self._draw_entry(ui, entry) or taken
        imgui.SetCursorPosY(top + len(entries) * row)
        imgui.Dummy((1, 1))
        return taken

    def _draw_entry(self, ui: Ui, entry: Entry) -> Path | None:
        pressed, twice = ui.row(entry.label, self.choice.selected == entry.name)
        if pressed:
            self.choice.select(entry)
        if not twice:
            return None
        return self.choice.go_or_take(entry.name) if entry.is_folder else self.choice.confirm()

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
        """Return what to say below the list, and whether it is an error."""
        choice = self.choice
        listing = choice.listing()
        if choice.error:
            return choice.error, True
        if listing is not None and listing.note:
            return listing.note, False
        if choice.saving and choice.final_name != choice.name.strip():
            return f"will be saved as {choice.final_name}", False
        return f"files that end in {', '.join(choice.suffixes)}", False

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
        """Bring the entry that the keyboard marked into sight."""
        names = [entry.name for entry in listing.entries] if self._scroll_to else []
        if self._scroll_to in names:
            top, first = names.index(self._scroll_to) * row, imgui.GetScrollY()
            height = imgui.GetWindowHeight()
            if not first <= top <= first + height - 2 * row:
                imgui.SetScrollY(max(top - height / 2, 0))
        self._scroll_to = ""


def _enter_pressed() -> bool:
    keys = (imgui.ImGuiKey_Enter, imgui.ImGuiKey_KeypadEnter)
    return any(imgui.IsKeyPressed(key, False) for key in keys)
