"""Copies of unsaved work in the state folder, also of launches that crashed."""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

from abfm import AbfmError
from abfm_viewer.computing.background import Latest
from abfm_viewer.computing.evaluation import Evaluators
from abfm_viewer.computing.matching import Snapshot
from abfm_viewer.dialogs import Dialogs
from abfm_viewer.document.document import Document, Identity
from abfm_viewer.document.kinds import MatchDocument, SequenceDocument
from abfm_viewer.files.autosave import Autosave, Content, recoverable
from abfm_viewer.files.project import load_origin, load_project
from abfm_viewer.files.state_folder import StateFolder
from abfm_viewer.pictures.thumbnails import thumbnail
from abfm_viewer.scene.textures import Textures
from abfm_viewer.session.functions import known_values, with_values
from abfm_viewer.session.session import Session
from abfm_viewer.session.session_files import SessionFiles
from abfm_viewer.window.previews import views_of_document
from abfm_viewer.window.recovery_list import PICTURE_SIZE, Answer, Copy, RecoveryList

_COPIES = "copies"  # subject of the cards


class Recoveries:
    """Copies of unsaved documents, and the list of copies of earlier launches.

    The copy of the current document contains the best field of a run in progress.
    """

    def __init__(
        self,
        session: Session,
        state: StateFolder,
        files: SessionFiles,
        dialogs: Dialogs,
        textures: Textures,
    ) -> None:
        self._session, self._state = session, state
        self._files, self._dialogs, self._textures = files, dialogs, textures
        self._autosaves: dict[Identity, Autosave] = {}
        self._numbers = itertools.count()
        self.copies: list[Copy] = []  # of earlier launches, the latest first
        self._is_listed = False
        self._reader: Latest[tuple[list[Copy], list[str]]] = Latest()
        self._reported = ""
        self._autosave(session.document.identity)
        session.sequence_match.checkpoint_base = lambda document: (
            self._autosave(document.identity).path
        )

    def update(self) -> None:
        """Offer copies of earlier launches, and write new ones. Call once per frame."""
        session, notices = self._session, self._session.notices
        if not self._is_listed:
            self._list_when_read()
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

    def _list_when_read(self) -> None:
        found = self._reader.request("copies", self._read_all)
        if found is not None or not self._reader.busy:
            self._is_listed = True
            self.copies, problems = found or ([], [self._reader.error])
            for problem in problems:
                self._session.notices.show(problem, is_error=True)
            if self.copies:
                self.list_copies()

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

    def _read_all(self) -> tuple[list[Copy], list[str]]:
        """Return the copies of earlier launches, and messages about those that cannot be read."""
        found, problems = [], []
        for recovery in recoverable(self._state):
            try:
                document, origin = load_project(recovery.path)[0], load_origin(recovery.path)
            except AbfmError as error:
                aside = recovery.set_aside()
                problems.append(f"unsaved work cannot be read: {error}. It was moved to {aside}")
                continue
            name = origin.path.name if origin else document.name
            picture = thumbnail(views_of_document(document)[:1], PICTURE_SIZE)
            changed = origin is not None and origin.changed
            note = f"{name} has changed on the disk since then" if changed else ""
            found.append(Copy(recovery, name, picture, note))
        return found, problems

    def list_copies(self) -> None:
        """Show the list of all copies of earlier launches."""
        self._dialogs.push(RecoveryList(self.copies, self._textures), self._answered)

    def _answered(self, answer: Answer) -> None:
        self._dialogs.pop()
        if answer.do == "discard":
            for copy in answer.copies:
                copy.recovery.discard()
            self._forget(answer.copies)
        elif answer.do == "recover":
            names = ", ".join(copy.name for copy in answer.copies)
            self._files.load(f"recovering {names}", partial(self._read, answer.copies))

    def _forget(self, copies: Sequence[Copy]) -> None:
        """Remove copies from the list, and show it again unless it is empty."""
        self.copies = [copy for copy in self.copies if copy not in copies]
        if self.copies:
            self.list_copies()

    def _read(self, copies: Sequence[Copy]) -> Callable[[], None]:
        """Read copies; return a function that opens them, the latest last."""
        read = [
            (copy, *with_values(*load_project(copy.recovery.path)), load_origin(copy.recovery.path))
            for copy in reversed(copies)
        ]

        def show() -> None:
            for copy, document, known, origin in read:
                self._session.restore(document, known, origin, saved=False)
                autosave = self._autosave(self._session.document.identity)
                autosave.take_over(copy.recovery)
            if isinstance(self._session.document, SequenceDocument) and autosave.has_checkpoint:
                self._session.recover_sequence()
            if len(copies) > 1:
                text = f"recovered {len(copies)} documents; Undo returns to the earlier ones"
            else:
                text = f"recovered {self._session.document.name}; save it now"
            self._session.notices.show(text)
            self._forget(copies)

        return show


def _content(document: Document, functions: Evaluators) -> Content:
    return document, known_values(document, functions)
