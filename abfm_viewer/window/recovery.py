"""Unsaved work: copies of this launch's, and those of launches that ended badly."""

import itertools
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial

from abfm import AbfmError, TriangleMesh
from abfm.types import FloatArray
from abfm_viewer.computing.evaluation import Functions
from abfm_viewer.computing.problem import Snapshot
from abfm_viewer.dialogs import Dialogs
from abfm_viewer.document.document import Document
from abfm_viewer.files.autosave import Autosave, Content, Recovery, recoverable
from abfm_viewer.files.origin import Origin, load_origin
from abfm_viewer.files.project import load_project
from abfm_viewer.files.state_folder import StateFolder
from abfm_viewer.session.loading import Load
from abfm_viewer.session.opening import known_values
from abfm_viewer.session.session import Session
from abfm_viewer.session.session_files import SessionFiles

COPIES = "copies"
"""What cards are about."""


class Recoveries:
    """Keeps a session's autosaves in the state folder, and offers those of earlier launches.

    There is a copy of each unsaved document: the present one, with the field of a run that is under way, and those that
    were left for another mesh.
    """

    def __init__(self, session: Session, state: StateFolder, files: SessionFiles, dialogs: Dialogs) -> None:
        self._session = session
        self._state = state
        self._files = files
        self._dialogs = dialogs
        self._autosaves: dict[TriangleMesh, Autosave] = {}
        self._numbers = itertools.count()
        self._recoveries: list[Recovery] | None = None
        self._reading: tuple[Load, Recovery] | None = None
        self._asks_later = False  # when what took the place of reading a copy is there
        self._told = ""
        self._autosave(session.mesh)

    def update(self) -> None:
        session = self._session
        if self._recoveries is None:
            self._recoveries = recoverable(self._state)
            self._ask_next()
        self._mind_reading(self._recoveries)
        unsaved = {document.mesh: document for document in reversed(session.unsaved_documents)}
        running = self._running()
        for mesh in {*self._autosaves, *unsaved, *([] if running is None else [session.mesh])}:
            document, autosave, functions = unsaved.get(mesh), self._autosave(mesh), session.functions_of(mesh)
            origin = session.origin_of(mesh)
            if mesh is session.mesh and running is not None:
                content = partial(self._content_of_run, session.document, running, functions)
                autosave.offer((session.document, running), content, True, origin)
            else:
                content = partial(_content, document or session.document, functions)
                autosave.offer(document, content, document is not None, origin)
                if document is None and mesh is not session.mesh and autosave.is_idle:
                    self._autosaves.pop(mesh).close()
        self._tell()

    def close(self, keep_unsaved: bool) -> None:
        """Finish writing; a copy of unsaved work stays only if it is to be recovered."""
        kept = {document.mesh for document in self._session.unsaved_documents} if keep_unsaved else set()
        if keep_unsaved and self._session.solver.running:
            kept.add(self._session.mesh)
        for mesh, autosave in self._autosaves.items():
            autosave.close()
            if mesh not in kept:
                autosave.discard()

    def _autosave(self, mesh: TriangleMesh) -> Autosave:
        if mesh not in self._autosaves:
            self._autosaves[mesh] = Autosave(self._state, number=next(self._numbers))
        return self._autosaves[mesh]

    def _tell(self) -> None:
        problem = next((autosave.error for autosave in self._autosaves.values() if autosave.error), "")
        if problem != self._told:
            self._told = problem
            self._session.mend(COPIES)
            if problem:
                self._session.say(f"no copy of unsaved work could be kept: {problem}", True, COPIES)

    def _running(self) -> Snapshot | None:
        """What the run that is under way has come to; None before its first step."""
        snapshot = self._session.solver.snapshot
        if snapshot is None or snapshot.problem.mesh is not self._session.mesh or not snapshot.iteration.iteration:
            return None
        return snapshot

    def _content_of_run(self, document: Document, snapshot: Snapshot, functions: Functions) -> Content:
        """The document with the best field so far as its result."""
        try:
            found, run = self._session.solver.unfinished(snapshot, functions)
        except AbfmError:  # the run has just ended, perhaps with its process: what it leaves comes next
            return _content(document, functions)
        runs = document.runs if run is None else (*document.runs, run)
        return _content(replace(document, result=found, runs=runs), functions)

    def _ask_next(self) -> None:
        if self._recoveries:
            recovery = self._recoveries.pop(0)
            load = Load("reading unsaved work", partial(self._read, recovery), replaces=False)
            self._reading = load, recovery
            self._session.load(load)

    def _mind_reading(self, recoveries: list[Recovery]) -> None:
        """Offer a copy though something else was opened while it was read, but not where reading it was cancelled."""
        loading = self._session.loading
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
            return partial(self._ask, recovery, *load_project(recovery.path), load_origin(recovery.path))
        except AbfmError as error:
            text = f"unsaved work of an earlier launch is kept in {recovery.set_aside()}, but {error}"
            return partial(self._session.say, text, is_error=True)

    def _ask(self, recovery: Recovery, document: Document, known: dict[str, FloatArray], origin: Origin | None) -> None:
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
        self, recovery: Recovery, document: Document, known: dict[str, FloatArray], origin: Origin | None
    ) -> None:
        session = self._session
        document = replace(document, view=replace(document.view, ui_scale=session.view.ui_scale))
        session.restore(document, known, origin, saved=False)
        self._autosave(session.mesh).take_over(recovery)
        session.say(f"recovered {document.name}: save it to keep it")

    def _discard(self, recovery: Recovery) -> None:
        recovery.discard()
        self._ask_next()


def _content(document: Document, functions: Functions) -> Content:
    return document, known_values(document, functions)
