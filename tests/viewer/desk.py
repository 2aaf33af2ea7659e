"""A session with its files at work, without a window."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from abfm_viewer.files.state_folder import StateFolder
from abfm_viewer.session.session import Session
from abfm_viewer.session.session_files import SessionFiles


class Desk:
    """A session with its files and the questions that were asked."""

    def __init__(self, session: Session, folder: Path) -> None:
        self.session = session
        self.state = StateFolder(folder)
        self.questions: list[tuple[str, str, dict[str, Callable[[], None] | None]]] = []
        self.files = SessionFiles(
            session, self.state, lambda *question: self.questions.append(question)
        )

    def wait(self, condition: Callable[[], bool]) -> None:
        """Update until something holds."""
        end = time.monotonic() + 60
        while not condition():
            assert time.monotonic() < end, self.session.notices.latest
            self.update()
            time.sleep(0.002)

    def update(self) -> None:
        """What the window does in every frame."""
        self.session.update()
        self.files.update()

    def settle(self) -> None:
        """Wait until nothing is opened, computed or written."""
        for _ in range(3):  # what ended since the last update is taken in by the next one
            self.update()
            self.wait(
                lambda: (
                    not self.session.busy and not self.files.saving and self.session.channels != ()
                )
            )

    def open(self, path: Path) -> None:
        """Open a file and wait."""
        self.files.open(path)
        self.settle()
