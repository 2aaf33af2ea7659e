"""Unsaved work: copies of this launch's, and those of launches that ended badly."""

import itertools
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial

from abfm import AbfmError
from abfm.types import FloatArray
from abfm_viewer.computing.evaluation import Functions
from abfm_viewer.computing.solver import Snapshot
from abfm_viewer.dialogs import Dialogs
from abfm_viewer.document.document import Document, Identity
from abfm_viewer.files.autosave import Autosave, Content, Recovery, recoverable
from abfm_viewer.files.project import Origin, load_origin, load_project
from abfm_viewer.files.state_folder import StateFolder
from abfm_viewer.session.functions import known_values
from abfm_viewer.session.loading import Load
from abfm_viewer.session.session import Session
from abfm_viewer.session.session_files import SessionFiles

COPIES = "copies"
"""What cards are about."""


class Recoveries:
    """Keeps a session's autosaves in the state folder, and offers those of earlier launches.

    There is a copy of each unsaved document: the present one, with the field of a run that is under
    way, and those that were left for another mesh.
    """

    def __init__(
        self, session: Session, state: StateFolder, files: SessionFiles, dialogs: Dialogs
    ) -> None:
        self._session = session
        self._state = state
        self._files = files
        self._dialogs = dialogs
        self._autosaves: dict[Identity, Autosave] = {}
        self._numbers = itertools.count()
        self._recoveries: list[Recovery] | None = None
        self._reading: tuple[Load, Recovery] | None = None
        self._asks_later = False  # when what took the place of reading a copy is there
        self._reported = ""
        self._autosave(session.document.identity)

    def update(self) -> None:
        session = self._session
        if self._recoveries is None:
            self._recoveries = recoverable(self._state)
            self._ask_next()
        self._mind_reading(self._recoveries)
        present, running = session.document, self._running()
        unsaved = {one.identity: one for one in reversed(session.saves.unsaved_documents)}
        if running is not None:
            unsaved[present.identity] = present
        for identity in {*self._autosaves, *unsaved}:
            document, autosave = unsaved.get(identity, present), self._autosave(identity)
            functions, origin = session.functions_of(document), session.saves.origin(document)
            if document is present and running is not None:
                content = partial(self._content_of_run, document, running, functions)
                autosave.offer((document, running), content, True, origin)
            else:
                content = partial(_content, document, functions)
                autosave.offer(document, content, identity in unsaved, origin)
            is_gone = identity not in unsaved and identity is not present.identity
            if is_gone and autosave.is_idle:
                self._autosaves.pop(identity).close()
        self._tell()

    def close(self, keep_unsaved: bool) -> None:
        """Finish writing; a copy of unsaved work stays only if it is to be recovered."""
        session, kept = self._session, set()
        if keep_unsaved:
            kept = {document.identity for document in session.saves.unsaved_documents}
            if session.solver.running:
                kept.add(session.document.identity)
        for identity, autosave in self._autosaves.items():
            autosave.close()
            if identity not in kept:
                autosave.discard()

    def _autosave(self, identity: Identity) -> Autosave:
        if identity not in self._autosaves:
            self._autosaves[identity] = Autosave(self._state, number=next(self._numbers))
        return self._autosaves[identity]

    def _tell(self) -> None:
        errors = (autosave.error for autosave in self._autosaves.values())
        problem = next(filter(None, errors), "")
        if problem != self._reported:
            self._reported = problem
            self._session.notices.mend(COPIES)
            if problem:
                text = f"no copy of unsaved work could be kept: {problem}"
                self._session.notices.say(text, True, COPIES)

    def _running(self) -> Snapshot | None:
        """Return what the run that is under way has come to; None before its first step."""
        snapshot = self._session.snapshot
        return snapshot if snapshot and snapshot.iteration.iteration else None

    def _content_of_run(
        self, document: Document, snapshot: Snapshot, functions: Functions
    ) -> Content:
        """Return the document with the best field so far as its result."""
        try:
            found, run = self._session.solver.unfinished(snapshot, functions)
        except AbfmError:  # the run has just ended: what it leaves comes next
            return _content(document, functions)
        runs = (*document.runs, run)
        return _content(replace(document, result=found, runs=runs), functions)

    def _ask_next(self) -> None:
        if self._recoveries:
            recovery = self._recoveries.pop(0)
            load = Load("reading unsaved work", partial(self._read, recovery), replaces=False)
            self._reading = load, recovery
            self._session.loading.begin(load)

    def _mind_reading(self, recoveries: list[Recovery]) -> None:
        """Offer a copy though something else was opened meanwhile, unless reading was cancelled."""
        loading = self._session.loading.now
        if self._reading is not None and loading is not self._reading[0]:
            if loading is not None:
                recoveries.insert(0, self._reading[1])
                self._asks_later = True
            self._reading = None
        if self._asks_later and loading is None:
            self._asks_later = False
            self._ask_next()

    def _read(self, recovery: Recovery) -> Callable[[], None]:
        try:
            path = recovery.path
            return partial(self._ask, recovery, *load_project(path), load_origin(path))
        except AbfmError as error:
            aside = recovery.set_aside()
            text = f"unsaved work of an earlier launch is kept in {aside}, but {error}"
            return partial(self._session.notices.say, text, is_error=True)

    def _ask(
        self,
        recovery: Recovery,
        document: Document,
        known: dict[str, FloatArray],
        origin: Origin | None,
    ) -> None:
        written = time.strftime("%H:%M on %d %B %Y", time.localtime(recovery.written))
        name = origin.path.name if origin else document.name
        text = f"The app ended without saving {name}. A copy of {written} is there."
        if origin and origin.changed:
            text += f" {name} was changed since then."
        restore = partial(self._recover, recovery, document, known, origin)
        recover = partial(self._files.when_free, f"recovering {name}", restore)
        buttons = {"Recover": recover, "Discard": partial(self._discard, recovery), "Later": None}
        self._dialogs.ask("Recover unsaved work?", text, buttons)

    def _recover(
        self,
        recovery: Recovery,
        document: Document,
        known: dict[str, FloatArray],
        origin: Origin | None,
    ) -> None:
        session = self._session
        document = replace(document, view=replace(document.view, ui_scale=session.view.ui_scale))
        session.restore(document, known, origin, saved=False)
        self._autosave(session.document.identity).take_over(recovery)
        session.notices.say(f"recovered {document.name}: save it to keep it")

    def _discard(self, recovery: Recovery) -> None:
        recovery.discard()
        self._ask_next()


def _content(document: Document, functions: Functions) -> Content:
    return document, known_values(document, functions)
