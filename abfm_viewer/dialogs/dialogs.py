"""The stack of modal dialogs, of which only the newest is drawn."""

import webbrowser
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from threading import Thread
from types import MappingProxyType
from typing import Any, Literal, Protocol

import polyscope.imgui as imgui

from abfm_viewer.dialogs.file_dialog import FileChoice, FileDialog, Preview, shown
from abfm_viewer.dialogs.native_dialog import NativeDialog
from abfm_viewer.widgets.containers import child, dialog
from abfm_viewer.widgets.toolkit import Ui

Line = str | tuple[str, str]  # A paragraph, or a row of two columns
_MESSAGE_WIDTH = 520
_QUESTION_WIDTH = 460
_FIRST_COLUMN = 0.34
_RECENT_FOLDERS_MAX = 8  # for each kind of file
FileKind = Literal["meshes", "functions", "results", "exports"]
"""Kinds of files, each with its recent folders."""


@dataclass(frozen=True)
class Message:
    """Dialog with a title and lines of text."""

    title: str
    lines: Sequence[Line]
    copied: str = ""  # text for the clipboard; empty for no button Copy
    link: str = ""  # address of a page for the browser; empty for no button

    def draw(self, ui: Ui) -> bool:
        with dialog(ui, self.title, _MESSAGE_WIDTH):
            height = imgui.GetIO().DisplaySize[1] * 0.92 - 4 * imgui.GetFrameHeightWithSpacing()
            with child(ui, "lines", height, border=False, fits="at most"):
                for line in self.lines:
                    self._draw_line(ui, line)
            if self.copied:
                if ui.button("Copy", "All lines as text, to the clipboard.", width=ui.px(110)):
                    imgui.SetClipboardText(self.copied)
                ui.same_line()
            if self.link:
                if ui.button("Open in the browser", "Show this section on the built site."):
                    # a slow browser must not stop the window
                    Thread(target=webbrowser.open, args=(self.link,), daemon=True).start()
                ui.same_line()
            closed = ui.button("Close", "Esc", primary=True, width=ui.px(110))
            keys = (imgui.ImGuiKey_Enter, imgui.ImGuiKey_Escape)
            return closed or any(imgui.IsKeyPressed(key, False) for key in keys)

    def _draw_line(self, ui: Ui, line: Line) -> None:
        if isinstance(line, str):
            ui.note(line, "ink")
        elif line[1]:
            width = imgui.GetContentRegionAvail()[0]
            ui.note(line[0], "muted")
            imgui.SameLine(_FIRST_COLUMN * width)
            ui.note(line[1], "ink")
        else:
            ui.heading(line[0])


@dataclass(frozen=True)
class Question:
    """Dialog with buttons for answers: Enter is the first answer, Esc the last."""

    title: str
    text: str | Callable[[], str]  # a callable is evaluated in each frame
    answers: Sequence[str]
    # called in each frame; an action that it returns is done, and the dialog closes
    instead: Callable[[], Callable[[], None] | None] = lambda: None

    def draw(self, ui: Ui) -> str | None:
        """Draw the question, and return the answer that was chosen in this frame, if any."""
        with dialog(ui, self.title, _QUESTION_WIDTH):
            ui.note(self.text if isinstance(self.text, str) else self.text(), "ink")
            imgui.Dummy((0, ui.px(4)))
            chosen = None
            width = max(map(ui.text_width, self.answers)) + ui.px(32)
            for number, answer in enumerate(self.answers):
                if number:
                    ui.same_line_if_fits(answer, is_button=True, width=width)
                if ui.button(answer, primary=number == 0, width=width):
                    chosen = answer
            if imgui.IsKeyPressed(imgui.ImGuiKey_Enter, False):
                chosen = self.answers[0]
            elif imgui.IsKeyPressed(imgui.ImGuiKey_Escape, False):
                chosen = self.answers[-1]
        return chosen


class AnyDialog(Protocol):
    @property
    def title(self) -> str: ...
    def draw(self, ui: Ui, /) -> Any: ...


class Dialogs:
    """Stack of open dialogs, each with a callback for its answer.

    ``recent`` are the recent folders of each kind of file; ``store`` stores new ones.
    """

    def __init__(
        self,
        recent: Mapping[str, tuple[str, ...]] = MappingProxyType({}),
        store: Callable[[Mapping[str, tuple[str, ...]]], None] = lambda recent: None,
    ) -> None:
        self.preview: Callable[[Path], Preview | None] = lambda path: None
        self.uses_native: Callable[[], bool] = lambda: False  # whether to use the system's dialogs
        self._recent, self._store, self._folder = {**recent}, store, Path()
        self._open: list[tuple[AnyDialog, Callable[[Any], None]]] = []

    def start_in(self, folder: Path) -> None:
        """Begin in a folder, and forget the recent folders."""
        self._folder, self._recent = folder, {}

    @property
    def is_open(self) -> bool:
        return bool(self._open)

    def has_question(self, title: str) -> bool:
        return any(one.title == title for one, _ in self._open)

    def open(
        self,
        title: str,
        suffixes: tuple[str, ...],
        on_path: Callable[[Path], None],
        kind: FileKind = "functions",
    ) -> None:
        folder = self._start_folder(kind)
        if self.uses_native():
            self._choose(NativeDialog(title, folder, suffixes), kind, on_path)
        else:
            self._choose_own(title, FileChoice(folder, suffixes), kind, on_path)

    def save(
        self,
        title: str,
        suffixes: tuple[str, ...],
        name: str,
        on_path: Callable[[Path], None],
        kind: FileKind = "exports",
    ) -> None:
        """Let the user choose a file to write; replace an existing file only after a question.

        The dialogs of systems cannot suggest a name, so this is always the dialog of the app.
        """
        folder = self._start_folder(kind)
        choice = FileChoice(folder, suffixes, saving=True, name=name)
        self._choose_own(title, choice, kind, on_path)

    def question(
        self,
        title: str,
        text: str | Callable[[], str],
        buttons: Mapping[str, Callable[[], None] | None],
        instead: Callable[[], Callable[[], None] | None] = lambda: None,
    ) -> None:
        """Open a `Question`; each button calls its function, or does nothing if that is None.

        In each frame, ``instead`` may return a function, which closes the question and is called.
        """

        def answered(label: str) -> None:
            self.pop()
            if (act := buttons[label]) is not None:
                act()

        self._open.append((Question(title, text, tuple(buttons), instead), answered))

    def show(self, title: str, lines: Sequence[Line], copied: str = "", link: str = "") -> None:
        """Show paragraphs, rows of two columns, or headings (rows with an empty second column)."""
        self._open.append((Message(title, lines, copied, link), lambda _: self.pop()))

    def draw(self, ui: Ui) -> None:
        if not self._open:
            return
        front, answered = self._open[-1]
        if isinstance(front, Question) and (do := front.instead()) is not None:
            self.pop()
            do()
            return
        try:
            answer = front.draw(ui)
        except Exception:  # a dialog that cannot be drawn must not block the window
            self.pop()
            raise
        if answer:
            answered(answer)

    def push(self, one: AnyDialog, answered: Callable[[Any], None]) -> None:
        """Open another dialog, which stays open until `pop` is called."""
        self._open.append((one, answered))

    def _recent_folders(self, kind: FileKind) -> list[Path]:
        """Return existing folders that were used for a kind of file, the latest first."""
        return [path for path in map(Path, self._recent.get(kind, ())) if path.is_dir()]

    def _start_folder(self, kind: FileKind) -> Path:
        kinds: tuple[FileKind, ...] = (kind, "meshes")
        found = [folder for each in kinds for folder in self._recent_folders(each)]
        try:
            return [*found, self._folder][0].resolve(strict=True)
        except OSError:
            return Path.home()

    def _choose_own(
        self, title: str, choice: FileChoice, kind: FileKind, on_path: Callable[[Path], None]
    ) -> None:
        recent = tuple(self._recent_folders(kind))
        self._choose(FileDialog(title, choice, recent, self.preview), kind, on_path)

    def _choose(
        self, one: FileDialog | NativeDialog, kind: FileKind, on_path: Callable[[Path], None]
    ) -> None:
        def answered(answer: tuple[Path | None]) -> None:
            if (path := answer[0]) is None:
                self.pop()
                if isinstance(one, NativeDialog) and one.failed:
                    choice = FileChoice(one.folder, one.suffixes)
                    self._choose_own(one.title, choice, kind, on_path)
            elif isinstance(one, FileDialog) and one.choice.saving and path.exists():
                text = f"{shown(path.name)} exists already. Its contents will be lost."
                answers = {"Replace": partial(take, path), "Go back": None}
                self.question("Replace the file?", text, answers)
            else:
                take(path)

        def take(path: Path) -> None:
            self.remember_folder(kind, path.parent)
            self.pop()
            on_path(path)

        self._open.append((one, answered))

    def remember_folder(self, kind: FileKind, folder: Path) -> None:
        """Make a folder the one in which dialogs for a kind of file start."""
        others = (known for known in self._recent.get(kind, ()) if known != str(folder))
        self._recent = self._recent | {kind: (str(folder), *others)[:_RECENT_FOLDERS_MAX]}
        self._store(self._recent)

    def pop(self) -> None:
        """Close the newest dialog."""
        closed, _ = self._open.pop()
        if isinstance(closed, FileDialog | NativeDialog):
            closed.close()
