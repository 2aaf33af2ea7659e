"""The dialogs of the window: at most one is drawn, and the others wait behind it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from abfm_viewer.dialogs.file_choice import FileChoice
from abfm_viewer.dialogs.file_dialog import FileDialog
from abfm_viewer.dialogs.folder import shown
from abfm_viewer.dialogs.message import Line, Message
from abfm_viewer.dialogs.question import Question
from abfm_viewer.widgets.toolkit import Ui

OnPath = Callable[[Path], None]


@dataclass(frozen=True)
class _Asking:
    question: Question
    buttons: Mapping[str, Callable[[], None] | None]


@dataclass(frozen=True)
class _Choosing:
    dialog: FileDialog
    on_path: OnPath


class Dialogs:
    """Opens dialogs and calls back with their answers; the newest is in front.

    Attributes
    ----------
    folder : Path
        Where the next file dialog begins: where the last file was chosen.
    """

    def __init__(self) -> None:
        self.folder = Path()
        self._open: list[_Asking | _Choosing | Message] = []

    @property
    def is_open(self) -> bool:
        """Whether a dialog is to be answered."""
        return bool(self._open)

    def is_asking(self, title: str) -> bool:
        """Whether a question of this title is to be answered."""
        return any(isinstance(one, _Asking) and one.question.title == title for one in self._open)

    def open(self, title: str, suffixes: tuple[str, ...], on_path: OnPath, folder: Path | None = None) -> None:
        """Let the user choose a file that exists."""
        self._choose(title, FileChoice(folder or self._begin(), suffixes), on_path)

    def save(self, title: str, suffixes: tuple[str, ...], default_name: str, on_path: OnPath) -> None:
        """Let the user name a file to write; one that exists is replaced only after a question."""
        self._choose(title, FileChoice(self._begin(), suffixes, saving=True, name=default_name), on_path)

    def ask(self, title: str, text: str, buttons: Mapping[str, Callable[[], None] | None]) -> None:
        """Ask a question: Enter presses the first button, Esc the last; a button without a function does nothing."""
        self._open.append(_Asking(Question(title, text, tuple(buttons)), buttons))

    def show(self, title: str, lines: Sequence[Line]) -> None:
        """Show paragraphs, and rows of two columns; a row with an empty second column is a heading."""
        self._open.append(Message(title, lines))

    def draw(self, ui: Ui) -> None:
        """Draw the dialog in front, and do what its answer asks for."""
        if not self._open:
            return
        front = self._open[-1]
        try:
            ui.backdrop()
            act = self._drawn(ui, front)
        except Exception:  # a dialog that cannot be drawn must not hold the window
            self._close(front)
            raise
        if act is not None:
            act()

    def _begin(self) -> Path:
        """The last folder, if it is still there."""
        try:
            return self.folder.resolve(strict=True)
        except OSError:
            return Path.home()

    def _choose(self, title: str, choice: FileChoice, on_path: OnPath) -> None:
        self._open.append(_Choosing(FileDialog(title, choice), on_path))

    def _close(self, dialog: _Asking | _Choosing | Message) -> None:
        if isinstance(dialog, _Choosing):
            dialog.dialog.choice.close()
        self._open.remove(dialog)

    def _drawn(self, ui: Ui, front: _Asking | _Choosing | Message) -> Callable[[], None] | None:
        """Draw one dialog; what is to be done now that it was answered."""
        if isinstance(front, Message):
            if front.draw(ui):
                self._close(front)
            return None
        if isinstance(front, _Asking):
            answer = front.question.draw(ui)
            if answer is None:
                return None
            self._close(front)
            return front.buttons[answer]
        file = front.dialog.draw(ui)
        if file is None:
            return None
        if file.path is None:
            self._close(front)
            return None
        return self._chosen(front, file.path)

    def _chosen(self, front: _Choosing, path: Path) -> Callable[[], None] | None:
        def take() -> None:
            self.folder = path.parent
            self._close(front)
            front.on_path(path)

        if not front.dialog.choice.saving or not path.exists():
            return take
        text = f"{shown(path.name)} is already there. Its contents will be lost."
        self.ask("Replace the file?", text, {"Replace": take, "Go back": None})
        return None
