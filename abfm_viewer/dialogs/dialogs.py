"""The dialogs of the window: at most one is drawn, and the others wait behind it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from abfm_viewer.dialogs.file_choice import FileChoice
from abfm_viewer.dialogs.file_dialog import Answer, FileDialog
from abfm_viewer.dialogs.folder import shown
from abfm_viewer.dialogs.message import Line, Message, Question
from abfm_viewer.widgets.toolkit import Ui

OnPath = Callable[[Path], None]


@dataclass(frozen=True)
class _Open:
    dialog: Question | FileDialog | Message
    answered: Callable[[Any], None]
    """Called with what drawing it gave, unless that was nothing."""


class Dialogs:
    """Opens dialogs and calls back with their answers; the newest is in front.

    The next file dialog begins in `folder`, where the last file was chosen.
    """

    def __init__(self) -> None:
        self.folder = Path()
        self._open: list[_Open] = []

    @property
    def is_open(self) -> bool:
        return bool(self._open)

    def is_asking(self, title: str) -> bool:
        """Return whether a question of this title is to be answered."""
        questions = [one.dialog for one in self._open if isinstance(one.dialog, Question)]
        return title in [question.title for question in questions]

    def open(self, title: str, suffixes: tuple[str, ...], on_path: OnPath) -> None:
        """Let the user choose a file that exists."""
        self._choose(title, FileChoice(self._begin(), suffixes), on_path)

    def save(
        self, title: str, suffixes: tuple[str, ...], default_name: str, on_path: OnPath
    ) -> None:
        """Let the user name a file to write; one that exists is replaced only after a question."""
        choice = FileChoice(self._begin(), suffixes, saving=True, name=default_name)
        self._choose(title, choice, on_path)

    def ask(self, title: str, text: str, buttons: Mapping[str, Callable[[], None] | None]) -> None:
        """Ask a question: Enter presses the first button, Esc the last; None does nothing."""

        def answered(label: str) -> None:
            self._close()
            if (act := buttons[label]) is not None:
                act()

        self._open.append(_Open(Question(title, text, tuple(buttons)), answered))

    def show(self, title: str, lines: Sequence[Line], copied: str = "") -> None:
        """Show paragraphs, and rows of two columns; a row with an empty second column is a heading.

        With a text to be `copied` there is a button for that.
        """
        self._open.append(_Open(Message(title, lines, copied), lambda _: self._close()))

    def draw(self, ui: Ui) -> None:
        if not self._open:
            return
        front = self._open[-1]
        try:
            answer = front.dialog.draw(ui)
        except Exception:  # a dialog that cannot be drawn must not hold the window
            self._close()
            raise
        if answer:
            front.answered(answer)

    def _begin(self) -> Path:
        """Return the last folder, if it is still there."""
        try:
            return self.folder.resolve(strict=True)
        except OSError:
            return Path.home()

    def _choose(self, title: str, choice: FileChoice, on_path: OnPath) -> None:
        def answered(answer: Answer) -> None:
            if (path := answer.path) is None:
                self._close()
            elif choice.saving and path.exists():
                text = f"{shown(path.name)} is already there. Its contents will be lost."
                answers = {"Replace": partial(take, path), "Go back": None}
                self.ask("Replace the file?", text, answers)
            else:
                take(path)

        def take(path: Path) -> None:
            self.folder = path.parent
            self._close()
            on_path(path)

        self._open.append(_Open(FileDialog(title, choice), answered))

    def _close(self) -> None:
        dialog = self._open.pop().dialog
        if isinstance(dialog, FileDialog):
            dialog.choice.close()
