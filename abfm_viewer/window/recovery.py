"""Unsaved work: copies of this launch's, and those of launches that ended badly."""

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial

from abfm import AbfmError
from abfm.types import FloatArray
from abfm_viewer.dialogs import Dialogs
from abfm_viewer.document.document import Document
from abfm_viewer.files.autosave import Autosave, Recovery, recoverable
from abfm_viewer.files.project import load_project
from abfm_viewer.files.state_folder import StateFolder
from abfm_viewer.session.opening import known_values
from abfm_viewer.session.session import Session


class Recoveries:
    """Keeps a session's autosaves in the state folder, and offers those of earlier launches."""

    def __init__(self, session: Session, state: StateFolder, dialogs: Dialogs) -> None:
        self._session = session
        self._state = state
        self._dialogs = dialogs
        self._autosave = Autosave(state)
        self._recoveries: list[Recovery] | None = None
        self._told = ""

    def update(self) -> None:
        session = self._session
        if self._recoveries is None:
            self._recoveries = recoverable(self._state)
            self._ask_next()
        document, functions = session.document, session.functions
        self._autosave.offer(document, partial(known_values, document, functions), session.unsaved)
        if self._autosave.error != self._told:
            self._told = self._autosave.error
            if self._told:
                session.say(f"no copy of unsaved work could be kept: {self._told}", is_error=True)

    def close(self, keep_unsaved: bool) -> None:
        """Finish writing; a copy of unsaved work stays only if it is to be recovered."""
        self._autosave.close()
        if not (keep_unsaved and self._session.unsaved):
            self._autosave.discard()

    def _ask_next(self) -> None:
        if self._recoveries:
            recovery = self._recoveries.pop(0)
            self._session.load("reading unsaved work", partial(self._read, recovery))

    def _read(self, recovery: Recovery) -> Callable[[], None]:
        try:
            return partial(self._ask, recovery, *load_project(recovery.path))
        except AbfmError as error:
            text = f"unsaved work of an earlier launch is kept in {recovery.set_aside()}, but {error}"
            return partial(self._session.say, text, is_error=True)

    def _ask(self, recovery: Recovery, document: Document, known: dict[str, FloatArray]) -> None:
        written = time.strftime("%H:%M on %d %B %Y", time.localtime(recovery.written))
        text = f"The app ended without saving {document.name}. A copy of {written} is there."
        recover = partial(self._recover, recovery, document, known)
        buttons = {"Recover": recover, "Discard": partial(self._discard, recovery), "Later": None}
        self._dialogs.ask("Recover unsaved work?", text, buttons)

    def _recover(self, recovery: Recovery, document: Document, known: dict[str, FloatArray]) -> None:
        session = self._session
        document = replace(document, view=replace(document.view, ui_scale=session.view.ui_scale))
        session.restore(document, known, None, saved=False)
        self._autosave.take_over(recovery)
        session.say(f"recovered {document.name}: save it to keep it")

    def _discard(self, recovery: Recovery) -> None:
        recovery.discard()
        self._ask_next()
