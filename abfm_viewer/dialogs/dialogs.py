"""The dialogs of the window: at most one is drawn, and the others wait behind it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import polyscope.imgui as imgui

from abfm_viewer.dialogs.file_dialog import FileChoice, FileDialog, shown
from abfm_viewer.widgets.containers import child, dialog
from abfm_viewer.widgets.toolkit import Ui

Line = str | tuple[str, str]
"""A paragraph, or a row of two columns."""
_MESSAGE_WIDTH = 520
_QUESTION_WIDTH = 460
_FIRST_COLUMN = 0.34


@dataclass(frozen=True)
class Message:
    """Lines under a title, and a text that can be copied instead of them."""

    title: str
    lines: Sequence[Line]
    copied: str = ""

    def draw(self, ui: Ui) -> bool:
        """Draw the lines; whether they were closed in this frame."""
        with dialog(ui, self.title, _MESSAGE_WIDTH):
            height = imgui.GetIO().DisplaySize[1] * 0.92 - 4 * imgui.GetFrameHeightWithSpacing()
            with child(ui, "lines", height, border=False, fits="at most"):
                for line in self.lines:
                    self._draw_line(ui, line)
            if self.copied:
                if ui.button("Copy", "All lines as text, to the clipboard.", width=ui.px(110)):
                    imgui.SetClipboardText(self.copied)
                ui.beside()
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
    """A text, in words that hold now, and the labels of its answers: Enter takes the first one, Esc
    the last.
    """

    title: str
    text: str | Callable[[], str]
    answers: Sequence[str]
    instead: Callable[[], Callable[[], None] | None] = lambda: None

    def draw(self, ui: Ui) -> str | None:
        """Draw the question; the answer that was chosen in this frame."""
        with dialog(ui, self.title, _QUESTION_WIDTH):
            ui.note(self.text if isinstance(self.text, str) else self.text(), "ink")
            imgui.Dummy((0, ui.px(4)))
            chosen = None
            width = max(map(ui.text_width, self.answers)) + ui.px(32)
            for number, answer in enumerate(self.answers):
                if number:
                    ui.beside_if_fits(answer, is_button=True, width=width)
                if ui.button(answer, primary=number == 0, width=width):
                    chosen = answer
            if imgui.IsKeyPressed(imgui.ImGuiKey_Enter, False):
                chosen = self.answers[0]
            elif imgui.IsKeyPressed(imgui.ImGuiKey_Escape, False):
                chosen = self.answers[-1]
        return chosen


class Dialogs:
    """Opens dialogs, the newest in front, and calls back; files are looked for in `folder`."""

    def __init__(self) -> None:
        self.folder = Path()
        # each with what to call with an answer that drawing it gave
        self._open: list[tuple[Question | FileDialog | Message, Callable[[Any], None]]] = []

    @property
    def is_open(self) -> bool:
        return bool(self._open)

    def has_question(self, title: str) -> bool:
        return any(isinstance(one, Question) and one.title == title for one, _ in self._open)

    def open(self, title: str, suffixes: tuple[str, ...], on_path: Callable[[Path], None]) -> None:
        self._choose(title, FileChoice(self._begin(), suffixes), on_path)

    def save(
        self, title: str, suffixes: tuple[str, ...], name: str, on_path: Callable[[Path], None]
    ) -> None:
        """Let the user name a file to write; one that exists is replaced only after a question."""
        choice = FileChoice(self._begin(), suffixes, saving=True, name=name)
        self._choose(title, choice, on_path)

    def question(
        self,
        title: str,
        text: str | Callable[[], str],
        buttons: Mapping[str, Callable[[], None] | None],
        instead: Callable[[], Callable[[], None] | None] = lambda: None,
    ) -> None:
        """Ask a question: Enter presses the first button, Esc the last; None does nothing. When its
        premise has gone, so does it, and what there is to do `instead` is done.
        """

        def answered(label: str) -> None:
            self._close()
            if (act := buttons[label]) is not None:
                act()

        self._open.append((Question(title, text, tuple(buttons), instead), answered))

    def show(self, title: str, lines: Sequence[Line], copied: str = "") -> None:
        """Show paragraphs and rows of two columns, or headings; with a text to be `copied`."""
        self._open.append((Message(title, lines, copied), lambda _: self._close()))

    def draw(self, ui: Ui) -> None:
        if not self._open:
            return
        front, answered = self._open[-1]
        if isinstance(front, Question) and (do := front.instead()) is not None:
            self._close()
            do()
            return
        try:
            answer = front.draw(ui)
        except Exception:  # a dialog that cannot be drawn must not hold the window
            self._close()
            raise
        if answer:
            answered(answer)

    def _begin(self) -> Path:
        try:
            return self.folder.resolve(strict=True)
        except OSError:
            return Path.home()

    def _choose(self, title: str, choice: FileChoice, on_path: Callable[[Path], None]) -> None:
        def answered(answer: tuple[Path | None]) -> None:
            if (path := answer[0]) is None:
                self._close()
            elif choice.saving and path.exists():
                text = f"{shown(path.name)} is already there. Its contents will be lost."
                answers = {"Replace": partial(take, path), "Go back": None}
                self.question("Replace the file?", text, answers)
            else:
                take(path)

        def take(path: Path) -> None:
            self.folder = path.parent
            self._close()
            on_path(path)

        self._open.append((FileDialog(title, choice), answered))

    def _close(self) -> None:
        closed, _ = self._open.pop()
        if isinstance(closed, FileDialog):
            closed.choice.close()
