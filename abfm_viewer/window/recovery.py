"""Copies of unsaved work in the state folder, also of launches that crashed."""

import itertools
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial

from abfm import AbfmError
from abfm.types import FloatArray
from abfm_viewer.computing.background import Latest
from abfm_viewer.computing.evaluation import Evaluators
from abfm_viewer.computing.matching import Snapshot
from abfm_viewer.dialogs import Dialogs
from abfm_viewer.document.document import Document, Identity
from abfm_viewer.document.kinds import MatchDocument, SequenceDocument
from abfm_viewer.files.autosave import Autosave, Content, Recovery, recoverable
from abfm_viewer.files.project import Origin, load_origin, load_project
from abfm_viewer.files.state_folder import StateFolder
from abfm_viewer.session.functions import known_values
from abfm_viewer.session.session import Session
from abfm_viewer.session.session_files import SessionFiles

_COPIES = "copies"  # subject of the cards


class Recoveries:
    """Copies of unsaved documents, and the question whether to open copies of earlier launches.

    The copy of the current document contains the best field of a run in progress.
    """

    def __init__(
        self, session: Session, state: StateFolder, files: SessionFiles, dialogs: Dialogs
    ) -> None:
        self._session, self._state = session, state
        self._files, self._dialogs = files, dialogs
        self._autosaves: dict[Identity, Autosave] = {}
        self._numbers = itertools.count()
        self._recoveries: list[Recovery] | None = None
        self._reading: Recovery | None = None
        self._reader: Latest[Callable[[], None]] = Latest()
        self._reported = ""
        self._autosave(session.document.identity)
        session.sequence_match.checkpoint_base = lambda document: (
            self._autosave(document.identity).path
        )

    def update(self) -> None:
        """Offer copies of earlier launches, and write new ones. Call once per frame."""
        session, notices = self._session, self._session.notices
        if self._recoveries is None:
            self._recoveries = recoverable(self._state)
            self._offer_next()
        if self._reading is not None:
            self._show_question(self._reading)
        present, running = session.document, session.snapshot
        if running and not running.shown.iteration:  # before its first step
            running = None
        unsaved = {one.identity: one for one in reversed(session.saves.unsaved_documents)}
        sequence_run = session.sequence_match.running_document
        if running is not None or sequence_run is not None:
            unsaved[present.identity] = present
        for identity in {*self._autosaves, *unsaved}:
            document, autosave = unsaved.get(identity, present), self._autosave(identity)
            functions = session.functions.of_document(document)
            origin = session.saves.origin(document)
            if document is present and running is not None:
                content = partial(self._content_of_run, document, running, functions)
                autosave.offer((document, running), content, True, origin)
            else:
                content = partial(_content, document, functions)
                run = sequence_run if document is present else None
                autosave.offer(document, content, identity in unsaved, origin, run)
            is_obsolete = identity not in unsaved and identity is not present.identity
            if is_obsolete and autosave.is_idle:
                self._autosaves.pop(identity).close()
        problem = next(filter(None, (each.error for each in self._autosaves.values())), "")
        if problem != self._reported:
            self._reported = problem
            notices.resolve(_COPIES)
            if problem:
                text = f"no copy of unsaved work could be written: {problem}"
                notices.show(text, True, _COPIES)

    def close(self, keep_unsaved: bool) -> None:
        """Finish writing; remove the copies of unsaved work unless ``keep_unsaved``."""
        session, preserved = self._session, set()
        self._reader.close()
        if keep_unsaved:
            preserved = {document.identity for document in session.saves.unsaved_documents}
            if session.solver.running:
                preserved.add(session.document.identity)
        for identity, autosave in self._autosaves.items():
            autosave.close()
            if identity not in preserved:
                autosave.discard()

    def _autosave(self, identity: Identity) -> Autosave:
        if identity not in self._autosaves:
            self._autosaves[identity] = Autosave(self._state, number=next(self._numbers))
        return self._autosaves[identity]

    def _content_of_run(
        self, document: Document, snapshot: Snapshot, functions: Evaluators
    ) -> Content:
        """Return a document with the best field of its run as result, and its function values."""
        try:
            found, run = self._session.matching.unfinished(snapshot, functions)
        except AbfmError:  # the run has just ended; its result is copied in the next frame
            return _content(document, functions)
        assert isinstance(document, MatchDocument)
        outcome = document.outcome(found, run, snapshot.problem.initial)
        return _content(replace(document, **outcome), functions)

    def _offer_next(self) -> None:
        if self._recoveries:
            self._reading = self._recoveries.pop(0)

    def _show_question(self, recovery: Recovery) -> None:
        """Show the question whether to open a copy, as soon as the copy has been read."""
        show = self._reader.request(recovery, partial(self._read, recovery))
        if show is not None:
            self._reading = None
            show()
        elif not self._reader.busy:
            self._reading = None
            self._session.notices.show(self._reader.error, is_error=True)

    def _read(self, recovery: Recovery) -> Callable[[], None]:
        try:
            path = recovery.path
            return partial(self._offer, recovery, *load_project(path), load_origin(path))
        except AbfmError as error:
            aside = recovery.set_aside()
            text = f"unsaved work cannot be read: {error}. It was moved to {aside}"
            return partial(self._session.notices.show, text, is_error=True)

    def _offer(
        self,
        recovery: Recovery,
        document: Document,
        known: dict[str, FloatArray],
        origin: Origin | None,
    ) -> None:
        def restore() -> None:
            session = self._session
            session.restore(document, known, origin, saved=False)
            copy = self._autosave(session.document.identity)
            copy.take_over(recovery)
            if isinstance(document, SequenceDocument) and copy.has_checkpoint:
                session.recover_sequence()
            session.notices.show(f"recovered {document.name}; save it now")

        def discard() -> None:
            recovery.discard()
            self._offer_next()

        written = time.strftime("%H:%M on %d %B %Y", time.localtime(recovery.written))
        name = origin.path.name if origin else document.name
        text = f"The app ended before {name} was saved. There is a copy from {written}."
        if origin and origin.changed:
            text += f" {name} has changed since then."
        recover = partial(self._files.when_free, f"recovering {name}", restore)
        self._dialogs.question(
            "Recover unsaved work?", text, {"Recover": recover, "Discard": discard, "Later": None}
        )


def _content(document: Document, functions: Evaluators) -> Content:
    return document, known_values(document, functions)
