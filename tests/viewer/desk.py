"""A session with its files at work, without a window."""

import time

from abfm_viewer.files.state_folder import StateFolder
from abfm_viewer.session.session_files import SessionFiles


class Desk:
    """A session with its files and the questions that were asked."""

    def __init__(self, session, folder):
        self.session = session
        self.state = StateFolder(folder)
        self.questions = []
        self.files = SessionFiles(
            session, self.state, lambda *question: self.questions.append(question)
        )

    def wait(self, condition):
        """Update until something holds."""
        end = time.monotonic() + 60
        while not condition():
            assert time.monotonic() < end, self.session.notices.latest
            self.update()
            time.sleep(0.002)

    def update(self):
        """What the window does in every frame."""
        self.session.update()
        self.files.update()

    def settle(self):
        """Wait until nothing is opened, computed or written."""
        for _ in range(3):  # what ended since the last update is taken in by the next one
            self.update()
            self.wait(
                lambda: (
                    not self.session.busy and not self.files.saving and self.session.channels != ()
                )
            )

    def open(self, path):
        """Open a file and wait."""
        self.files.open(path)
        self.settle()
